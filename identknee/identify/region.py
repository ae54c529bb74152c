"""The region of parameter sets with predictions equivalent to a given one's."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
import scipy

from identknee.calibrate.evaluation import Evaluation, Evaluator
from identknee.calibrate.problem import Problem, typical_steps
from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import OF_PARAMETER, array, declared, entry

ALL = "all"
LEVEL = 0.05


@declared
class Region:
    """Parameter sets whose predictions differ from those at `center` by no more than a limit.

    The difference is measured in blocks. The value of a block is the weighted sum of squares
    ``sum_i (weight_i (r_i(theta) - r_i(center)))^2`` of the residuals `r`; since both residuals
    are taken against the same data, that is the difference of two predictions. A parameter set
    belongs to the region where it is within the bounds, has a prediction, and no block's value
    exceeds the limit.

    One block of weight 1 on residuals in units of their noise is the squared noise-weighted
    distance D^2 of two predictions.
    """

    problem: Problem = entry("The problem")
    center: Array = array("Theta of the fit", "parameter", unit=OF_PARAMETER)
    blocks: Mapping[str, Array] = entry("Weights of the residuals by name of the block")
    limit: float = entry("The largest value of a block", default=1.0)

    def __post_init__(self) -> None:
        if not 0 < self.limit < np.inf:
            raise ValueError(f"the limit must be greater than 0 and finite, got {self.limit:g}")
        if not self.blocks:
            raise ValueError("there is no block of residuals to compare predictions by; give one")


def noise_region(problem: Problem, center: Array, *, limit: float = 1.0) -> Region:
    """The region in which D^2, the squared noise-weighted distance of predictions, is in the limit.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise.
    center
        Theta of the fit, shape ``(n,)``.
    limit
        Largest D^2. At 1 the best one-sided 5 % test of one prediction against the other has a
        power of 26 % (see `power_of_best_test`).

    Raises
    ------
    ValueError
        If the limit is not greater than 0.
    """
    m = np.asarray(problem.residuals(np.array(center, dtype=np.float64))).size
    return Region(problem=problem, center=center, blocks={ALL: np.ones(m)}, limit=limit)


def power_of_best_test(squared_distance: float) -> float:
    """Power of the best one-sided 5 % test between two predictions by one measurement.

    Both predictions are known and the noise is normal, so that the likelihood-ratio test is the
    most powerful one there is (Neyman and Pearson); it sees a shift of D standard deviations.

    Parameters
    ----------
    squared_distance
        D^2, not negative.

    Examples
    --------
    >>> round(power_of_best_test(1.0), 2)
    0.26
    """
    return float(scipy.stats.norm.sf(scipy.stats.norm.isf(LEVEL) - np.sqrt(squared_distance)))


@declared
class Blocks:
    """The blocks of a region at one theta, each with its Gauss-Newton model, limits taken as 1.

    After a step `d` the model gives block b the value ``|offsets[b] + slopes[b] @ d|^2``.

    Attributes
    ----------
    offsets
        Weighted differences of the predictions, shape ``(n_blocks, k)``; infinite where there is
        no prediction.
    slopes
        Their derivatives, shape ``(n_blocks, k, n)``.
    """

    offsets: Array
    slopes: Array

    @property
    def values(self) -> Array:
        """Value of each block over the limit, shape ``(n_blocks,)``; inf without a prediction."""
        return np.asarray(np.einsum("bk,bk->b", self.offsets, self.offsets))

    @property
    def largest(self) -> float:
        """The largest of these: the point is inside up to 1."""
        return float(self.values.max())


class RegionConstraints(Protocol):
    """Constraints of a search for an extremum."""

    @property
    def lower(self) -> Array:
        """Lower bounds, shape ``(n,)``."""
        ...

    @property
    def upper(self) -> Array:
        """Upper bounds, shape ``(n,)``."""
        ...

    @property
    def steps(self) -> Array:
        """Typical steps, shape ``(n,)``."""
        ...

    def __call__(self, theta: Array) -> Blocks:
        """Blocks at `theta`, shape ``(n,)``."""
        ...


class RegionView:
    """A region as a search sees it, its simulations counted.

    Parameters
    ----------
    region
        The region.

    Raises
    ------
    ValueError
        If the model has no prediction at the fit, or weights and residuals differ in number.
    """

    def __init__(self, region: Region) -> None:
        self.region = region
        self.evaluator = Evaluator(region.problem)
        self.lower = region.problem.parameters.lower
        self.upper = region.problem.parameters.upper
        self.steps = typical_steps(region.problem.parameters)
        center = self.evaluator(region.center)
        if not center.is_finite:
            raise ValueError(
                "the model has no prediction at the parameter set to compare with; "
                "give a fitted one"
            )
        self._at_center = center.residuals
        m = center.residuals.size
        self._rows = []
        for name, weights in region.blocks.items():
            checked = frozen(weights, m, name=f"the weights of {name}") / np.sqrt(region.limit)
            rows = np.flatnonzero(checked)
            self._rows.append((rows, checked[rows]))

    @property
    def n_simulations(self) -> int:
        """Simulations made so far."""
        return self.evaluator.n_simulations

    def __call__(self, theta: Array) -> Blocks:
        """Blocks at `theta`, shape ``(n,)``: one simulation."""
        return self._blocks(self.evaluator(theta))

    def _blocks(self, evaluation: Evaluation) -> Blocks:
        n = evaluation.theta.size
        shape = (len(self._rows), n + 1)
        if not evaluation.is_finite:
            return Blocks(offsets=np.full(shape, np.inf), slopes=np.full((*shape, n), np.nan))
        difference = evaluation.residuals - self._at_center
        offsets, slopes = np.zeros(shape), np.zeros((*shape, n))
        for b, (rows, weights) in enumerate(self._rows):
            rows_of_block = weights[:, None] * np.c_[evaluation.jacobian[rows], difference[rows]]
            # The triangle has the same lengths as the many rows it stands for.
            triangle = np.asarray(np.linalg.qr(rows_of_block, mode="r"))
            slopes[b, : len(triangle)] = triangle[:, :n]
            offsets[b, : len(triangle)] = triangle[:, n]
        return Blocks(offsets=offsets, slopes=slopes)


class PairView:
    """Two points of the same region as one point of twice as many parameters.

    Parameters
    ----------
    view
        The region.
    """

    def __init__(self, view: RegionView) -> None:
        self._view = view
        self.lower = np.tile(view.lower, 2)
        self.upper = np.tile(view.upper, 2)
        self.steps = np.tile(view.steps, 2)

    def __call__(self, theta: Array) -> Blocks:
        """Blocks of both points, shape ``(2 n,)``: two simulations."""
        n = theta.size // 2
        first, second = self._view(theta[:n]), self._view(theta[n:])
        nothing = np.zeros_like(first.slopes)
        return Blocks(
            offsets=np.concatenate([first.offsets, second.offsets]),
            slopes=np.concatenate(
                [
                    np.concatenate([first.slopes, nothing], axis=2),
                    np.concatenate([nothing, second.slopes], axis=2),
                ]
            ),
        )
