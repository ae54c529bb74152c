"""The linear least-squares step within bounds and across one linear constraint."""

import numpy as np
from scipy.linalg import qr, solve_triangular

from identknee.calibrate.tolerances import STEP_RANK_TOLERANCE
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import declared

# What is smaller has no inverse among floating-point numbers.
SMALLEST = 1e-150
ROUNDS_PER_PARAMETER = 10
NEGLIGIBLE = 1e-14
# How often whole blocks of components change sides, and how clear of its tolerance a triangle has
# to be.
MOST_BLOCKS, CLEAR = 20, 1e3
# Share of its largest that the smallest number on the diagonal of a triangle must have for its
# square to be solved with.
LEAST_DIAGONAL = 1e-6


@declared
class Step:
    """The lowest point of a linear model, and what holds it there.

    Attributes
    ----------
    step
        Shape ``(n,)``.
    multiplier
        Derivative of half the sum of squares by the constraint's right-hand side.
    is_held
        Which components a bound keeps from going lower, shape ``(n,)``.
    """

    step: Array
    multiplier: float
    is_held: BoolArray


def bounded_step(
    matrix: Array, data: Array, bounds: tuple[Array, Array], constraint: tuple[Array, float] | None
) -> Step:
    """The step d that makes ``|matrix d + data|`` least within bounds and on a plane.

    A primal active-set method: from a point within the bounds and on the plane it goes to the
    lowest point over the components that are free, holds the first component that meets a bound on
    the way, and lets go of the one that pulls hardest inward when nothing else is left to do.
    Along directions that change nothing it stays where it is.

    Parameters
    ----------
    matrix, data
        Shapes ``(m, n)`` and ``(m,)``.
    bounds
        Lower and upper bounds of d, shapes ``(n,)``; zero lies between them.
    constraint
        Vector a, shape ``(n,)``, and number c of the plane ``a d = c``; c is brought into the range
        that the bounds allow.

    References
    ----------
    J. Nocedal and S. J. Wright, Numerical Optimization, 2nd ed. (2006), algorithm 16.3,
    doi:10.1007/978-0-387-40065-5.
    """
    n = matrix.shape[1]
    triangle = np.asarray(np.linalg.qr(np.column_stack([matrix, data]), mode="r"))[:n]
    return _ActiveSet(triangle[:, :n], triangle[:, n], bounds, constraint).solve()


def attainable(normal: Array, bounds: tuple[Array, Array], wanted: float) -> float:
    """The number nearest to `wanted` that ``normal d`` can be within the bounds."""
    has_say = normal != 0.0
    ends = np.array([normal[has_say] * bounds[0][has_say], normal[has_say] * bounds[1][has_say]])
    return float(np.clip(wanted, ends.min(axis=0).sum(), ends.max(axis=0).sum()))


def point_on_plane(normal: Array, bounds: tuple[Array, Array], wanted: float) -> Array:
    """A point within the bounds at which ``normal d`` is `wanted`, which they must allow.

    It is the point of the shortest way along the normal, cut off at the bounds.
    """
    step = np.zeros(normal.size)
    is_free = normal != 0.0
    # Each round either arrives or stops one more component at its bound.
    for _ in range(normal.size):
        missing = wanted - normal @ step
        length = float(normal[is_free] @ normal[is_free])
        if length == 0.0 or abs(missing) <= NEGLIGIBLE * max(abs(wanted), 1e-300):
            break
        tried = step + is_free * normal * (missing / length)
        step = np.clip(tried, *bounds)
        is_free &= step == tried
    return step


class _ActiveSet:
    """The state of one search: where it is and which components are held."""

    def __init__(
        self,
        matrix: Array,
        data: Array,
        bounds: tuple[Array, Array],
        constraint: tuple[Array, float] | None,
    ) -> None:
        n = matrix.shape[1]
        self._matrix, self._data = matrix, data
        self._size = float(np.linalg.norm(matrix))
        self._lower, self._upper = bounds
        self._normal = None if constraint is None else constraint[0]
        self._held = np.zeros(n, dtype=np.bool_)
        if constraint is None:
            self._at = np.zeros(n)
            if _is_of_full_rank(matrix):
                self._at, self._held = _near_the_lowest(matrix, data, bounds)
        else:
            normal, wanted = constraint
            self._at = point_on_plane(normal, bounds, attainable(normal, bounds, wanted))

    def solve(self) -> Step:
        for _ in range(ROUNDS_PER_PARAMETER * len(self._at)):
            if not self._go_to_lowest():
                continue
            if not self._let_go():
                break
        multiplier, _ = self._forces()
        return Step(step=self._at, multiplier=multiplier, is_held=self._held)

    def _go_to_lowest(self) -> bool:
        """Move over the free components; False if a bound was met on the way."""
        free = np.flatnonzero(~self._held)
        move = np.zeros(len(self._at))
        move[free] = self._free_move(free)
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(move > 0, self._upper - self._at, self._lower - self._at) / move
        room[move == 0.0] = np.inf
        first = int(np.argmin(room))
        if room[first] >= 1.0:
            self._at = np.clip(self._at + move, self._lower, self._upper)
            return True
        self._at = np.clip(self._at + max(room[first], 0.0) * move, self._lower, self._upper)
        self._at[first] = self._upper[first] if move[first] > 0 else self._lower[first]
        self._held[first] = True
        return False

    def _free_move(self, free: IntArray) -> Array:
        matrix = self._matrix[:, free]
        missing = self._matrix @ self._at + self._data
        least = max(STEP_RANK_TOLERANCE * self._size, SMALLEST)
        if self._normal is None:
            return _lowest_move(matrix, missing, least)
        basis = _null_space(self._normal[free])
        return np.asarray(basis @ _lowest_move(matrix @ basis, missing, least))

    def _let_go(self) -> bool:
        """Free the held component that pulls hardest inward; False if none does."""
        _, force = self._forces()
        inward = np.where(self._at >= self._upper, force, -force)
        inward[~self._held | (self._lower == self._upper)] = 0.0
        hardest = int(np.argmax(inward))
        size = float(np.max(np.abs(self._matrix.T @ self._data), initial=0.0))
        if inward[hardest] <= STEP_RANK_TOLERANCE * size:
            return False
        self._held[hardest] = False
        return True

    def _forces(self) -> tuple[float, Array]:
        """Multiplier of the constraint, and the derivatives that it leaves, shape ``(n,)``."""
        slope = self._matrix.T @ (self._matrix @ self._at + self._data)
        if self._normal is None:
            return 0.0, slope
        normal = np.where(self._held, 0.0, self._normal)
        if not normal.any():
            normal = self._normal
        size = float(normal @ normal)
        multiplier = float(normal @ slope) / size if size > 0 else 0.0
        return multiplier, slope - multiplier * self._normal


def _near_the_lowest(
    matrix: Array, data: Array, bounds: tuple[Array, Array]
) -> tuple[Array, BoolArray]:
    """A point within the bounds near the lowest one, and what is held there.

    All components that a bound stops or lets go change sides at once, which seldom takes more than
    a few rounds but need not end: a beginning for a search that does.

    References
    ----------
    J. J. Judice and F. M. Pires, A block principal pivoting algorithm for large-scale strictly
    monotone linear complementarity problems, Comput. Oper. Res. 21 (1994) 587-596,
    doi:10.1016/0305-0548(94)90106-6.
    """
    square, slope = matrix.T @ matrix, matrix.T @ data
    side = np.zeros(len(slope))
    at = np.zeros(len(slope))
    for _ in range(MOST_BLOCKS):
        free = side == 0.0
        tried = np.where(free, 0.0, np.where(side < 0.0, *bounds))
        tried[free] = np.linalg.solve(square[free][:, free], -(slope + square @ tried)[free])
        at, held = np.clip(tried, *bounds), ~free
        pushed = side * (square @ tried + slope) > 0.0
        met = np.sign(tried - at)
        now = np.where(free, met, np.where(pushed, 0.0, side))
        if np.array_equal(now, side):
            return at, held
        side = now
    return at, (side != 0.0) & (at == np.where(side < 0.0, *bounds))


def _is_of_full_rank(triangle: Array) -> bool:
    """Whether the square of a triangle can be solved with."""
    diagonal = np.abs(np.diagonal(triangle))
    if len(triangle) < triangle.shape[1] or not diagonal.size:
        return False
    return bool(diagonal.min() > max(LEAST_DIAGONAL * diagonal.max(), SMALLEST))


def _lowest_move(matrix: Array, missing: Array, least: float) -> Array:
    """The shortest move to where ``matrix d + missing`` is least.

    Singular values up to `least` count as zero.
    """
    if matrix.shape[1] == 0:
        return np.zeros(0)
    orthogonal, triangle, order = qr(matrix, mode="economic", pivoting=True, check_finite=False)
    if len(triangle) == len(order) and abs(triangle[-1, -1]) > CLEAR * least:
        move = np.empty(len(order))
        move[order] = solve_triangular(triangle, orthogonal.T @ -missing, check_finite=False)
        return move
    left, size, right = np.linalg.svd(matrix, full_matrices=False)
    known = size > least
    return np.asarray(right[known].T @ (left[:, known].T @ -missing / size[known]))


def _null_space(normal: Array) -> Array:
    """Orthonormal directions across `normal`, as columns; all directions where it is zero."""
    n = len(normal)
    if not normal.any():
        return np.eye(n)
    if np.count_nonzero(normal) == 1:
        return np.delete(np.eye(n), int(np.flatnonzero(normal)[0]), axis=1)
    return np.linalg.qr(normal[:, None], mode="complete")[0][:, 1:]
