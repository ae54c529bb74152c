"""`identknee reveal`: the truth behind blind data, and how a diagnosis compares with it."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

import identknee as ik
from identknee.blind.truth import TRUTH_FILE
from identknee.cli.command import Json, show
from identknee.runs.errors import InputError
from identknee.runs.files import check_readable

RESULT_FILE = "result.json"

BlindFolder = Annotated[
    Path, typer.Argument(metavar="BLIND_DIR", help="A folder that `identknee blind` wrote.")
]
DiagnosisFolder = Annotated[
    Path, typer.Argument(metavar="DIAGNOSIS_DIR", help="A folder that `identknee diagnose` wrote.")
]


def reveal(blind_dir: BlindFolder, diagnosis_dir: DiagnosisFolder, as_json: Json = False) -> None:
    """Reveal what is hidden in BLIND_DIR, and score the diagnosis in DIAGNOSIS_DIR."""
    _check_order(blind_dir, diagnosis_dir)
    truth = ik.read_truth(blind_dir)
    score = ik.score(truth, _diagnosis(diagnosis_dir / RESULT_FILE))
    summary = {**asdict(score), "truth": truth.to_dict()}
    show(summary, _lines(truth, score), as_json=as_json)


def _check_order(blind_dir: Path, diagnosis_dir: Path) -> None:
    for folder, file, verb in (
        (blind_dir, TRUTH_FILE, "blind"),
        (diagnosis_dir, RESULT_FILE, "diagnose"),
    ):
        if not (folder / file).exists():
            raise InputError(
                folder,
                "",
                f"there is no {file} in it, so that it is no folder of identknee {verb}",
                "Give the folder of blind first and that of diagnose second.",
            )


def _diagnosis(path: Path) -> dict[str, Any]:
    try:
        diagnosis = json.loads(check_readable(path).read_text(encoding="utf-8"))
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "", "this is not JSON", "Run identknee diagnose again.") from error
    if not isinstance(diagnosis, dict) or "verdict" not in diagnosis:
        raise InputError(
            path, "verdict", "there is no verdict in it", "Give the folder of identknee diagnose."
        )
    return diagnosis


def _lines(truth: "ik.Truth", score: "ik.Score") -> list[str]:
    lines = [score.sentence]
    for effect, numbers in truth.amplitudes.items():
        size = ", ".join(f"{name} {value:.3g} {unit}" for name, (value, unit) in numbers.items())
        lines.append(f"{effect}: {size}")
    if score.line_offset_mm is not None:
        lines.append(
            f"The line found lies {score.line_offset_mm:.1f} mm and "
            f"{score.line_angle_deg:.0f} deg off."
        )
    before, after = score.stiffness_error_kN
    if before is not None and after is not None:
        lines.append(f"Mean stiffness error {before:.2f} kN before, {after:.2f} kN after.")
    return lines
