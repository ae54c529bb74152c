"""Laxity of a knee with a hidden effect, and how a diagnosis compares with what was hidden."""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Unpack

from typing_extensions import override

from identknee.blind.case import RANDOM, BlindCase, blind_case, write_blind
from identknee.blind.conditions import stated_conditions
from identknee.blind.scoring import Score, score
from identknee.blind.truth import TRUTH_FILE, Truth, read_truth
from identknee.runs.declare import declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike
from identknee.runs.schema import summary_of
from identknee.subject.knee import UncertainLike
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.files import SUMMARY, load
from identknee.verbs.options import REFERENCE, OutOption, Seed, Subject, option
from identknee.verbs.verb import Run, recorded_as, verb

# The word for no effect.
NONE = "none"
# Of the signal asked for: less than this is another case.
REACHED = 0.9


@declared
class BlindData(Answer):
    """Data with a hidden effect; the files and the printed text do not tell which."""

    subject: str = entry("Name of the subject")
    n_trials: int = entry("Trials in laxity.csv", unit="1")
    case: BlindCase | None = entry(
        "The data, and the truth behind them; None where the answer was read from files",
        is_in_json=False,
        default=None,
    )
    is_secret: bool = entry(
        "Whether even who made the data is not to know the effect", is_in_json=False, default=True
    )

    @override
    def __str__(self) -> str:
        """How many trials there are, and nothing of what is hidden."""
        return f"{self.n_trials} trials of {self.subject}; something may be hidden in them."

    __repr__ = brief = __str__

    @property
    @override
    def remark(self) -> str:
        """A note on the signal for whoever made the data; empty if there is none.

        Where chance drew the effect, the same is said whatever was drawn.
        """
        truth = None if self.case is None else self.case.truth
        wanted = None if truth is None else truth.wanted_signal
        if truth is None or wanted is None:
            return ""
        if self.is_secret:
            return (
                f"The signal may be less than {wanted:g}: nothing may be hidden, or an effect at "
                "its largest plausible size. identknee reveal says what it is."
            )
        if not truth.effects or truth.signal >= REACHED * wanted:
            return ""
        why = "the largest plausible size gives no more" if truth.is_largest else "it stays below"
        return (
            f"The signal of {' and '.join(truth.effects)} is {truth.signal:.2g}, not {wanted:g}: "
            f"{why}. Ask for less, or choose another --effect or --seed."
        )


@verb
@recorded_as("blind", secret=("effect", "signal"))
def make_blind(
    run: Run,
    # The scaffold reads the subject: the function gets a knee.
    subject: Subject = REFERENCE,  # type: ignore[assignment]
    *,
    effect: Annotated[
        str | Sequence[str] | None,
        option(
            "The hidden cause: its name, random, or none; two at most.",
            in_python="None for no cause too.",
            metavar="ID",
            typed=list[str],
        ),
    ] = RANDOM,
    signal: Annotated[
        float | None,
        option("Size of the effect relative to the noise; taken from the literature if not given."),
    ] = None,
    uncertain: Annotated[
        UncertainLike,
        option(
            "How wrong the knee and the tests are to be, as in insertions=2mm,registration=2deg: "
            "one standard deviation. Exact if not given. Give `diagnose` the same.",
            metavar="NAME=SIZE,...",
            typed=list[str] | None,
        ),
    ] = None,
    seed: Seed = 0,
    **_: Unpack[OutOption],
) -> BlindData:
    """Laxity data with a hidden effect, to test a diagnosis.

    The data come from an independent generator. Writes laxity.csv for `diagnose`, and a sealed
    truth.json for `reveal`. The signal is the root of the chi-square that ligament parameters
    alone cannot fit. It runs on one thread: more workers change nothing.

    Raises
    ------
    ValueError
        If an effect is unknown, the signal is not positive, or no draw has an equilibrium in every
        trial.
    """
    names = (effect,) if isinstance(effect, str) else tuple(effect or ())
    case = blind_case(
        subject,
        seed=seed,
        effect=RANDOM if names == (RANDOM,) else None if names in ((), (NONE,)) else names,
        signal=signal,
        conditions=stated_conditions(uncertain),
    )
    if run.out is not None:
        write_blind(case, run.out)
    return BlindData(
        subject=subject.name, n_trials=case.laxity.n, case=case, is_secret=RANDOM in names
    )


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
