"""Residuals of a problem and their derivatives, counted, with the best point kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from identknee.calibrate.problem import Problem
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_PARAMETER, array, declared
from identknee.runs.record import Outcome

# Of the product of their lengths: a step and the change of the gradient along it with a smaller
# product say nothing that an update could rest on.
LEAST_PRODUCT = 1e-8
# Of the largest eigenvalue: a direction with a smaller one is not moved along.
LEAST_EIGENVALUE = 1e-14


class LinearisedResiduals(Protocol):
    """Residuals at a parameter vector, with their derivatives."""

    @property
    def theta(self) -> Array:
        """Where, shape ``(n,)``."""
        ...

    @property
    def residuals(self) -> Array:
        """In units of their noise, shape ``(m,)``."""
        ...

    @property
    def jacobian(self) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        ...


class Curvature:
    """Quasi-Newton estimate of the second-order term that Gauss-Newton omits.

    They are the sum of the residuals times their second derivatives. Where they are not small
    beside the squared Jacobian, as in the bent valleys of uncertain geometry, Gauss-Newton steps
    overshoot several times; a step that counts them lands where it means to. They are learned from
    the change of the gradient between points, in a least-change secant update that takes nothing of
    it which the Jacobian explains.

    Parameters
    ----------
    n
        Parameters.

    References
    ----------
    J. E. Dennis, D. M. Gay and R. E. Welsch, An adaptive nonlinear least-squares algorithm, ACM
    Trans. Math. Softw. 7 (1981) 348-368, section 3, doi:10.1145/355958.355965.
    """

    def __init__(self, n: int) -> None:
        self._matrix = np.zeros((n, n))

    @property
    def is_known(self) -> bool:
        """Whether any update has been made."""
        return bool(self._matrix.any())

    def learn(self, before: LinearisedResiduals, after: LinearisedResiduals) -> None:
        """Update from two points with derivatives."""
        step = after.theta - before.theta
        gradient = after.jacobian.T @ after.residuals
        change = gradient - before.jacobian.T @ before.residuals
        wanted = gradient - before.jacobian.T @ after.residuals
        product = float(change @ step)
        scale = float(np.linalg.norm(after.jacobian @ step)) ** 2
        if product <= LEAST_PRODUCT * scale or scale == 0.0:
            return
        known = self._matrix @ step
        # What was learned elsewhere counts less where it has grown too large.
        size = float(abs(step @ known))
        share = min(1.0, float(abs(step @ wanted)) / size) if size > 0.0 else 1.0
        missing = wanted - share * known
        ratio = np.outer(missing, change) / product
        self._matrix = (
            share * self._matrix
            + ratio
            + ratio.T
            - float(missing @ step) / product**2 * np.outer(change, change)
        )

    def model(self, at: LinearisedResiduals, scales: Array) -> tuple[Array, Array]:
        """Matrix and data whose sum of squares is the deviance around a point, up to a constant.

        In parameters divided by `scales`, shape ``(n,)``. A direction along which the deviance
        curves down counts as if it curved up as much, so that the lowest point of the model lies
        downhill and not at a saddle.
        """
        linear = at.jacobian * scales
        if not self.is_known:
            return linear, at.residuals
        square = linear.T @ linear + self._matrix * np.outer(scales, scales)
        values, vectors = np.linalg.eigh(square)
        sizes = np.abs(values)
        is_seen = sizes > LEAST_EIGENVALUE * sizes.max()
        roots = np.sqrt(np.where(is_seen, sizes, 1.0))
        slope = vectors.T @ (linear.T @ at.residuals)
        matrix = np.where(is_seen, roots, 0.0)[:, None] * vectors.T
        return matrix, np.where(is_seen, slope / roots, 0.0)


REMEMBERED = 4
# In units of the noise: a search that comes so near to where another one ended would end there too.
NEAR = 0.1


class SearchEnded(Exception):  # noqa: N818 - not an error: it says how a search ended
    """Raised inside a search to end it, whichever library owns the loop."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(outcome)
        self.outcome = outcome


@declared
class Evaluation:
    """One simulation: residuals in units of their noise, and their exact derivatives."""

    theta: Array = array("Where", "parameter", unit=OF_PARAMETER)
    residuals: Array = array(
        "Residuals; all infinite where the model has no prediction", "residual"
    )
    jacobian: Array = array(
        "d residuals / d theta; NaN where the residuals are infinite", "residual", "parameter"
    )

    @property
    def is_finite(self) -> bool:
        """Whether the model has a prediction with derivatives here."""
        return bool(np.isfinite(self.residuals).all() and np.isfinite(self.jacobian).all())

    @property
    def deviance(self) -> float:
        """Sum of squared residuals: minus twice the log likelihood, up to a constant."""
        return float(self.residuals @ self.residuals) if self.is_finite else np.inf

    @property
    def gradient(self) -> Array:
        """Derivatives of the deviance by theta, shape ``(n,)``."""
        return np.asarray(2.0 * self.jacobian.T @ self.residuals)

    @property
    def information(self) -> Array:
        """Fisher information of theta, shape ``(n, n)``."""
        return np.asarray(self.jacobian.T @ self.jacobian)


class Evaluator:
    """Evaluations of a problem within a budget of simulations.

    The residuals at a new theta are one simulation; their Jacobian there is not another. The last
    few thetas and the best one are remembered and cost nothing when asked for again.

    Parameters
    ----------
    problem
        What to evaluate.
    budget
        Simulations allowed; one more raises `SearchEnded`. No limit if None.
    on_simulation
        Told of every simulation, for a progress bar.
    ends
        Where other searches ended. One that is about to come to such a place, and has seen no lower
        deviance, is left: it raises `SearchEnded`.
    learns_curvature
        Whether searches learn the curvature of the problem although its geometry is exact.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        budget: int | None = None,
        on_simulation: Callable[[int], None] | None = None,
        ends: Sequence[Evaluation] = (),
        learns_curvature: bool = False,
    ) -> None:
        self._problem = problem
        self._ends = ends
        self._on_simulation = on_simulation
        self._recent: list[_Simulation] = []
        self._best: _Simulation | None = None
        self.budget = budget
        self.n_simulations = 0
        # Number of the simulation and deviance, at each improvement.
        self.history: list[tuple[int, float]] = []
        # Of searches one after another.
        is_bent = learns_curvature or not problem.parameters.is_of_interest.all()
        self.curvature = Curvature(problem.parameters.n) if is_bent else None

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self._problem.parameters

    @property
    def best_theta(self) -> Array | None:
        """Where the lowest finite deviance was seen, shape ``(n,)``; None before the first."""
        return None if self._best is None else self._best.theta

    @property
    def best_deviance(self) -> float:
        """The lowest deviance seen; inf before the first finite one."""
        return np.inf if self._best is None else sum_of_squares(self._best.residuals)

    def __call__(self, theta: Array) -> Evaluation:
        """The evaluation at `theta`, shape ``(n,)``, with derivatives.

        Raises
        ------
        Ended
            If the budget does not allow another simulation.
        """
        simulation = self._simulated(theta)
        if simulation.evaluation is None:
            simulation.evaluation = _differentiated(
                self._problem, simulation.theta, simulation.residuals
            )
        return simulation.evaluation

    def residuals(self, theta: Array) -> Array:
        """Residuals at `theta`, shape ``(m,)``, all infinite where one of them is not finite.

        Raises
        ------
        Ended
            If the budget does not allow another simulation.
        """
        return self._simulated(theta).residuals

    def deviance(self, theta: Array) -> float:
        """Sum of squared residuals at `theta`; inf where the model has no prediction.

        Raises
        ------
        Ended
            If the budget does not allow another simulation.
        """
        return sum_of_squares(self._simulated(theta).residuals)

    def _simulated(self, theta: Array) -> "_Simulation":
        for known in self._recent if self._best is None else (*self._recent, self._best):
            if np.array_equal(known.theta, theta):
                return known
        if self.budget is not None and self.n_simulations >= self.budget:
            raise SearchEnded(Outcome.BUDGET)
        if any(self._joins(x, theta) for x in self._ends):
            raise SearchEnded(Outcome.VALLEY)
        theta = np.array(theta, dtype=np.float64)
        self.n_simulations += 1
        if self._on_simulation is not None:
            self._on_simulation(1)
        simulation = _Simulation(theta=theta, residuals=_residuals(self._problem, theta))
        self._recent = [simulation, *self._recent[: REMEMBERED - 1]]
        deviance = sum_of_squares(simulation.residuals)
        if deviance < self.best_deviance:
            self._best = simulation
            self.history.append((self.n_simulations, deviance))
        return simulation

    def _joins(self, end: Evaluation, theta: Array) -> bool:
        """Whether `theta` is near an earlier search that ended at least as low."""
        if not (self.n_simulations and end.deviance <= self.best_deviance):
            return False
        return sum_of_squares(end.jacobian @ (theta - end.theta)) <= NEAR**2


@dataclass(slots=True, kw_only=True, eq=False)
class _Simulation:
    """Residuals at a theta, and the derivatives once they were asked for."""

    theta: Array
    residuals: Array
    evaluation: Evaluation | None = None


def evaluate(problem: Problem, theta: Array) -> Evaluation:
    """Residuals of the problem and their derivatives at `theta`, shape ``(n,)``."""
    theta = np.array(theta, dtype=np.float64)
    return _differentiated(problem, theta, _residuals(problem, theta))


def sum_of_squares(residuals: Array) -> float:
    """The deviance of residuals: their sum of squares; inf where one of them is not finite.

    Examples
    --------
    >>> sum_of_squares(np.array([3.0, 4.0]))
    25.0
    """
    return float(residuals @ residuals) if np.isfinite(residuals).all() else np.inf


def _residuals(problem: Problem, theta: Array) -> Array:
    """Residuals, all infinite where their sum of squares is not finite."""
    residuals = np.asarray(problem.residuals(theta), dtype=np.float64)
    is_finite = np.isfinite(sum_of_squares(residuals))
    return residuals if is_finite else np.full(residuals.shape, np.inf)


def _differentiated(problem: Problem, theta: Array, residuals: Array) -> Evaluation:
    if np.isfinite(residuals).all():
        jacobian = np.asarray(problem.jacobian(theta), dtype=np.float64)
    else:
        jacobian = np.full((residuals.size, theta.size), np.nan)
    return Evaluation(theta=theta, residuals=residuals, jacobian=jacobian)
