"""A search past trials that bar its way: they are set aside, and taken back from beyond."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from identknee.calibrate.bounded_least_squares import Constrained, minimise
from identknee.calibrate.evaluation import Evaluation, Evaluator
from identknee.calibrate.problem import Problem
from identknee.laxity.table import Laxity
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.outcome import Outcome

MOST_ROUNDS = 8
# Tolerance on the deviance, and the fall of it that is worth another round or a trial set aside.
TOLERANCE, WORTH = 1e-3, 1.0
# Shares of the step that the linear model wants. At the small ones a misfit that rises has jumped.
JUMPS, SHARES = (1e-4, 1e-3, 1e-2), (1e-4, 1e-3, 1e-2, 0.1, 0.3, 1.0)
# Share of the fall promised by which the misfit of a trial rises where it jumps.
A_JUMP = 0.1
# Confidence with which a trial must contradict the others to be left out.
LEVEL = 0.95
MOST_NAMES = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beyond:
    """Where a search past barring trials ended.

    Attributes
    ----------
    theta
        Where, shape ``(p,)``.
    is_left_out
        Which trials it could not take back, shape ``(n,)``.
    has_barred
        Which trials were set aside on the way, likewise.
    """

    theta: Array
    is_left_out: BoolArray
    has_barred: BoolArray

    def sentence(self, trials: Sequence[str]) -> str:
        """What was done, with the names of the trials."""
        if not self.has_barred.any():
            return (
                "Least squares from the start stopped at an end of load paths and went on beyond."
            )
        names = [trials[i] for i in np.flatnonzero(self.has_barred).tolist()]
        more = len(names) - MOST_NAMES
        others = f" and {more} more trials" if more > 0 else ""
        return (
            "On the way of least squares from the start the simulated knee jumps or loses its pose "
            f"in {', '.join(names[:MOST_NAMES])}{others}: what barred the way was set aside until "
            "all else was fitted, and taken back where the knee has a pose."
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BarredSearch:
    """Least squares that a few trials do not keep from where all others fit best.

    Where a load path folds or the knee gets loose a search ends, however bad the fit. The trials to
    which that happens are set aside until the others are fitted.

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

    def run(self, start: Array) -> Beyond | None:
        """Where the search from `start` ends; None where no trial bars its way to a lower misfit.

        Trials without equilibrium at the start come back where the fit to the others has one.
        """
        out = has_barred = self._is_lost(start)
        best = first = self._search(start, out)
        if out.any() and best.evaluation.is_finite:
            out = out & self._is_lost(best.evaluation.theta)
            best = self._search(best.evaluation.theta, out)
        for _ in range(MOST_ROUNDS):
            if best.outcome is Outcome.START_FAILED:
                break
            beyond, aside = self._past(best, out)
            if beyond is best:
                break
            has_barred = has_barred | aside
            lost = out | self._is_lost(beyond.evaluation.theta)
            again = self._search(beyond.evaluation.theta, lost)
            if (lost & ~out).any() and not self._contradicts(best, again, out, lost):
                break
            if again.evaluation.deviance > best.evaluation.deviance - WORTH:
                break
            best, out = again, lost
        if best is first:
            return None
        return Beyond(theta=best.evaluation.theta, is_left_out=out, has_barred=has_barred)

    def _search(self, start: Array, aside: BoolArray) -> Constrained:
        return minimise(self._evaluator(aside), start, tolerance=TOLERANCE)

    def _evaluator(self, aside: BoolArray) -> Evaluator:
        laxity = self.compared.laxity
        coordinates = np.where(aside[:, None], np.nan, laxity.coordinates)
        return Evaluator(self.problem(replace(laxity, coordinates=coordinates)))

    def _past(self, found: Constrained, aside: BoolArray) -> tuple[Constrained, BoolArray]:
        """The search gone on without the trials that bar it, and those set aside."""
        for _ in range(MOST_ROUNDS):
            barring, start = self._on_the_way(found.evaluation, aside)
            if not barring.any() and start is found.evaluation.theta:
                break
            aside = aside | barring
            found = self._search(start, aside)
        return found, aside

    def _on_the_way(self, at: Evaluation, aside: BoolArray) -> tuple[BoolArray, Array]:
        """The trials whose misfit ends or jumps on the way that the others want to go.

        And where to go on: at the lowest point of that way where none does, else from here.
        """
        step = -np.linalg.lstsq(at.jacobian, at.residuals, rcond=None)[0]
        after = at.residuals + at.jacobian @ step
        promised = at.deviance - float(after @ after)
        barring, lowest, start = np.zeros(aside.size, bool), at.deviance - WORTH, at.theta
        if promised < WORTH:
            return barring, start
        evaluator = self._evaluator(aside)
        parameters, here = evaluator.parameters, self._misfits(at.theta)
        for share in SHARES:
            theta = np.clip(at.theta + share * step, parameters.lower, parameters.upper)
            # What is set aside has no pose on either side.
            rise = np.where(aside, 0.0, self._misfits(theta)) - np.where(aside, 0.0, here)
            if not np.isfinite(rise).all():
                return ~np.isfinite(rise), at.theta
            if share in JUMPS and rise.max() > A_JUMP * promised:
                return rise > A_JUMP * promised, at.theta
            if (deviance := evaluator.deviance(theta)) < lowest:
                lowest, start = deviance, theta
        return barring, start

    def _misfits(self, theta: Array) -> Array:
        """Squared differences of each trial with data, infinite without equilibrium, ``(n,)``."""
        laxity = self.compared.laxity
        differences = self.compared.differences(self.expand(theta))
        if laxity.sd is not None:
            differences = differences / laxity.sd
        squares = np.where(laxity.is_measured, differences**2, 0.0).sum(axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    def _is_lost(self, theta: Array) -> BoolArray:
        return np.isinf(self._misfits(theta))

    def _contradicts(
        self, best: Constrained, without: Constrained, out: BoolArray, lost: BoolArray
    ) -> bool:
        """Whether the trials `lost` cost more misfit than so many values of the others have."""
        measured = self.compared.laxity.is_measured
        n, n_lost = int(measured[~lost].sum()), int(measured[lost & ~out].sum())
        scale = without.evaluation.deviance / max(n - without.evaluation.theta.size, 1)
        cost = best.evaluation.deviance - without.evaluation.deviance
        return bool(cost > scale * chdtri(n_lost, 1.0 - LEVEL))
