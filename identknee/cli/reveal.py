"""`identknee reveal`: the truth behind blind data, and how a diagnosis compares with it."""

import math
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

import identknee as ik
from identknee.cli.command import Json, show
from identknee.runs.errors import InputError

RESULT_FILE = "result.json"
DIAGNOSIS_REMEDY = "Give the folder of identknee diagnose."

BlindFolder = Annotated[
    Path, typer.Argument(metavar="BLIND_DIR", help="A folder that `identknee blind` wrote.")
]
DiagnosisFolder = Annotated[
    Path, typer.Argument(metavar="DIAGNOSIS_DIR", help="A folder that `identknee diagnose` wrote.")
]


def reveal(blind_dir: BlindFolder, diagnosis_dir: DiagnosisFolder, as_json: Json = False) -> None:
    """Reveal what is hidden in BLIND_DIR, and score the diagnosis in DIAGNOSIS_DIR."""
    _check_order(blind_dir, diagnosis_dir)
    truth = ik.blind.read_truth(blind_dir)
    score = ik.blind.score(truth, _diagnosis(diagnosis_dir / RESULT_FILE))
    summary = {**asdict(score), "truth": truth.to_dict()}
    show(summary, _lines(truth, score), as_json=as_json)


def _check_order(blind_dir: Path, diagnosis_dir: Path) -> None:
    # It loads more than the help of all verbs together.
    from identknee.blind.truth import TRUTH_FILE

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
    # These take longer to load than anything else here.
    from identknee.cli.revealed import Revealed
    from identknee.runs.schema import Fault, read_json, validated

    def refuse(fault: Fault) -> InputError:
        where = "/".join(str(x) for x in (*fault.place, *([fault.key] * bool(fault.key))))
        why = "there is no verdict in it" if fault.key == "verdict" else fault.why
        return InputError(path, where, why, fault.remedy or DIAGNOSIS_REMEDY)

    diagnosis = read_json(path, "Run identknee diagnose again.")
    validated(Revealed, diagnosis, refuse)
    return dict(diagnosis)


def _lines(truth: "ik.blind.Truth", score: "ik.blind.Score") -> list[str]:
    lines = [score.sentence]
    wanted = truth.facts.get("wanted_signal")
    if isinstance(wanted, int | float) and truth.effects and truth.is_largest:
        lines.append(
            f"A signal of {wanted:g} was asked for; at the largest plausible size of what is "
            f"hidden it is {truth.signal:.2g}."
        )
    for effect, numbers in truth.amplitudes.items():
        size = ", ".join(f"{name} {value:.3g} {unit}" for name, (value, unit) in numbers.items())
        lines.append(f"{effect}: {size}")
    if truth.stated_errors:
        told = ", ".join(_true_errors(truth.stated_errors))
        lines.append(f"What was given with the knee is wrong by: {told}.")
    if score.line_offset_mm is not None:
        lines.append(
            f"The line found lies {score.line_offset_mm:.1f} mm and "
            f"{score.line_angle_deg:.0f} deg off."
        )
    before, after = score.stiffness_error_kN
    if before is not None and after is not None:
        lines.append(f"Mean stiffness error {before:.2f} kN before, {after:.2f} kN after.")
    return lines


def _true_errors(errors: Mapping[str, float]) -> list[str]:
    """How far off each place, frame and set of axes is, and each kind of load."""
    lengths: dict[tuple[str, str], float] = {}
    gains = []
    for name, value in errors.items():
        words = re.split("[._]", name)
        unit, kind = words[-1], name.partition(".")[0]
        if kind == "load_gain":
            gains.append(f"{' '.join(words[2:])} {100.0 * value:+.2g} %")
        else:
            key = (name[: -len(f"_x_{unit}")], unit)
            lengths[key] = math.hypot(lengths.get(key, 0.0), value)
    return [*(f"{name} {x:.2g} {unit}" for (name, unit), x in lengths.items()), *gains]
