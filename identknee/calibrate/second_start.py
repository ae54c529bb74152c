"""A second search from another literature guess, where a fit is doubtful."""

import numpy as np

from identknee.calibrate.doubts import APART
from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.problem import Problem
from identknee.calibrate.scales import typical_steps
from identknee.calibrate.starts import named_start, start_names
from identknee.runs.arrays import Array
from identknee.runs.declare import declared
from identknee.runs.findings import Finding, Severity
from identknee.runs.outcome import Outcome
from identknee.runs.words import either

# Share of the objective, and objective: ends that are the same, also where a search stops early.
ALIKE, ROUNDING = 1e-3, 1e-9


@declared
class SecondSearch:
    """Where least squares from another start ended.

    Attributes
    ----------
    name
        Name of the start, as for `identknee.calibrate.starts.named_start`.
    first, second
        The doubtful fit, and the one from this start.
    """

    name: str
    first: Fit
    second: Fit

    @property
    def is_better(self) -> bool:
        """Whether the second search ended at a lower misfit."""
        first, second = self.first.objective, self.second.objective
        return self.second.outcome is not Outcome.START_FAILED and second < first - _alike(first)

    @property
    def finding(self) -> Finding:
        """Whether both agree, as a sentence."""
        first, second = self.first.objective, self.second.objective
        ended = f"a second search, least squares from {self.name}, ended"
        if self.second.outcome is Outcome.START_FAILED:
            return _on_starts(
                Severity.INFO, f"No second search: at {self.name} there is no prediction either."
            )
        objectives = f"(objective {second:.4g}, here {first:.4g})"
        if self.is_better:
            return _on_starts(
                Severity.ERROR,
                f"Starts disagree: {ended} at a lower misfit {objectives}, so this fit is not the "
                "best. identknee sweep tries many starts.",
            )
        if second > first + _alike(first):
            return _on_starts(
                Severity.WARNING,
                f"Starts disagree: {ended} at a higher misfit {objectives}. identknee sweep tries "
                "many starts.",
            )
        steps = typical_steps(self.first.parameters)
        if float(np.max(np.abs(self.second.theta - self.first.theta) / steps)) > APART:
            return _on_starts(
                Severity.WARNING,
                f"Starts disagree: {ended} at the same misfit with other parameters "
                f"({self._farthest()}). See: identknee profile",
            )
        return _on_starts(
            Severity.INFO,
            f"{ended[0].upper()}{ended[1:]} at the same parameters: the start is not the reason.",
        )

    def _farthest(self) -> str:
        parameters = self.first.parameters
        steps = typical_steps(parameters)
        i = int(np.argmax(np.abs(self.second.theta - self.first.theta) / steps))
        return either(parameters.names[i], self.first.theta[i], self.second.theta[i])


def _alike(objective: float) -> float:
    return ALIKE * objective + ROUNDING


def second_search(problem: Problem, first: Fit) -> SecondSearch:
    """Least squares from the first named start that is not the one of a fit.

    Parameters
    ----------
    problem
        That of the fit.
    first
        The fit; its fixed parameters and its priors are kept.
    """
    name, start = _other_start(first)
    second = fit(problem, start, seed=first.seed, fixed=first.fixed, priors=first.priors)
    return SecondSearch(name=name, first=first, second=second)


def _other_start(first: Fit) -> tuple[str, Array]:
    """A start by name with a free parameter elsewhere; the middle of the bounds failing that."""
    parameters = first.parameters
    free = parameters.with_fixed(first.fixed, first.start)
    for name in start_names():
        try:
            guess = named_start(name, parameters)
        except ValueError:
            # The guesses of the paper speak of four ligaments that a knee need not have.
            continue
        start = free.expand(free.restrict(np.clip(guess, parameters.lower, parameters.upper)))
        if not np.allclose(start, first.start):
            return name, start
    middle = 0.5 * (parameters.lower + parameters.upper)
    return "the middle of the bounds", free.expand(free.restrict(middle))


def _on_starts(severity: Severity, sentence: str) -> Finding:
    return Finding(severity=severity, sentence=sentence, where="starts")
