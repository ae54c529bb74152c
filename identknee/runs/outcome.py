"""How a computation ended, each way with its sentence."""

from enum import Enum, unique
from typing import Self


class WithSentence(Enum):
    """A word for files, and `sentence`, which says it to a person."""

    _value_: str
    sentence: str

    def __new__(cls, word: str, sentence: str = "") -> Self:
        """The member of a word."""
        member = object.__new__(cls)
        member._value_, member.sentence = word, sentence
        return member


@unique
class Outcome(WithSentence):
    """How an equilibrium, a trial or a fit ended."""

    # Equilibria and trials.
    CONVERGED = ("converged", "A stable equilibrium was found on the branch that starts unloaded.")
    FOLD = ("fold", "No stable pose at full load: the simulated knee jumps before reaching it.")
    NO_EQUILIBRIUM = (
        "no_equilibrium",
        "No equilibrium was found near the pose where the search began.",
    )
    UNCONSTRAINED = (
        "unconstrained",
        (
            "One direction of motion has no stiffness: the pose is not unique. Is a ligament "
            "missing or slack?"
        ),
    )
    # Fits.
    MINIMUM = ("minimum", "Exact derivatives confirm a local minimum.")
    VALLEY = ("valley", "The optimizer stopped in a valley before a minimum was reached.")
    CLIFF = ("cliff", "The search stopped at a cliff, beyond which the simulated knee jumps.")
    BUDGET = ("budget", "The budget of simulations was exhausted.")
    SPREAD = ("spread", "The spread of the population fell below the tolerance.")
    START_FAILED = ("start_failed", "The model has no prediction at the start.")
