"""The farthest step that a Gauss-Newton model of a region allows."""

import clarabel
import numpy as np
from scipy import sparse

from identknee.identify.equivalents.region import Blocks
from identknee.runs.arrays import Array
from identknee.runs.declare import declared

# Of the best step, whose value is about 1; and what is taken where rounding forbids that.
GAP, LARGEST_GAP = 1e-10, 1e-7


@declared
class Step:
    """The best step of a model.

    Attributes
    ----------
    step
        The step, shape ``(n,)``.
    excess
        How much the limit of 1 had to be raised for it, about 0 where the model's region is not
        empty.
    multipliers
        By how much the best gain grows with the limit of each block, shape ``(n_blocks,)``.
    """

    step: Array
    excess: float
    multipliers: Array


@declared
class Model:
    """What a search knows around a point, in the units of its steps.

    Attributes
    ----------
    gain
        Derivatives of the quantity, shape ``(n,)``, of such a size that the best step's gain is
        about 1.
    blocks
        The region's blocks, finite.
    low, high
        Bounds of the step, shape ``(n,)``, with ``low < high`` and 0 between them.
    """

    gain: Array
    blocks: Blocks
    low: Array
    high: Array


def best_step(model: Model, *, penalty: float) -> Step:
    """The step of largest gain, less `penalty` times the excess, in a model.

    It keeps to ``|offsets[b] + slopes[b] @ step|^2 <= 1 + excess`` for every block, to the model's
    bounds and to ``excess >= 0``: a second-order cone program with an interior whatever the blocks
    are, solved by Clarabel's interior-point method.

    Parameters
    ----------
    model
        What to maximise, and where.
    penalty
        Price of an excess; large enough, and there is none unless the model's region is empty.

    References
    ----------
    P. J. Goulart and Y. Chen, Clarabel: An interior-point solver for conic programs with quadratic
    objectives (2024), doi:10.48550/arXiv.2405.12762.
    """
    n_blocks, k, n = model.blocks.slopes.shape
    n_linear = 2 * n + 1
    matrix = np.zeros((n_linear + n_blocks * (k + 2), n + 1))
    right = np.zeros(len(matrix))
    matrix[:n, :n], right[:n] = -np.eye(n), -model.low
    matrix[n : 2 * n, :n], right[n : 2 * n] = np.eye(n), model.high
    matrix[2 * n, n] = -1.0
    # |u|^2 <= 1 + excess is |(excess, 2 u)| <= 2 + excess, which is what a cone can say.
    rows, ends = matrix[n_linear:].reshape(n_blocks, k + 2, n + 1), right[n_linear:]
    rows[:, :2, n], rows[:, 2:, :n] = -1.0, -2.0 * model.blocks.slopes
    ends = ends.reshape(n_blocks, k + 2)
    ends[:, 0], ends[:, 2:] = 2.0, 2.0 * model.blocks.offsets
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((n + 1, n + 1)),
        np.r_[-model.gain, penalty],
        sparse.csc_matrix(matrix),
        right,
        [clarabel.NonnegativeConeT(n_linear), *(clarabel.SecondOrderConeT(k + 2),) * n_blocks],
        _settings(),
    ).solve()
    point = np.array(solution.x)
    forces = np.array(solution.z)[n_linear:].reshape(n_blocks, k + 2)
    return Step(
        step=np.clip(point[:n], model.low, model.high),
        excess=max(float(point[n]), 0.0),
        multipliers=forces[:, 0] + forces[:, 1],
    )


def _settings() -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # The problems are tiny, and other processes have the other cores.
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = GAP
    settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = LARGEST_GAP
    settings.reduced_tol_feas = LARGEST_GAP
    return settings
