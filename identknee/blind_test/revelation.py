"""The truth behind blind data, and how a diagnosis compares with it."""

import math
import re
from collections.abc import Iterator
from pathlib import Path

from typing_extensions import override

from identknee.blind.scoring import Score, score
from identknee.blind.truth import TRUTH_FILE, Truth, read_truth
from identknee.blind_test.blind_data import BlindData
from identknee.runs.declare import declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike
from identknee.runs.schema import summary_of
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.files import SUMMARY, load

ORDER = "Give the folder of blind first and that of diagnose second."


@declared
class Revelation:
    """What was hidden, and what a diagnosis made of it."""

    score: Score = entry("The diagnosis beside the truth", is_inline=True)
    truth: Truth = entry("What is behind the data")

    @override
    def __str__(self) -> str:
        """What was hidden, with its sizes, and how near the diagnosis came."""
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        truth, score = self.truth, self.score
        yield score.sentence
        if (wanted := truth.wanted_signal) is not None and truth.effects and truth.is_largest:
            yield (
                f"A signal of {wanted:g} was asked for; at the largest plausible size of what is "
                f"hidden it is {truth.signal:.2g}."
            )
        for effect, numbers in truth.amplitudes.items():
            sizes = (f"{name} {value:.3g} {unit}" for name, (value, unit) in numbers.items())
            yield f"{effect}: {', '.join(sizes)}"
        if truth.stated_errors:
            lengths: dict[tuple[str, str], float] = {}
            gains = []
            for name, value in truth.stated_errors.items():
                words = re.split("[._]", name)
                unit, kind = words[-1], name.partition(".")[0]
                if kind == "load_gain":
                    gains.append(f"{' '.join(words[2:])} {100.0 * value:+.2g} %")
                else:
                    key = (name[: -len(f"_x_{unit}")], unit)
                    lengths[key] = math.hypot(lengths.get(key, 0.0), value)
            errors = ", ".join(
                [*(f"{name} {x:.2g} {unit}" for (name, unit), x in lengths.items()), *gains]
            )
            yield f"What was given with the knee is wrong by: {errors}."
        if score.line_offset_mm is not None:
            yield (
                f"The line found lies {score.line_offset_mm:.1f} mm and "
                f"{score.line_angle_deg:.0f} deg off."
            )
        before, after = score.stiffness_error_kN
        if before is not None and after is not None:
            yield f"Mean stiffness error {before:.2f} kN before, {after:.2f} kN after."


def reveal(blind_dir: BlindData | PathLike, diagnosis_dir: Diagnosis | PathLike) -> Revelation:
    """What is hidden in blind data, and the score of a diagnosis of them.

    Parameters
    ----------
    blind_dir
        What `make_blind` gave back, or the folder it wrote.
    diagnosis_dir
        What `diagnose` gave back, or the folder it wrote.

    Raises
    ------
    InputError
        If a folder holds no such result, or a damaged one.
    """
    if isinstance(blind_dir, BlindData) and blind_dir.case is not None:
        truth = blind_dir.case.truth
    elif isinstance(blind_dir, BlindData):
        raise ValueError("answers read from files hold no truth; give the folder of the blind data")
    else:
        truth = read_truth(_folder_containing(Path(blind_dir), TRUTH_FILE, "blind"))
    if isinstance(diagnosis_dir, Diagnosis):
        diagnosis: Answer = diagnosis_dir
    else:
        folder = _folder_containing(Path(diagnosis_dir), SUMMARY, "diagnose")
        diagnosis = load(folder)
        if not isinstance(diagnosis, Diagnosis):
            why = "it holds no verdict, so identknee diagnose did not make it"
            raise InputError(folder, "", why, ORDER)
    return Revelation(score=score(truth, summary_of(diagnosis)), truth=truth)


def _folder_containing(folder: Path, file: str, verb: str) -> Path:
    """The folder, which must hold a file of a verb."""
    if not (folder / file).exists():
        why = f"it holds no {file}, so identknee {verb} did not make it"
        raise InputError(folder, "", why, ORDER)
    return folder
