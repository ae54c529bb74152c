"""Bounded least squares by an active set, with or without a wanted value of a quantity.

The deviance ``D(theta) = |r(theta)|^2`` is minimised over ``lower <= theta <= upper``, and at
``q(theta) = c`` if asked. With scales s, the conditional standard deviations, and
``J = r' diag(s)``:

1. Step: ``d`` minimises ``|J d + r|^2`` over ``(lower - theta) / s <= d <= (upper - theta) / s``
   and ``|d_i| <= radius``, Gauss-Newton within bounds and a trust region [1]_, or the same with
   a curvature that is learned (`bounded_step`).
2. Active bounds: with the slope ``g = J'(J d + r) - lambda a`` a bound stays active while g pushes
   against it; the component with the most negative multiplier is released (algorithm 16.3 of [1]_).
3. Constraint: ``a'd = c - q`` with ``a = q' diag(s)``, as far as the bounds allow; ``lambda`` is
   its multiplier. A target that is missed costs the exact penalty ``rho |q - c|``, rho at least
   twice the multiplier of D (section 15.4 of [1]_).
4. Acceptance: by actual over predicted reduction, which also sets the radius (chapter 4 of [1]_).
5. Nonsmooth steps: where the derivatives of r jump, d minimises the highest of the linear models
   of both sides, ``min_d max_k |J_k d + r_k|^2``, by its dual over weights of the models [2]_
   (`KinkModels`). Before such a search ends, a short step by the own model confirms the kink.
6. Stopping: at a minimum no step within the bounds predicts a reduction above the tolerance, on
   target; at a cliff every such step within the trust region has no prediction; else the search
   ends as a valley.

This is the method near a minimum and with a constraint. Far from a minimum slack ligaments have no
derivatives and an active set is trapped at bounds: there `identknee.calibrate.least_squares` is
used.

References
----------
.. [1] J. Nocedal and S. J. Wright, Numerical Optimization, 2nd ed. (2006),
       doi:10.1007/978-0-387-40065-5.
.. [2] K. C. Kiwiel, Methods of Descent for Nondifferentiable Optimization (1985), chapter 2,
       doi:10.1007/BFb0074500.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.linalg import qr, solve_triangular
from scipy.linalg.lapack import dposv

from identknee.calibrate.problem import (
    LARGE,
    STEP_RANK_TOLERANCE,
    Evaluation,
    Evaluator,
    LinearisedResiduals,
    Quantity,
    SearchEnded,
    clear_root,
    conditional_sds,
    jump,
    thin_svd,
)
from identknee.runs.declare import Array, BoolArray, declared, entry
from identknee.runs.record import Outcome

# Below this the inverse of a number overflows.
SMALLEST = 1e-150
ROUNDS_PER_PARAMETER = 10
NEGLIGIBLE = 1e-14
# Rounds in which whole blocks of components become active or free, and the factor by which a
# triangular factor must exceed the rank tolerance to be used without an SVD.
MOST_BLOCKS, CLEAR = 20, 1e3
# Least ratio of smallest to largest diagonal entry of a triangular factor at which the normal
# equations are solved with it.
LEAST_DIAGONAL = 1e-6


@declared
class BoundedStep:
    """The constrained minimum of a linear model, with its active bounds."""

    step: Array = entry("The step, shape ``(n,)``")
    multiplier: float = entry(
        "Derivative of half the sum of squares by the constraint's right-hand side"
    )
    is_held: BoolArray = entry("Which components are at an active bound, shape ``(n,)``")


def bounded_step(
    matrix: Array, data: Array, bounds: tuple[Array, Array], constraint: tuple[Array, float] | None
) -> BoundedStep:
    """The step d that minimises ``|matrix d + data|`` within bounds and on a plane.

    A primal active-set method: from a point within the bounds and on the plane it goes to the
    lowest point over the components that are free, makes the first bound on the way active, and
    releases the component with the most negative multiplier when nothing else is left to do.
    Along directions that change nothing it stays where it is.

    Parameters
    ----------
    matrix, data
        Shapes ``(m, n)`` and ``(m,)``.
    bounds
        Lower and upper bounds of d, shapes ``(n,)``; zero lies between them.
    constraint
        Vector a, shape ``(n,)``, and number c of the plane ``a d = c``; c is clipped to the range
        that the bounds allow.
    """
    n, rows = matrix.shape[1], np.column_stack([matrix, data])
    # A large matrix that is triangular already needs no factorisation.
    is_done = len(rows) <= n + 1 > LARGE and not np.tril(rows, -1).any()
    triangle = rows if is_done else np.asarray(np.linalg.qr(rows, mode="r"))
    return _ActiveSet(triangle[:n, :n], triangle[:n, n], bounds, constraint).solve()


def nearest_attainable(normal: Array, bounds: tuple[Array, Array], wanted: float) -> float:
    """The value nearest to `wanted` that ``normal d`` can attain within the bounds."""
    has_say = normal != 0.0
    ends = np.array([normal[has_say] * bounds[0][has_say], normal[has_say] * bounds[1][has_say]])
    return float(np.clip(wanted, ends.min(axis=0).sum(), ends.max(axis=0).sum()))


def feasible_point(normal: Array, bounds: tuple[Array, Array], wanted: float) -> Array:
    """A feasible point at which ``normal d`` equals `wanted`; one must exist.

    It is reached by steps along the normal that are clipped to the bounds.
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
        self._is_clear = _has_full_rank(matrix)
        if constraint is None:
            self._at = np.zeros(n)
            if self._is_clear:
                self._at, self._held = _initial_point(matrix, data, bounds)
        else:
            normal, wanted = constraint
            self._at = feasible_point(normal, bounds, nearest_attainable(normal, bounds, wanted))

    def solve(self) -> BoundedStep:
        for _ in range(ROUNDS_PER_PARAMETER * len(self._at)):
            # Go to the lowest point over the free components, or to the first bound on the way.
            free = np.flatnonzero(~self._held)
            move = np.zeros(len(self._at))
            matrix = self._matrix[:, free]
            missing = self._matrix @ self._at + self._data
            least = max(STEP_RANK_TOLERANCE * self._size, SMALLEST)
            if self._normal is None and self._is_clear and free.size == len(move) > LARGE:
                move = solve_triangular(matrix, -missing, check_finite=False)
            elif self._normal is None:
                move[free] = _least_norm_step(matrix, missing, least)
            else:
                basis = _null_space(self._normal[free])
                move[free] = np.asarray(basis @ _least_norm_step(matrix @ basis, missing, least))
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(move > 0, self._upper - self._at, self._lower - self._at) / move
            room[move == 0.0] = np.inf
            first = int(np.argmin(room))
            if room[first] >= 1.0:
                self._at = np.clip(self._at + move, self._lower, self._upper)
            else:
                part = max(room[first], 0.0) * move
                self._at = np.clip(self._at + part, self._lower, self._upper)
                self._at[first] = self._upper[first] if move[first] > 0 else self._lower[first]
                self._held[first] = True
                continue
            # Release the active bound with the most negative multiplier.
            _, force = self._forces()
            inward = np.where(self._at >= self._upper, force, -force)
            inward[~self._held | (self._lower == self._upper)] = 0.0
            hardest = int(np.argmax(inward))
            size = float(np.max(np.abs(self._matrix.T @ self._data), initial=0.0))
            if inward[hardest] <= STEP_RANK_TOLERANCE * size:
                break
            self._held[hardest] = False
        multiplier, _ = self._forces()
        return BoundedStep(step=self._at, multiplier=multiplier, is_held=self._held)

    def _forces(self) -> tuple[float, Array]:
        """Multiplier of the constraint, and the remaining gradient, shape ``(n,)``."""
        slope = self._matrix.T @ (self._matrix @ self._at + self._data)
        if self._normal is None:
            return 0.0, slope
        normal = np.where(self._held, 0.0, self._normal)
        if not normal.any():
            normal = self._normal
        size = float(normal @ normal)
        multiplier = float(normal @ slope) / size if size > 0 else 0.0
        return multiplier, slope - multiplier * self._normal


def _initial_point(
    matrix: Array, data: Array, bounds: tuple[Array, Array]
) -> tuple[Array, BoolArray]:
    """A feasible point near the minimum, and the bounds active there.

    All components that a bound stops or releases change at once. This usually takes a few rounds,
    but may not converge, so that it only gives the start of the active-set search.

    References
    ----------
    J. J. Judice and F. M. Pires, A block principal pivoting algorithm for large-scale strictly
    monotone linear complementarity problems, Comput. Oper. Res. 21 (1994) 587-596,
    doi:10.1016/0305-0548(94)90106-6.
    """
    side, at = np.zeros(len(data)), np.zeros(len(data))
    if len(data) > LARGE:
        lowest = solve_triangular(matrix, -data, check_finite=False)
        at = np.clip(lowest, *bounds)
        side = np.sign(lowest - at)
        if not side.any():
            return at, side != 0.0
    square, slope = matrix.T @ matrix, matrix.T @ data
    for _ in range(MOST_BLOCKS):
        free = side == 0.0
        tried = np.where(free, 0.0, np.where(side < 0.0, *bounds))
        if free.any():
            tried[free] = _solved(square[free][:, free], -(slope + square @ tried)[free])
        at, held = np.clip(tried, *bounds), ~free
        pushed = side * (square @ tried + slope) > 0.0
        now = np.where(free, np.sign(tried - at), np.where(pushed, 0.0, side))
        if np.array_equal(now, side):
            return at, held
        side = now
    return at, (side != 0.0) & (at == np.where(side < 0.0, *bounds))


def _solved(square: Array, data: Array) -> Array:
    """The solution of a symmetric system."""
    if len(data) > LARGE:
        _, solution, failed = dposv(square, data)
        if not failed:
            return np.asarray(solution)
    return np.asarray(np.linalg.solve(square, data))


def _has_full_rank(triangle: Array) -> bool:
    """Whether the normal equations of a triangular factor are solvable."""
    diagonal = np.abs(np.diagonal(triangle))
    if len(triangle) < triangle.shape[1] or not diagonal.size:
        return False
    return bool(diagonal.min() > max(LEAST_DIAGONAL * diagonal.max(), SMALLEST))


def _least_norm_step(matrix: Array, missing: Array, least: float) -> Array:
    """The least-norm step that minimises ``matrix d + missing``.

    Singular values up to `least` count as zero.
    """
    if matrix.shape[1] == 0:
        return np.zeros(0)
    if (n := matrix.shape[1]) > LARGE:
        rows = np.asarray(np.linalg.qr(np.column_stack([matrix, missing]), mode="r"))[:n]
        if _has_full_rank(rows[:, :n]) and np.abs(np.diagonal(rows)).min() > CLEAR * least:
            return np.asarray(solve_triangular(rows[:, :n], -rows[:, n], check_finite=False))
    orthogonal, triangle, order = qr(matrix, mode="economic", pivoting=True, check_finite=False)
    if len(triangle) == len(order) and abs(triangle[-1, -1]) > CLEAR * least:
        move = np.empty(len(order))
        move[order] = solve_triangular(triangle, orthogonal.T @ -missing, check_finite=False)
        return move
    left, size, right = thin_svd(matrix)
    known = size > least
    return np.asarray(right[known].T @ (left[:, known].T @ -missing / size[known]))


def _null_space(normal: Array) -> Array:
    """Orthonormal basis of the null space of `normal`, as columns; of the whole space if zero."""
    n = len(normal)
    if not normal.any():
        return np.eye(n)
    if np.count_nonzero(normal) == 1:
        return np.delete(np.eye(n), int(np.flatnonzero(normal)[0]), axis=1)
    return np.linalg.qr(normal[:, None], mode="complete")[0][:, 1:]


# Longest step, in conditional standard deviations, for which models of remembered points are used,
# and largest distance of these points, in lengths of that step.
LONGEST, NEARBY = 2.0, 2.0
# Number of remembered points.
REMEMBERED = 12
# Most exchanges of weight between two models, and most sizes tried of one exchange.
MOST_EXCHANGES, MOST_TRIED = 12, 40


class KinkModels:
    """Linear models collected across kinks near the current point.

    Where a contact begins or ends, the derivatives of the residuals jump. At a minimum on such a
    kink those of either side predict a decrease on the other, so that steps by one of them zigzag
    and shrink. The highest of the linear models of both sides has its minimum on the kink.
    """

    def __init__(self) -> None:
        self._points: list[LinearisedResiduals] = []

    @property
    def has_kinks(self) -> bool:
        """Whether any step achieved less than its predicted reduction."""
        return bool(self._points)

    def remember(self, point: LinearisedResiduals) -> None:
        """Remember a point, one end of a step that achieved less than predicted."""
        self._points = [point, *self._points[: REMEMBERED - 1]]

    def models(
        self, at: LinearisedResiduals, scales: Array, *, length: float, slack: float
    ) -> Array:
        """Linear models of the residuals around a point, its own first, ``(k, n + 1, n + 1)``.

        Each is a triangular matrix. Its product with a step, in parameters divided by `scales`,
        followed by a 1, has the deviance of the model as its sum of squares. A remembered point
        counts if it is about as near as the step is long and if its model has no higher deviance at
        `at` than the true one: between the two the deviance then bends upward. For a long step no
        remembered point counts.

        Parameters
        ----------
        at
            Residuals and derivatives around which steps are planned.
        scales
            Conditional standard deviations, shape ``(n,)``.
        length
            Largest component of the step by the own model, in conditional standard deviations.
        slack
            Excess of the deviance of another model at `at` that is allowed, since remembered points
            are not exactly on a kink.
        """
        most = float(at.residuals @ at.residuals) + slack
        models = [_triangle(at, at, scales)]
        for point in self._points if length <= LONGEST else ():
            apart = np.max(np.abs(point.theta - at.theta) / scales)
            if 0.0 < apart <= NEARBY * length:
                model = _triangle(point, at, scales)
                if float(np.sum(model[:, -1] ** 2)) <= most:
                    models.append(model)
        return np.array(models)


def minimise_max_model(
    models: Array, box: tuple[Array, Array], constraint: tuple[Array, float] | None, gap: float
) -> tuple[BoundedStep, float]:
    """The step that minimises the maximum of several models, and the deviance there.

    It is found by the dual problem: the weighted sum of the models with the highest minimum. That
    sum also gives the multiplier of the constraint on the kink.

    Parameters
    ----------
    models
        From `KinkModels.models`.
    box, constraint
        As for `identknee.calibrate.bounded_least_squares.bounded_step`.
    gap
        Largest duality gap: how far the deviance returned may be below that of the step.
    """
    weights = np.zeros(len(models))
    weights[0] = 1.0
    dual = _Dual(models, box, constraint)
    step, heights = dual.lowest(weights)
    for _ in range(MOST_EXCHANGES):
        highest = int(np.argmax(heights))
        if heights[highest] - weights @ heights <= gap:
            break
        lowest = int(np.argmin(np.where(weights > 0.0, heights, np.inf)))
        exchange = np.zeros(len(models))
        exchange[[lowest, highest]] = -weights[lowest], weights[lowest]
        share = dual.best_share(weights, exchange, float(exchange @ heights), gap)
        weights = np.maximum(weights + share * exchange, 0.0)
        step, heights = dual.lowest(weights)
    return step, float(weights @ heights)


class _Dual:
    """Weighted sums of models, each with the step that minimises it."""

    def __init__(
        self, models: Array, box: tuple[Array, Array], constraint: tuple[Array, float] | None
    ) -> None:
        self._models, self._box, self._constraint = models, box, constraint
        self._squares: dict[int, Array] = {}

    def lowest(self, weights: Array) -> tuple[BoundedStep, Array]:
        """The minimiser of a weighted sum, and the value of each model there, ``(k,)``."""
        rows = self._rows(weights)
        step = bounded_step(rows[:, :-1], rows[:, -1], self._box, self._constraint)
        return step, np.sum((self._models @ np.append(step.step, 1.0)) ** 2, axis=1)

    def best_share(self, weights: Array, exchange: Array, slope: float, gap: float) -> float:
        """The share of an exchange of weights, up to 1, at which the minimum of the sum is highest.

        It is found by bisection; with many parameters by false position with the Illinois
        correction, which computes fewer minima. `slope` is the derivative of the minimum without
        exchange; at the share found its size is at most `gap`.
        """
        is_large = self._models.shape[2] - 1 > LARGE
        ends, slopes, share, last = [0.0, 1.0], [slope, slope], 1.0, -1
        for _ in range(MOST_TRIED):
            _, heights = self.lowest(weights + share * exchange)
            slope = float(exchange @ heights)
            if abs(slope) <= gap or (share == 1.0 and slope > 0.0):
                break
            moved = 0 if slope > 0.0 else 1
            ends[moved], slopes[moved] = share, slope
            if moved == last:
                slopes[1 - moved] *= 0.5
            last = moved if share < 1.0 else -1
            share = 0.5 * (ends[0] + ends[1])
            if is_large:
                share = (ends[0] * slopes[1] - ends[1] * slopes[0]) / (slopes[1] - slopes[0])
        return share

    def _rows(self, weights: Array) -> Array:
        """Matrix whose product with a step and a 1 has the weighted sum as its sum of squares."""
        used = np.flatnonzero(weights > 0.0)
        n = self._models.shape[2] - 1
        if n > LARGE and len(used) > 1:
            for k in used.tolist():
                if k not in self._squares:
                    self._squares[k] = self._models[k].T @ self._models[k]
            square = sum(weights[k] * self._squares[k] for k in used.tolist())
            root = clear_root(square[:n, :n])
            if root is not None:
                data = solve_triangular(root, square[:n, n], trans="T", check_finite=False)
                return np.column_stack([root, data])
        return np.concatenate(np.sqrt(weights[used])[:, None, None] * self._models[used])


def _triangle(of: LinearisedResiduals, at: LinearisedResiduals, scales: Array) -> Array:
    """The linear model of one point around another, shape ``(n + 1, n + 1)``."""
    if scales.size <= LARGE:
        data = of.residuals + of.jacobian @ (at.theta - of.theta)
        return _factor(of.jacobian * scales, data)
    root = _root(of)
    data = root[:, -1] + root[:, :-1] @ (at.theta - of.theta)
    return np.column_stack([root[:, :-1] * scales, data])


# Cached, because a point is used in many steps.
@lru_cache(maxsize=REMEMBERED + 4)
def _root(of: LinearisedResiduals) -> Array:
    """A triangular factor of derivatives and residuals, shape ``(n + 1, n + 1)``."""
    return _factor(of.jacobian, of.residuals)


def _factor(matrix: Array, data: Array) -> Array:
    rows = np.column_stack([matrix, data])
    padded = np.vstack([rows, np.zeros((max(rows.shape[1] - len(rows), 0), rows.shape[1]))])
    return np.asarray(np.linalg.qr(padded, mode="r"))


# Tolerance on the deviance: at a signed root of 2 this is 2.5e-9 of the root.
TOLERANCE = 1e-8
ROUNDING = 1e-13
MAX_STEPS = 60
# Ratio of actual to predicted reduction at which a step is accepted, and the trust region grows.
ENOUGH, GOOD = 1e-4, 0.75
SHORTER, LONGER = 0.25, 2.0
# Factor of the trust region after a rejected step across a kink, whose end joins the models.
HALF = 0.5
# Duality gap allowed to a step across kinks, in tolerances.
GAP = 0.2
# Length of the step by which a kink is confirmed, in lengths of the own model's step.
SHORT = 0.1
# Radius of the trust region at which a search gives up, in conditional standard deviations.
SHORTEST = 1e-7
# Penalty parameter of a missed target, in multiples of the constraint's multiplier.
PENALTY = 2.0

IsEnough = Callable[[Evaluation], bool]


@declared
class ConstrainedFit:
    """Where a constrained fit ended, and how."""

    evaluation: Evaluation = entry("The best parameter set found, its residuals and Jacobian")
    value: float = entry("The quantity there; NaN without a constraint")
    multiplier: float = entry("Derivative of the lowest deviance by the wanted value")
    tangent: Array = entry(
        "Derivative of theta along the path of constrained fits by the wanted value, shape ``(n,)``"
    )
    is_held: BoolArray = entry("Which parameters a bound keeps from fitting better, shape ``(n,)``")
    outcome: Outcome = entry(
        "`MINIMUM` where no step within the bounds predicts a reduction above the tolerance, "
        "`CLIFF` where the way down has no prediction, `VALLEY` where it did not get that far, "
        "`BUDGET`, or `START_FAILED`"
    )
    is_on_target: bool = entry(
        "Whether the quantity has the wanted value. A `MINIMUM` that is not on target is the "
        "end of the quantity's range: no small change within the bounds brings it closer"
    )
    left: float = entry(
        "Reduction of the deviance predicted for one more step; infinite where none was planned"
    )
    n_simulations: int = entry("Simulations made")


def solve_constrained(
    evaluator: Evaluator,
    start: Array,
    *,
    quantity: Quantity,
    target: float,
    tolerance: float = TOLERANCE,
    most_steps: int = MAX_STEPS,
    is_enough: IsEnough | None = None,
) -> ConstrainedFit:
    """The parameter set of least deviance within the bounds at which the quantity is `target`.

    Gauss-Newton steps within the bounds and on the linearised constraint, kept to a box around the
    last point where the model did worse than predicted or had no prediction.

    Parameters
    ----------
    evaluator
        Evaluator of residuals in units of their noise.
    start
        Where to begin, shape ``(n,)``; moved into the bounds. For a parameter's own value the start
        is put on target first, which costs nothing.
    quantity, target
        What is held, and at what value.
    tolerance
        Tolerance on the deviance, the reduction that one more step may still predict, and on the
        target, in conditional standard deviations.
    most_steps
        Steps allowed; it ends as a `VALLEY` after them.
    is_enough
        Asked of each simulation with a prediction; where it says yes, the search ends there as a
        `VALLEY`. It goes all the way if None.
    """
    search = _Search(evaluator, quantity, target, tolerance, is_enough)
    return search.run(search.on_target(np.asarray(start, dtype=np.float64)), most_steps)


def walk_to_constraint(
    evaluator: Evaluator,
    start: Array,
    *,
    quantity: Quantity,
    target: float,
    tolerance: float = TOLERANCE,
    most_steps: int = MAX_STEPS,
) -> ConstrainedFit:
    """What `solve_constrained` finds, from a start that is off target and stays there.

    The way to the target is then walked in steps that have a prediction each, along the feasibility
    boundary of the model where it is in the way. So it is found where the start, put on target, has
    no prediction.
    """
    search = _Search(evaluator, quantity, target, tolerance, None)
    return search.run(np.asarray(start, dtype=np.float64), most_steps)


def minimise(
    evaluator: Evaluator,
    start: Array,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MAX_STEPS,
    is_enough: IsEnough | None = None,
) -> ConstrainedFit:
    """The parameter set of least deviance within the bounds, by descent from `start`.

    Parameters
    ----------
    evaluator
        Evaluator of residuals in units of their noise.
    start
        Where to begin, shape ``(n,)``; moved into the bounds.
    tolerance
        Tolerance on the deviance: the reduction that one more step may still predict.
    most_steps
        Steps allowed; it ends as a `VALLEY` after them.
    is_enough
        Asked of each simulation with a prediction; where it says yes, the search ends there as a
        `VALLEY`. It goes all the way if None.
    """
    search = _Search(evaluator, None, np.nan, tolerance, is_enough)
    return search.run(np.asarray(start, dtype=np.float64), most_steps)


@declared
class _Point:
    """An evaluation with the quantity there."""

    evaluation: Evaluation
    value: float
    gradient: Array | None

    @property
    def is_finite(self) -> bool:
        return self.evaluation.is_finite and (
            self.gradient is None or bool(np.isfinite(self.gradient).all())
        )


@declared
class _PlannedStep:
    theta: Array
    step: BoundedStep
    length: float
    reduction: float
    linear_reduction: float
    gap: float
    remaining: float
    is_boxed: bool


class _Search:
    """One search: its settings, trust region and penalty for missing the target."""

    def __init__(
        self,
        evaluator: Evaluator,
        quantity: Quantity | None,
        target: float,
        tolerance: float,
        is_enough: IsEnough | None,
    ) -> None:
        self._evaluator = evaluator
        self._quantity = quantity
        self._target = target
        self._tolerance = tolerance
        self._is_enough = is_enough or (lambda _: False)
        parameters = evaluator.parameters
        self._lower, self._upper = parameters.lower, parameters.upper
        self._radius = np.inf
        self._price = 0.0
        self._met_cliff = False
        self._curvature = evaluator.curvature
        self._kinks = KinkModels()

    def on_target(self, start: Array) -> Array:
        """The start within the bounds, with its target as value if the quantity is a parameter."""
        start = np.clip(start, self._lower, self._upper)
        if self._quantity is not None:
            value, gradient = self._quantity.evaluate(start)
            i = int(np.argmax(gradient != 0.0))
            if np.count_nonzero(gradient) == 1 and gradient[i] == 1.0 and value == start[i]:
                start[i] = np.clip(self._target, self._lower[i], self._upper[i])
        return start

    def run(self, start: Array, most_steps: int) -> ConstrainedFit:
        before = self._evaluator.n_simulations
        start = np.clip(start, self._lower, self._upper)
        try:
            point = self._point(start)
        except SearchEnded as end:
            n = start.size
            evaluation = Evaluation(
                theta=start, residuals=np.full(1, np.inf), jacobian=np.full((1, n), np.nan)
            )
            nowhere = _Point(evaluation=evaluation, value=np.nan, gradient=None)
            return self._result(nowhere, None, end.outcome, before)
        if not point.is_finite:
            return self._result(point, None, Outcome.START_FAILED, before)
        for _ in range(most_steps):
            if self._is_enough(point.evaluation):
                return self._result(point, None, Outcome.VALLEY, before)
            plan = self._plan(point, self._radius, by_models=self._kinks)
            if self._is_converged_step(plan, point):
                beyond = self._beyond_false_kink(point)
                if beyond is not None:
                    point = beyond
                    continue
                met_cliff = plan.is_boxed and self._met_cliff
                outcome = Outcome.CLIFF if met_cliff else Outcome.MINIMUM
                return self._result(point, plan, outcome, before)
            try:
                point = self._next(point, plan)
            except SearchEnded as end:
                return self._result(point, plan, end.outcome, before)
            if self._radius < SHORTEST:
                outcome = Outcome.CLIFF if self._met_cliff else Outcome.VALLEY
                return self._result(point, plan, outcome, before)
        return self._result(point, plan, Outcome.VALLEY, before)

    def _point(self, theta: Array) -> _Point:
        evaluation = self._evaluator(theta)
        if self._quantity is None or not evaluation.is_finite:
            return _Point(evaluation=evaluation, value=np.nan, gradient=None)
        value, gradient = self._quantity.evaluate(theta)
        return _Point(evaluation=evaluation, value=value, gradient=gradient)

    def _beyond_false_kink(self, point: _Point) -> _Point | None:
        """The end of a short step by the point's own model, where that achieves what it predicts.

        At a kink it does not. It does where the model of a point farther away only happened to be
        as high as the deviance: remembered points are then forgotten.
        """
        if not self._kinks.has_kinks:
            return None
        whole = self._plan(point, self._radius)
        plan = self._plan(point, SHORT * whole.length)
        if plan.reduction <= self._negligible(point):
            return None
        try:
            new = self._point(plan.theta)
        except SearchEnded:
            return None
        if not new.is_finite or jump(point.evaluation, new.evaluation) > 0.0:
            return None
        if self._merit(point) - self._merit(new) < GOOD * plan.reduction:
            return None
        self._kinks = KinkModels()
        return new

    def _plan(
        self, point: _Point, radius: float, *, by_models: KinkModels | None = None
    ) -> _PlannedStep:
        """The step to try next: by the point's own model, or also by those beyond kinks."""
        at = point.evaluation
        scales = conditional_sds(at.jacobian, self._evaluator.parameters)
        matrix, data = self._model(at, scales)
        low, high = (self._lower - at.theta) / scales, (self._upper - at.theta) / scales
        box = np.maximum(low, -radius), np.minimum(high, radius)
        constraint, gap, remaining = None, 0.0, 0.0
        if point.gradient is not None:
            normal = point.gradient * scales
            size = float(np.linalg.norm(normal))
            wanted = self._target - point.value
            reachable = nearest_attainable(normal, box, wanted)
            constraint = normal, reachable
            gap = abs(wanted) / size if size > 0 else (np.inf if wanted else 0.0)
            remaining = abs(wanted - reachable)
        step = bounded_step(matrix, data, box, constraint)
        reduction = linear_reduction = _predicted_reduction(matrix, data, step)
        if by_models is not None and by_models.has_kinks:
            whole = bounded_step(matrix, data, (low, high), constraint)
            length = float(np.max(np.abs(whole.step), initial=0.0))
            models = by_models.models(at, scales, length=length, slack=self._tolerance)
            if len(models) > 1:
                step, height = minimise_max_model(models, box, constraint, GAP * self._tolerance)
                reduction = linear_reduction = at.deviance - height
        # Only a step that may be the last is compared with the linear model's.
        is_last = abs(reduction) <= self._negligible(point)
        if is_last and self._curvature is not None and self._curvature.is_known:
            matrix, data = _linear_model(at, scales)
            by_it = bounded_step(matrix, data, box, constraint)
            linear_reduction = _predicted_reduction(matrix, data, by_it)
        theta = np.clip(at.theta + scales * step.step, self._lower, self._upper)
        theta = np.where(step.step == low, self._lower, theta)
        theta = np.where(step.step == high, self._upper, theta)
        length = float(np.max(np.abs(step.step), initial=0.0))
        return _PlannedStep(
            theta=theta,
            step=step,
            length=length,
            reduction=reduction,
            linear_reduction=linear_reduction,
            gap=gap,
            remaining=remaining,
            is_boxed=length >= radius,
        )

    def _negligible(self, point: _Point) -> float:
        """The largest predicted reduction of the deviance that is none."""
        return max(self._tolerance, ROUNDING * point.evaluation.deviance)

    def _is_converged_step(self, plan: _PlannedStep, point: _Point) -> bool:
        if max(abs(plan.reduction), abs(plan.linear_reduction)) > self._negligible(point):
            return False
        if point.gradient is None or plan.gap <= self._tolerance:
            return True
        # No step within the bounds brings the quantity closer.
        missing = abs(self._target - point.value)
        return not plan.is_boxed and missing - plan.remaining <= self._tolerance * missing

    def _next(self, point: _Point, plan: _PlannedStep) -> _Point:
        """The next point: the planned one if actual over predicted reduction is large enough."""
        new = self._point(plan.theta)
        rise = jump(point.evaluation, new.evaluation) if new.is_finite else np.inf
        if rise > 0.0:
            self._met_cliff = True
            self._radius = SHORTER * plan.length
            return point
        if self._curvature is not None and rise == 0.0:
            self._curvature.learn(point.evaluation, new.evaluation)
        missing = 0.0 if point.gradient is None else abs(self._target - point.value)
        self._price = max(self._price, PENALTY * 2.0 * abs(plan.step.multiplier))
        predicted = plan.reduction + self._price * (missing - plan.remaining)
        kept = self._merit(point) - self._merit(new)
        rounding = ROUNDING * point.evaluation.deviance
        is_taken = predicted <= 0 or kept >= ENOUGH * predicted - rounding
        # Over uncertain geometry contact is rounded, and its bends are learned instead.
        if self._curvature is None and kept <= GOOD * predicted:
            self._kinks.remember((point if is_taken else new).evaluation)
        if not is_taken:
            self._radius = (HALF if self._curvature is None else SHORTER) * plan.length
            return point
        if kept > GOOD * predicted and plan.is_boxed:
            self._radius *= LONGER
        self._met_cliff = self._met_cliff and np.isfinite(self._radius)
        return new

    def _model(self, at: Evaluation, scales: Array) -> tuple[Array, Array]:
        """Matrix and data of the model of the deviance around a point."""
        if self._curvature is None or not self._curvature.is_known:
            return _linear_model(at, scales)
        return self._curvature.model(at, scales)

    def _merit(self, point: _Point) -> float:
        missing = 0.0 if point.gradient is None else abs(self._target - point.value)
        return point.evaluation.deviance + self._price * missing

    def _result(
        self, point: _Point, plan: _PlannedStep | None, outcome: Outcome, before: int
    ) -> ConstrainedFit:
        n = point.evaluation.theta.size
        held = np.zeros(n, dtype=np.bool_)
        tangent = np.full(n, np.nan)
        if plan is not None:
            theta = plan.theta
            at_bound = (theta <= self._lower) | (theta >= self._upper)
            held = plan.step.is_held & at_bound
            if point.gradient is not None:
                tangent = self._tangent(point, held)
        return ConstrainedFit(
            evaluation=point.evaluation,
            value=point.value,
            multiplier=np.nan if plan is None else 2.0 * plan.step.multiplier,
            tangent=tangent,
            is_held=held,
            outcome=outcome,
            is_on_target=plan is not None and plan.gap <= self._tolerance,
            left=np.inf if plan is None else plan.reduction,
            n_simulations=self._evaluator.n_simulations - before,
        )

    def _tangent(self, point: _Point, held: BoolArray) -> Array:
        """Least-increase direction in which the quantity grows by one, active bounds kept."""
        gradient = point.gradient
        if gradient is None:  # pragma: no cover - asked for with a quantity only
            raise AssertionError
        scales = conditional_sds(point.evaluation.jacobian, self._evaluator.parameters)
        limit = np.where(held, 0.0, np.inf)
        # Rows of data are the parameters' own steps, so the linear model is d theta / d value.
        matrix, _ = self._model(point.evaluation, scales)
        normal = gradient * scales
        if not np.any(normal[~held]):
            return np.zeros(normal.size)
        size = float(np.linalg.norm(normal[~held]))
        step = bounded_step(
            matrix, np.zeros(len(matrix)), (-limit, limit), (normal / size, 1.0)
        ).step
        return np.asarray(scales * step / size)


def _linear_model(at: Evaluation, scales: Array) -> tuple[Array, Array]:
    """Matrix and data of the linear model, in parameters divided by `scales`."""
    if scales.size <= LARGE:
        return at.jacobian * scales, at.residuals
    triangle = _triangle(at, at, scales)
    return triangle[:, :-1], triangle[:, -1]


def _predicted_reduction(matrix: Array, data: Array, step: BoundedStep) -> float:
    change = matrix @ step.step
    return float(-2.0 * data @ change - change @ change)
