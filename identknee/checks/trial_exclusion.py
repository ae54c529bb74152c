"""Trials that stop a search are excluded until the others are fitted, then reinstated."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from identknee.calibrate.bounded_least_squares import ConstrainedFit, minimise
from identknee.calibrate.evaluation import Evaluation, Evaluator
from identknee.calibrate.problem import Problem
from identknee.laxity.table import Laxity
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.record import Outcome

MOST_ROUNDS = 8
# Tolerance on the deviance, and the fall of it that is worth another round or a trial excluded.
TOLERANCE, WORTH = 1e-3, 1.0
# Shares of the step that the linear model wants. At the small ones a misfit that rises has jumped.
JUMPS, SHARES = (1e-4, 1e-3, 1e-2), (1e-4, 1e-3, 1e-2, 0.1, 0.3, 1.0)
# Share of the fall promised by which the misfit of a trial rises where it jumps.
A_JUMP = 0.1
# Confidence with which a trial must contradict the others to be left out.
LEVEL = 0.95
MOST_NAMES = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExclusionResult:
    """Where a search ended that excluded trials and reinstated them.

    Attributes
    ----------
    theta
        Where, shape ``(p,)``.
    is_excluded
        Which trials could not be reinstated, shape ``(n,)``.
    was_excluded
        Which trials were excluded on the way, shape ``(n,)``.
    """

    theta: Array
    is_excluded: BoolArray
    was_excluded: BoolArray

    def sentence(self, trials: Sequence[str]) -> str:
        """The exclusion as a sentence, with the names of the trials."""
        if not self.was_excluded.any():
            return "Least squares from the start stopped where load paths end, and went on beyond."
        names = [trials[i] for i in np.flatnonzero(self.was_excluded).tolist()]
        more = len(names) - MOST_NAMES
        others = f" and {more} more trials" if more > 0 else ""
        return (
            "Along the way from the start the model jumps or loses equilibrium in "
            f"{', '.join(names[:MOST_NAMES])}{others}. These trials were excluded until the others "
            "were fitted, then reinstated where an equilibrium exists."
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialExclusion:
    """Least squares that a few trials cannot stop short of the best fit to all others.

    A search ends where a load path folds or the knee becomes loose, however bad the fit is there.
    Trials to which that happens are excluded until the others are fitted.

    Attributes
    ----------
    compared
        The model and all data.
    problem
        The problem of some of the data.
    expand
        The parameters of the model from those of the problem.
    """

    compared: LaxityResiduals
    problem: Callable[[Laxity], Problem]
    expand: Callable[[Array], Array]

    def run(self, start: Array) -> ExclusionResult | None:
        """Where the search from `start` ends; None where no trial keeps it from a lower misfit.

        Trials without equilibrium at the start are reinstated where the fit to the others has one.
        """
        out = was_excluded = self._has_lost_trials(start)
        best = first = self._search(start, out)
        if out.any() and best.evaluation.is_finite:
            out = out & self._has_lost_trials(best.evaluation.theta)
            best = self._search(best.evaluation.theta, out)
        for _ in range(MOST_ROUNDS):
            if best.outcome is Outcome.START_FAILED:
                break
            beyond, aside = self._search_without_blocking_trials(best, out)
            if beyond is best:
                break
            was_excluded = was_excluded | aside
            lost = out | self._has_lost_trials(beyond.evaluation.theta)
            again = self._search(beyond.evaluation.theta, lost)
            if (lost & ~out).any() and not self._contradicts(best, again, out, lost):
                break
            if again.evaluation.deviance > best.evaluation.deviance - WORTH:
                break
            best, out = again, lost
        if best is first:
            return None
        return ExclusionResult(
            theta=best.evaluation.theta, is_excluded=out, was_excluded=was_excluded
        )

    def _search(self, start: Array, aside: BoolArray) -> ConstrainedFit:
        return minimise(self._evaluator(aside), start, tolerance=TOLERANCE)

    def _evaluator(self, aside: BoolArray) -> Evaluator:
        laxity = self.compared.laxity
        coordinates = np.where(aside[:, None], np.nan, laxity.coordinates)
        return Evaluator(self.problem(replace(laxity, coordinates=coordinates)))

    def _search_without_blocking_trials(
        self, found: ConstrainedFit, aside: BoolArray
    ) -> tuple[ConstrainedFit, BoolArray]:
        """The search continued without the trials that stop it, and those excluded."""
        for _ in range(MOST_ROUNDS):
            stopping, start = self._blocking_trials(found.evaluation, aside)
            if not stopping.any() and start is found.evaluation.theta:
                break
            aside = aside | stopping
            found = self._search(start, aside)
        return found, aside

    def _blocking_trials(self, at: Evaluation, aside: BoolArray) -> tuple[BoolArray, Array]:
        """The trials whose misfit ends or jumps along the step that fits the others best.

        And where to go on: at the lowest point along that step where none does, else from here.
        """
        step = -np.linalg.lstsq(at.jacobian, at.residuals, rcond=None)[0]
        after = at.residuals + at.jacobian @ step
        promised = at.deviance - float(after @ after)
        stopping, lowest, start = np.zeros(aside.size, bool), at.deviance - WORTH, at.theta
        if promised < WORTH:
            return stopping, start
        evaluator = self._evaluator(aside)
        parameters, here = evaluator.parameters, self._misfits(at.theta)
        for share in SHARES:
            theta = np.clip(at.theta + share * step, parameters.lower, parameters.upper)
            # An excluded trial may have no pose on either side.
            rise = np.where(aside, 0.0, self._misfits(theta)) - np.where(aside, 0.0, here)
            if not np.isfinite(rise).all():
                return ~np.isfinite(rise), at.theta
            if share in JUMPS and rise.max() > A_JUMP * promised:
                return rise > A_JUMP * promised, at.theta
            if (deviance := evaluator.deviance(theta)) < lowest:
                lowest, start = deviance, theta
        return stopping, start

    def _misfits(self, theta: Array) -> Array:
        """Squared differences of each trial with data, infinite without equilibrium, ``(n,)``."""
        laxity = self.compared.laxity
        differences = self.compared.differences(self.expand(theta))
        if laxity.sd is not None:
            differences = differences / laxity.sd
        squares = np.where(laxity.is_measured, differences**2, 0.0).sum(axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    def _has_lost_trials(self, theta: Array) -> BoolArray:
        return np.isinf(self._misfits(theta))

    def _contradicts(
        self, best: ConstrainedFit, without: ConstrainedFit, out: BoolArray, lost: BoolArray
    ) -> bool:
        """Whether the trials `lost` cost more misfit than so many values of the others have."""
        measured = self.compared.laxity.is_measured
        n, n_lost = int(measured[~lost].sum()), int(measured[lost & ~out].sum())
        scale = without.evaluation.deviance / max(n - without.evaluation.theta.size, 1)
        cost = best.evaluation.deviance - without.evaluation.deviance
        return bool(cost > scale * chdtri(n_lost, 1.0 - LEVEL))
