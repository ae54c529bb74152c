"""The objective of a fit, counting what it costs and remembering the best."""

from collections.abc import Callable

import numpy as np

from identknee.calibrate.problem import Problem
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome


class Ended(Exception):  # noqa: N818 - not an error: it says how a search ended
    """Raised inside a search to leave it, whichever library owns its loop."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(outcome)
        self.outcome = outcome


class Objective:
    """Half the sum of squared residuals (equation 6), within a budget of simulations.

    One evaluation of the residuals at a new theta is one simulation; the Jacobian at a theta
    just evaluated is not another.

    Parameters
    ----------
    problem
        What to evaluate.
    budget
        Simulations allowed; one more raises `Ended`.
    on_simulation
        Told of every simulation, for a progress bar.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        budget: int,
        on_simulation: Callable[[int], None] | None = None,
    ) -> None:
        self._problem = problem
        self._on_simulation = on_simulation
        # Searches come back to two points only: the last one and the best one.
        self._last: tuple[Array, Array] | None = None
        self._best: tuple[Array, Array] | None = None
        self.parameters: Parameters = problem.parameters
        self.budget = budget
        self.n_simulations = 0
        self.best_value = np.inf
        self.history: list[tuple[int, float]] = []

    @property
    def best_theta(self) -> Array | None:
        """Where the lowest finite objective was seen, shape ``(n,)``; None before the first."""
        return None if self._best is None else self._best[0]

    def value(self, theta: Array) -> float:
        """Half the sum of squares at `theta`; infinite where the model has no prediction."""
        return half_sum_of_squares(self.residuals(theta))

    def residuals(self, theta: Array) -> Array:
        """Residuals at `theta`, shape ``(m,)``, all infinite where one of them is not finite.

        Raises
        ------
        Ended
            If the budget does not allow another simulation.
        """
        for known in (self._last, self._best):
            if known is not None and np.array_equal(known[0], theta):
                return known[1]
        if self.n_simulations >= self.budget:
            raise Ended(Outcome.BUDGET)
        theta = np.array(theta, dtype=np.float64)
        residuals = np.asarray(self._problem.residuals(theta), dtype=np.float64)
        self.n_simulations += 1
        if self._on_simulation is not None:
            self._on_simulation(1)
        value = half_sum_of_squares(residuals)
        if not np.isfinite(value):
            residuals = np.full(residuals.shape, np.inf)
        self._last = (theta, residuals)
        if value < self.best_value:
            self.best_value = value
            self._best = self._last
            self.history.append((self.n_simulations, value))
        return residuals

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residuals at `theta`, shape ``(m, n)``."""
        return np.asarray(self._problem.jacobian(np.array(theta)), dtype=np.float64)


def half_sum_of_squares(residuals: Array) -> float:
    """Half the sum of squares; infinite where a residual is not finite.

    Examples
    --------
    >>> half_sum_of_squares(np.array([3.0, 4.0]))
    12.5
    """
    if not np.all(np.isfinite(residuals)):
        return np.inf
    return 0.5 * float(residuals @ residuals)
