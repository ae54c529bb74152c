"""The convergence check at which sampling stops, every number of it kept."""

from collections.abc import Callable, Sequence
from enum import Enum, unique

import numpy as np

from identknee.identify.posterior.chains import (
    autocorrelation_time,
    bulk_draws,
    mean_error,
    split_rhat,
    tail_draws,
)
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared, entry

ACCEPTANCE_HINT = (0.15, 0.5)
STUCK_ACCEPTANCE = 0.05
# A walker that has not moved for fewer steps than this may be unlucky.
STUCK_STEPS = 200
BURN_IN = 0.2


@unique
class SampleOutcome(Enum):
    """How sampling ended; the value is the word written to files."""

    CONVERGED = "converged"
    BUDGET = "budget"
    STUCK = "stuck"
    START_FAILED = "start_failed"

    @property
    def sentence(self) -> str:
        """What happened, as a full sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    SampleOutcome.CONVERGED: "Every condition of convergence is met.",
    SampleOutcome.BUDGET: "The budget of simulations was used up before the sample converged.",
    SampleOutcome.STUCK: "A walker hardly ever moves, so the sample cannot be trusted.",
    SampleOutcome.START_FAILED: "The model has no prediction around the places to start from.",
}


@declared
class StopRule:
    """What a sample must reach, all of it, before sampling stops, and when it stops anyway."""

    autocorrelation_times: float = entry(
        "Steps after burn-in, in the largest autocorrelation time", unit="1", default=50.0
    )
    drift: float = entry(
        "Largest relative change of an autocorrelation time since the check before; the checks are "
        "one autocorrelation time apart or more",
        unit="1",
        default=0.01,
    )
    rhat: float = entry("Largest R-hat between the halves of the ensembles", unit="1", default=1.01)
    effective_draws: float = entry(
        "Fewest effective draws, of the bulk and of the tails, over all ensembles",
        unit="1",
        default=400.0,
    )
    effective_draws_each: float = entry(
        "Fewest effective draws of one ensemble", unit="1", default=100.0
    )
    mean_error: float = entry(
        "Largest Monte Carlo standard error of a mean, relative to the standard deviation",
        unit="1",
        default=0.05,
    )
    budget: int = entry(
        "Simulations after which sampling stops in any case, at the end of a block of steps",
        unit="1",
        default=400_000,
    )

    def __post_init__(self) -> None:
        if self.budget < 1:
            raise ValueError(f"the budget must be at least 1 simulation, got {self.budget}")


@declared
class ConvergenceCheck:
    """The numbers the stop rule looks at, after some steps."""

    rule: StopRule = entry("The stop rule")
    steps: int = entry("Steps of every walker so far, those of burn-in included")
    burn_in: int = entry("How many of them, at the beginning, are left out of everything")
    tau: Array = array("Autocorrelation time of each parameter", "parameter", unit="steps")
    drift: float = entry(
        "Largest relative change of an autocorrelation time since the check at least one such time "
        "before; infinite at the first",
        unit="1",
    )
    rhat: Array = array("R-hat of each parameter", "parameter")
    bulk: Array = array("Effective draws of the bulk", "parameter", "ensemble")
    tail: Array = array("Effective draws of the tails", "parameter", "ensemble")
    mean_error: Array = array(
        "Monte Carlo standard error of each mean over the standard deviation", "parameter"
    )
    acceptance: Array = array("Share of the steps in which a walker moved", "ensemble", "walker")

    @property
    def kept(self) -> int:
        """Steps after burn-in."""
        return self.steps - self.burn_in

    @property
    def conditions(self) -> dict[str, tuple[float, float, bool]]:
        """By name of the condition: the number, its bar, and whether it is met."""
        rule = self.rule
        longest = float(np.max(self.tau))
        fewest = float(min(self.bulk.sum(axis=1).min(), self.tail.sum(axis=1).min()))
        fewest_each = float(min(self.bulk.min(), self.tail.min()))
        at_least = {
            "steps_per_tau": (self.kept / longest, rule.autocorrelation_times),
            "effective_draws": (fewest, rule.effective_draws),
            "effective_draws_each": (fewest_each, rule.effective_draws_each),
        }
        at_most = {
            "tau_drift": (self.drift, rule.drift),
            "rhat": (float(np.max(self.rhat)), rule.rhat),
            "mean_error": (float(np.max(self.mean_error)), rule.mean_error),
        }
        return {name: (value, bar, value >= bar) for name, (value, bar) in at_least.items()} | {
            name: (value, bar, value <= bar) for name, (value, bar) in at_most.items()
        }

    @property
    def is_passed(self) -> bool:
        """Whether all conditions are met."""
        return all(met for _, _, met in self.conditions.values())

    @property
    def stuck(self) -> BoolArray:
        """Which walkers moved in fewer than one step in twenty, of 200 or more."""
        is_stuck = (self.acceptance < STUCK_ACCEPTANCE) & (self.kept >= STUCK_STEPS)
        return np.asarray(is_stuck)

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """Every condition with its number."""
        lines = [f"{self.steps} steps of every walker, the first {self.burn_in} left out."]
        for name, (value, bar, met) in self.conditions.items():
            sign = ">=" if name in _AT_LEAST else "<="
            mark = "met" if met else "not met"
            lines.append(f"{_WORDS[name]}: {value:.4g}, wanted {sign} {bar:g}: {mark}.")
        mean = float(self.acceptance.mean())
        low, high = ACCEPTANCE_HINT
        lines.append(
            f"Acceptance {mean:.2f}, lowest of a walker {self.acceptance.min():.2f} (differential "
            f"evolution usually has {low:g} to {high:g}, Newton proposals more)."
        )
        return "\n".join(lines)


_AT_LEAST = {"steps_per_tau", "effective_draws", "effective_draws_each"}
_WORDS = {
    "steps_per_tau": "Steps in the longest autocorrelation time",
    "tau_drift": "Change of an autocorrelation time between checks",
    "rhat": "Largest R-hat between half ensembles",
    "effective_draws": "Fewest effective draws of bulk or tail",
    "effective_draws_each": "Fewest of one ensemble",
    "mean_error": "Largest Monte Carlo error of a mean, in standard deviations",
}


def check_convergence(
    samples: Array, moved: BoolArray, rule: StopRule, before: Sequence[ConvergenceCheck]
) -> ConvergenceCheck:
    """The convergence check of the steps so far; the first fifth counts as burn-in.

    Parameters
    ----------
    samples
        In any coordinates, shape ``(ensembles, walkers, steps, n)``.
    moved
        Whether a walker moved in a step, shape ``(ensembles, walkers, steps)``.
    rule
        The stop rule.
    before
        The checks before, oldest first, for the drift of the autocorrelation times.
    """
    steps = samples.shape[2]
    burn_in = int(BURN_IN * steps)
    kept = [samples[:, :, burn_in:, i] for i in range(samples.shape[3])]
    tau = _each(autocorrelation_time, kept)
    return ConvergenceCheck(
        rule=rule,
        steps=steps,
        burn_in=burn_in,
        tau=tau,
        drift=_drift(tau, steps, before),
        rhat=_each(split_rhat, kept),
        bulk=_each(bulk_draws, kept),
        tail=_each(tail_draws, kept),
        mean_error=_each(mean_error, kept),
        acceptance=moved[:, :, burn_in:].mean(axis=2),
    )


def _each(function: Callable[[Array], Array | float], values: Sequence[Array]) -> Array:
    """What the function finds for each parameter."""
    return np.array([function(one) for one in values])


def _drift(tau: Array, steps: int, before: Sequence[ConvergenceCheck]) -> float:
    """Largest change since the latest check that is one autocorrelation time back or more."""
    longest = float(np.max(tau))
    for check in reversed(before):
        if steps - check.steps >= longest:
            return float(np.max(np.abs(tau / check.tau - 1.0)))
    return np.inf
