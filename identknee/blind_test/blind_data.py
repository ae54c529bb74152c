"""Laxity of a knee with a hidden effect."""

from collections.abc import Sequence
from typing import Annotated, Unpack

from typing_extensions import override

from identknee.blind.case import RANDOM, BlindCase, blind_case, write_blind
from identknee.blind.conditions import stated_conditions
from identknee.runs.declare import declared, entry
from identknee.subject.knee import UncertainLike
from identknee.verbs.answer import Answer
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
