"""What makes a set of added trials good: losses that a sum over the trials determines.

Every trial has features, numbers that add up over the trials of a set; a loss is a function of the
sum. A set is then judged without another simulation.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np

from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import declared

Criterion = Literal["D", "A", "E", "c", "width"]
CRITERIA: tuple[Criterion, ...] = ("D", "A", "E", "c", "width")
# A direction that nothing determines counts as known to 1,000 scaled units.
LEAST_INFORMATION = 1e-6
# Least rise of the root of the deviance: one flatter would be extrapolated without limit.
LEAST_RISE = 1e-6
# Share of that root: how far below the threshold a profile may end that was followed to it.
END_TOLERANCE = 1e-3


class Loss(Protocol):
    """A number to be made small."""

    def of_made(self, information: Array) -> Array:
        """Features of the trials made, shape ``(f,)``, from their scaled information at the points.

        The information has shape ``(q, n, n)``.
        """
        ...

    def of_trials(self, values: Array, jacobians: Array) -> Array:
        """Features of k trials, shape ``(k, f)``.

        From their predictions at q points in units of the noise, shape ``(q, k, m)``, and the
        derivatives of these by the scaled parameters, ``(q, k, m, n)``.
        """
        ...

    def __call__(self, features: Array) -> Array:
        """The loss of each row of summed features, shape ``(k,)`` from ``(k, f)``."""
        ...


@declared
class LocalLoss:
    """D-, A-, E- or c-optimality of the information at the first point, the best fit.

    What is asked is the covariance of the parameters of interest, nuisances integrated out.

    Attributes
    ----------
    criterion
        ``"D"``: minus the log determinant; ``"A"``: the trace of the covariance; ``"E"``: its
        largest eigenvalue; ``"c"``: the log variances of the targets, summed.
    gradients
        Gradients of the targets by the scaled parameters at the best fit, shape ``(t, n)``.
    is_of_interest
        Which parameters are no nuisances, shape ``(n,)``.

    References
    ----------
    A. C. Atkinson, A. N. Donev and R. D. Tobias, Optimum Experimental Designs, with SAS (2007),
    chapter 10, ISBN 978-0-19-929660-6.
    """

    criterion: Criterion
    gradients: Array
    is_of_interest: BoolArray

    def of_made(self, information: Array) -> Array:
        """The scaled information at the best fit, shape ``(n n,)``."""
        return np.asarray(information[0].ravel())

    def of_trials(self, values: Array, jacobians: Array) -> Array:
        """Scaled information of each trial at the best fit, shape ``(k, n n)``."""
        at_fit = jacobians[0]
        return np.asarray(np.einsum("kmi,kmj->kij", at_fit, at_fit).reshape(values.shape[1], -1))

    def __call__(self, features: Array) -> Array:
        """The loss of each information, shape ``(k,)``."""
        if self.criterion == "c":
            return np.asarray(np.log(self.variances(features)).sum(axis=1))
        eigenvalues = np.linalg.eigvalsh(self._of_interest(self._matrices(features)))
        if self.criterion == "D":
            return np.asarray(-np.log(eigenvalues).sum(axis=1))
        if self.criterion == "A":
            return np.asarray((1.0 / eigenvalues).sum(axis=1))
        return np.asarray(1.0 / eigenvalues[:, 0])

    def variances(self, features: Array) -> Array:
        """Variance of each target by the linear model, shape ``(k, t)``."""
        inverse = np.linalg.inv(self._matrices(features))
        return np.asarray(np.einsum("ti,kij,tj->kt", self.gradients, inverse, self.gradients))

    def _matrices(self, features: Array) -> Array:
        n = self.gradients.shape[1]
        return np.asarray(features.reshape(-1, n, n) + LEAST_INFORMATION * np.eye(n))

    def _of_interest(self, matrices: Array) -> Array:
        """Inverses of the covariances of the parameters of interest: Schur complements."""
        asked = np.flatnonzero(self.is_of_interest)
        rest = np.flatnonzero(~self.is_of_interest)
        own, shared = (matrices[:, asked[:, None], x] for x in (asked, rest))
        within = matrices[:, rest[:, None], rest]
        taken = shared @ np.linalg.solve(within, np.swapaxes(shared, 1, 2))
        return np.asarray(own - taken)


@declared
class Path:
    """The profile of one target as it is before trials are added.

    Attributes
    ----------
    places
        Where its s points stand among the points at which trials are predicted, shape ``(s,)``.
    values, deltas
        The target there, from low to high, and the rise of the deviance, shape ``(s,)``.
    across
        Orthonormal directions of the scaled parameters that leave the target as it is, ``(s, n,
        n - 1)``.
    center
        The target at the best fit.
    threshold
        Rise of the deviance that bounds the interval.
    """

    places: IntArray
    values: Array
    deltas: Array
    across: Array
    center: float
    threshold: float

    def ends(self, deltas: Array) -> tuple[Array, BoolArray]:
        """Interval ends for k profiles on the same points, shape ``(k, 2)``, and which are open.

        Between points the root of the deviance is linear. An open end is put where the root would
        reach the threshold if it went on in proportion.
        """
        ends, is_open = np.empty((len(deltas), 2)), np.zeros((len(deltas), 2), bool)
        for side, sign in enumerate((-1.0, 1.0)):
            chosen = np.flatnonzero(sign * (self.values - self.center) > 0)[:: int(sign)]
            away = np.concatenate([[0.0], np.abs(self.values[chosen] - self.center)])
            roots = np.sqrt(np.maximum(deltas[:, chosen], 0.0))
            roots = np.hstack([np.zeros((len(deltas), 1)), roots])
            reach, goes_on = _first_crossing(away, roots, float(np.sqrt(self.threshold)))
            is_open[:, side] = goes_on
            ends[:, side] = self.center + sign * reach
        return ends, is_open


@declared
class WidthLoss:
    """Predicted widths of the targets' profiles, the sum of their logarithms.

    At every point of a target's profile the deviance of the added trials, at the values they would
    have at the best fit, is added, and the parameters that are free there give way by one linear
    step: an open end may close that a variance at the best fit knows nothing of.

    Attributes
    ----------
    paths
        The profiles of the targets.
    """

    paths: Sequence[Path]

    def of_made(self, information: Array) -> Array:
        """Each point's curvature across the target, no slope, and the rise of the deviance."""
        parts = []
        for path in self.paths:
            at = information[path.places]
            curved = np.einsum("sia,sij,sjb->sab", path.across, at, path.across)
            parts += [curved.ravel(), np.zeros(path.across[:, 0].size), path.deltas]
        return np.concatenate(parts)

    def of_trials(self, values: Array, jacobians: Array) -> Array:
        """Each point's curvature and slope across the target and the rise, for each trial."""
        k, parts = values.shape[1], []
        for path in self.paths:
            away = values[path.places] - values[0]
            across = np.einsum("skmi,sia->skma", jacobians[path.places], path.across)
            # Beyond what the data allow a trial may have no prediction: it then says nothing.
            known = np.isfinite(away).all(axis=2) & np.isfinite(across).all(axis=(2, 3))
            away = np.where(known[:, :, None], away, 0.0)
            across = np.where(known[:, :, None, None], across, 0.0)
            curved = np.einsum("skma,skmb->ksab", across, across)
            slope = np.einsum("skma,skm->ksa", across, away)
            rise = np.einsum("skm,skm->ks", away, away)
            parts += [curved.reshape(k, -1), slope.reshape(k, -1), rise]
        return np.hstack(parts)

    def __call__(self, features: Array) -> Array:
        """The sum of the log widths, shape ``(k,)``."""
        total = np.zeros(len(features))
        for ends, _ in self.intervals(features):
            total += np.log(np.maximum(ends[:, 1] - ends[:, 0], np.finfo(np.float64).tiny))
        return total

    def intervals(self, features: Array) -> list[tuple[Array, BoolArray]]:
        """Each target's predicted ends, ``(k, 2)``, and which of them are open."""
        intervals, k, at = [], len(features), 0
        for path in self.paths:
            s, _, a = path.across.shape
            sizes = np.cumsum([at, s * a * a, s * a, s])
            curved, slope, rise = (features[:, i:j] for i, j in pairwise(sizes))
            at = int(sizes[-1])
            matrices = curved.reshape(k, s, a, a) + LEAST_INFORMATION * np.eye(a)
            column = slope.reshape(k, s, a, 1)
            saved = (column * np.linalg.solve(matrices, column)).sum(axis=(2, 3))
            intervals.append(path.ends(rise - saved))
        return intervals


def directions_across(gradients: Array) -> Array:
    """Orthonormal directions across each gradient (s, n), shape ``(s, n, n - 1)``."""
    _, _, rows = np.linalg.svd(gradients[:, None, :], full_matrices=True)
    return np.asarray(np.swapaxes(rows[:, 1:], 1, 2))


def _first_crossing(away: Array, roots: Array, level: float) -> tuple[Array, BoolArray]:
    """How far out each row of roots first reaches the level, and which rows do not."""
    above = roots >= (1.0 - END_TOLERANCE) * level
    goes_on: BoolArray = np.asarray(~above.any(axis=1))
    after = np.where(goes_on, len(away) - 1, np.argmax(above, axis=1))
    rows, before = np.arange(len(roots)), np.maximum(after - 1, 0)
    rise = roots[rows, after] - roots[rows, before]
    share = (level - roots[rows, before]) / np.where(rise > 0, rise, 1.0)
    between = away[before] + share * (away[after] - away[before])
    beyond = away[-1] * level / np.maximum(roots[:, -1], LEAST_RISE)
    return np.where(goes_on, beyond, between), goes_on
