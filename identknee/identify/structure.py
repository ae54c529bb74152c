"""Structural identifiability: the rank of the sensitivities at random points."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.problem import RANK_TOLERANCE, Problem
from identknee.identify.information import scaled_units
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.progress import progress

N_POINTS = 64
NO_RANK = -1
# Derivatives by a scaled unit below this part of the noise are those of no influence.
NO_INFLUENCE = 1e-12


class Structure(Enum):
    """The verdict on structural identifiability."""

    FULL_RANK = "full_rank"
    RANK_DEFICIENT = "rank_deficient"
    UNKNOWN = "unknown"

    @property
    def sentence(self) -> str:
        """It, as a full sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    Structure.FULL_RANK: "All parameters are structurally identifiable (locally).",
    Structure.RANK_DEFICIENT: (
        "Even noise-free data would leave a combination of parameters undetermined."
    ),
    Structure.UNKNOWN: "The model has no prediction at any of the random points.",
}


@declared
class StructureCheck:
    """Ranks of the sensitivities at random points of the box."""

    seed: int = entry("Seed of the points", unit="1")
    undetermined: tuple[str, ...] = entry(
        "Parameters that have a part in the undetermined directions of the points of largest rank; "
        "none if that rank is full"
    )
    thetas: Array = array("Points", "point", "parameter", unit=OF_PARAMETER, key="theta")
    ranks: IntArray = array(
        "Rank of the Jacobian at each point; -1 where the model has no prediction",
        "point",
        dtype=int,
        key="rank",
    )
    singular_values: Array = array(
        "Singular values of the Jacobian with columns of length 1, from large to small; NaN where "
        "the model has no prediction",
        *("point", "direction"),
        key="singular_value",
    )
    has_no_influence: BoolArray = array(
        "Whether a parameter changes no residual there at all, as those of a slack ligament",
        *("point", "parameter"),
        dtype=bool,
    )

    @property
    def has_prediction(self) -> BoolArray:
        """Whether the model has a prediction at each point, shape ``(k,)``."""
        return np.asarray(self.ranks != NO_RANK)

    @property
    @derived("Points drawn", unit="1")
    def n_points(self) -> int:
        """Number of points drawn."""
        return len(self.ranks)

    @property
    @derived("Points with a prediction", unit="1")
    def n_with_prediction(self) -> int:
        """Number of points with a prediction."""
        return int(self.has_prediction.sum())

    @property
    @derived("Largest rank met; -1 where there is no prediction at any point", unit="1")
    def rank(self) -> int:
        """The largest rank met, that of almost all points where derivatives are analytic."""
        return int(self.ranks.max())

    @property
    @derived("Whether data without noise would determine every parameter")
    def verdict(self) -> Structure:
        """The verdict on the parameters."""
        if self.rank == NO_RANK:
            return Structure.UNKNOWN
        is_full = self.rank == self.thetas.shape[1]
        return Structure.FULL_RANK if is_full else Structure.RANK_DEFICIENT

    @property
    @derived("What the verdict means")
    def sentence(self) -> str:
        """What the verdict means, as a full sentence."""
        return self.verdict.sentence


def check_structure(
    problem: Problem,
    *,
    n_points: int = N_POINTS,
    seed: int = 0,
    executor: Executor = serial,
) -> StructureCheck:
    """The rank of the sensitivities at random points of the box.

    A parameter that is structurally undetermined is so at every point; one that a slack ligament
    leaves without influence is so at some.

    Parameters
    ----------
    problem
        With exact derivatives; those by differences hide a deficient rank in their errors.
    n_points
        How many scrambled Sobol points to try; those without a prediction are kept as data.
    seed
        Seed of their scrambling.
    executor
        Anything with an ordered ``map``.

    Raises
    ------
    ValueError
        If fewer than one point is asked for, or a bound is not finite.

    References
    ----------
    J. A. Jacquez and P. Greif, Numerical parameter identifiability and estimability, Math. Biosci.
    77 (1985) 201-227, doi:10.1016/0025-5564(85)90098-7.
    """
    parameters = problem.parameters
    thetas = _points(parameters, n_points, seed)
    found = executor.map(_PointRank(problem=problem), thetas)
    rows = list(progress(found, total=len(thetas), description="ranks"))
    ranks = np.array([rank for rank, _, _, _ in rows])
    best = [row for row in rows if row[0] == ranks.max() != NO_RANK]
    loose = np.any([row[3] for row in best], axis=0) if best else np.zeros(parameters.n, bool)
    return StructureCheck(
        seed=seed,
        thetas=thetas,
        ranks=ranks,
        singular_values=np.array([sizes for _, sizes, _, _ in rows]),
        has_no_influence=np.array([dead for _, _, dead, _ in rows]),
        undetermined=tuple(np.array(parameters.names)[loose].tolist()),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PointRank:
    """The rank at a point: a class, so that it reaches other processes."""

    problem: Problem

    def __call__(self, theta: Array) -> tuple[int, Array, BoolArray, BoolArray]:
        """Rank, singular values, parameters without influence, those in undetermined directions."""
        parameters = self.problem.parameters
        n = parameters.n
        at = evaluate(self.problem, theta)
        if not at.is_finite:
            return NO_RANK, np.full(n, np.nan), np.zeros(n, bool), np.zeros(n, bool)
        jacobian = at.jacobian * scaled_units(parameters, "typical")
        lengths = np.linalg.norm(jacobian, axis=0)
        dead = lengths < NO_INFLUENCE
        columns = np.where(dead, 0.0, jacobian / np.where(dead, 1.0, lengths))
        padded = np.vstack([columns, np.zeros((n, n))])
        _, sizes, rows = np.linalg.svd(padded, full_matrices=False)
        is_known = sizes > RANK_TOLERANCE * max(float(sizes[0]), 1.0)
        loose = (np.abs(rows[~is_known]) > np.sqrt(RANK_TOLERANCE)).any(axis=0)
        return int(is_known.sum()), sizes, dead, loose


def _points(parameters: Parameters, n_points: int, seed: int) -> Array:
    if n_points < 1:
        raise ValueError(f"the number of points must be at least 1, got {n_points}")
    bounds = np.stack([parameters.lower, parameters.upper])
    if not np.isfinite(bounds).all():
        i = int(np.flatnonzero(~np.isfinite(bounds).all(axis=0))[0])
        raise ValueError(
            f"{parameters.names[i]} has no finite bounds to draw points from; set them with "
            "with_bounds"
        )
    # Sobol points are balanced in powers of two only; the rest of such a set is left out.
    drawn = scipy.stats.qmc.Sobol(parameters.n, seed=seed).random_base2(
        int(np.ceil(np.log2(n_points)))
    )
    return np.asarray(bounds[0] + (bounds[1] - bounds[0]) * drawn[:n_points])
