"""How a computation ended, each way with its sentence."""

from enum import Enum, unique


@unique
class Outcome(Enum):
    """How an equilibrium, a trial or a fit ended.

    The value is the word written to files; `sentence` says it to a person.
    """

    # Equilibria and trials.
    CONVERGED = "converged"
    FOLD = "fold"
    NO_EQUILIBRIUM = "no_equilibrium"
    UNCONSTRAINED = "unconstrained"
    # Fits.
    MINIMUM = "minimum"
    VALLEY = "valley"
    CLIFF = "cliff"
    BUDGET = "budget"
    SPREAD = "spread"
    START_FAILED = "start_failed"

    @property
    def sentence(self) -> str:
        """What happened, as a full sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    Outcome.CONVERGED: "A stable equilibrium was found on the branch that starts unloaded.",
    Outcome.FOLD: "No stable pose at full load: the simulated knee jumps before reaching it.",
    Outcome.NO_EQUILIBRIUM: "No equilibrium was found near the pose where the search began.",
    Outcome.UNCONSTRAINED: "One direction of motion has no stiffness: the pose is not unique. Is "
    "a ligament missing or slack?",
    Outcome.MINIMUM: "Exact derivatives confirm a local minimum.",
    Outcome.VALLEY: "The optimizer stopped in a valley before a minimum was reached.",
    Outcome.CLIFF: "The search stopped at a cliff, beyond which the simulated knee jumps.",
    Outcome.BUDGET: "The budget of simulations was exhausted.",
    Outcome.SPREAD: "The spread of the population fell below the tolerance.",
    Outcome.START_FAILED: "The model has no prediction at the start.",
}
