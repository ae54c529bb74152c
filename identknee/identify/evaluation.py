"""A problem's residuals and their derivatives together, counted."""

from dataclasses import dataclass

import numpy as np

from identknee.calibrate.objective import Ended
from identknee.calibrate.problem import Problem
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.outcome import Outcome

REMEMBERED = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evaluation:
    """One simulation: residuals in units of their noise, and their exact derivatives.

    Attributes
    ----------
    theta
        Where, shape ``(n,)``.
    residuals
        Shape ``(m,)``; all infinite where the model has no prediction.
    jacobian
        d residuals / d theta, shape ``(m, n)``; NaN where the residuals are infinite.
    """

    theta: Array
    residuals: Array
    jacobian: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta", frozen(self.theta, None, name="theta"))
        object.__setattr__(self, "residuals", frozen(self.residuals, None, name="residuals"))
        shape = (self.residuals.size, self.theta.size)
        object.__setattr__(self, "jacobian", frozen(self.jacobian, *shape, name="jacobian"))

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

    The residuals and their Jacobian at one theta are one simulation. The last few are remembered
    and cost nothing when asked for again.

    Parameters
    ----------
    problem
        What to evaluate.
    budget
        Simulations allowed; one more raises `identknee.calibrate.objective.Ended`. No limit if
        None.
    """

    def __init__(self, problem: Problem, *, budget: int | None = None) -> None:
        self._problem = problem
        self._remembered: list[Evaluation] = []
        self.budget = budget
        self.n_simulations = 0

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self._problem.parameters

    def __call__(self, theta: Array) -> Evaluation:
        """The evaluation at `theta`, shape ``(n,)``.

        Raises
        ------
        Ended
            If the budget does not allow another simulation.
        """
        for known in self._remembered:
            if np.array_equal(known.theta, theta):
                return known
        if self.budget is not None and self.n_simulations >= self.budget:
            raise Ended(Outcome.BUDGET)
        self.n_simulations += 1
        evaluation = evaluate(self._problem, theta)
        self._remembered = [evaluation, *self._remembered[: REMEMBERED - 1]]
        return evaluation


def evaluate(problem: Problem, theta: Array) -> Evaluation:
    """Residuals of the problem and their derivatives at `theta`, shape ``(n,)``."""
    theta = np.array(theta, dtype=np.float64)
    residuals = np.asarray(problem.residuals(theta), dtype=np.float64)
    if np.isfinite(residuals).all():
        jacobian = np.asarray(problem.jacobian(theta), dtype=np.float64)
    else:
        residuals = np.full(residuals.shape, np.inf)
        jacobian = np.full((residuals.size, theta.size), np.nan)
    return Evaluation(theta=theta, residuals=residuals, jacobian=jacobian)
