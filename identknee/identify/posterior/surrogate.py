"""A posterior whose residuals are quadratic functions of the parameters: a stand-in for the model.

Residuals bend little where a posterior has its mass, even in dozens of parameters. On the surrogate
trajectories are as good as free, so that one simulation at their end is all that a draw costs.
"""

from typing import Any

import numpy as np
from emcee.moves import Move
from emcee.state import State

from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared

# A trajectory takes so many leapfrog steps, each of this length on average and up to this part of
# it longer or shorter; together about a quarter of a turn around the posterior.
N_STEPS, STEP, LONGER = 10, 0.2, 0.35
# Trajectories that lead farther [standard deviations] have diverged.
REACH = 1e3


@declared
class Surrogate:
    """Minus a log posterior density in standard coordinates, its residuals taken for quadratic.

    In standard coordinates z the optimum is 0 and the Gauss-Newton precision there the identity:
    the working coordinates are ``origin + inv(factor.T) @ z``.
    """

    origin: Array = array("Optimum in working coordinates", "parameter")
    factor: Array = array(
        "Lower Cholesky factor of the precision there", "parameter", "other parameter"
    )
    constant: Array = array("Combinations of residuals at the optimum", "residual")
    slope: Array = array("Their first derivatives by z", "residual", "parameter")
    curvature: Array = array(
        "Their second derivatives by z", "residual", "parameter", "other parameter"
    )
    spread: Array = array(
        "Lower Cholesky factor of the covariance of z over the surrogate's posterior, by which "
        "trajectories are scaled",
        "parameter",
        "other parameter",
    )
    center: Array = array("Centres of the priors in working coordinates", "parameter")
    sd: Array = array("Standard deviations of the priors in working coordinates", "parameter")

    def energy(self, points: Array) -> tuple[Array, Array]:
        """The function at points ``(k, n)`` without constants: values ``(k,)``, and gradients."""
        k, n = points.shape
        curved = (self.curvature.reshape(-1, n) @ points.T).reshape(-1, n, k)
        residuals = self.constant[:, None] + self.slope @ points.T
        residuals += 0.5 * np.einsum("rik,ki->rk", curved, points)
        deviations = (self.working(points) - self.center) / self.sd
        values = 0.5 * np.sum(residuals**2, axis=0) + 0.5 * np.sum(deviations**2, axis=1)
        gradients = np.einsum("rik,rk->ki", curved, residuals) + residuals.T @ self.slope
        gradients += np.linalg.solve(self.factor, (deviations / self.sd).T).T
        return values, gradients

    def working(self, points: Array) -> Array:
        """Working coordinates of points in standard ones, shape ``(k, n)``."""
        return np.asarray(self.origin + np.linalg.solve(self.factor.T, points.T).T)

    def standard(self, working: Array) -> Array:
        """Standard coordinates of points in working ones, shape ``(k, n)``."""
        return np.asarray((working - self.origin) @ self.factor)

    def trajectories(self, points: Array, random: Any) -> tuple[Array, Array, Array]:
        """Ends of one trajectory from each point, their energy, and how much the kinetic one grew.

        Parameters
        ----------
        points
            In standard coordinates, shape ``(k, n)``.
        random
            Generator of numpy with ``standard_normal`` and ``uniform``.

        Returns
        -------
        ends, energies, growth
            Shapes ``(k, n)``, ``(k,)`` and ``(k,)``; NaN where a trajectory diverged.
        """
        momentum = random.standard_normal(points.shape)
        steps = STEP * random.uniform(1.0 - LONGER, 1.0 + LONGER, size=(len(points), 1))
        before = np.sum(momentum**2, axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            gradient = self.energy(points)[1] @ self.spread
            for _ in range(N_STEPS):
                momentum = momentum - 0.5 * steps * gradient
                points = points + steps * momentum @ self.spread.T
                energies, gradient = self.energy(points)
                gradient = gradient @ self.spread
                momentum = momentum - 0.5 * steps * gradient
            growth = 0.5 * (np.sum(momentum**2, axis=1) - before)
            has_ended = np.all(np.abs(points) < REACH, axis=1) & np.isfinite(growth)
        points = np.where(has_ended[:, None], points, np.nan)
        return points, np.where(has_ended, energies, np.nan), np.where(has_ended, growth, np.nan)


class SurrogateMove(Move):  # type: ignore[misc]
    """Trajectories on a surrogate, accepted by the exact density at their ends.

    Leapfrog steps keep volume and can be run backwards whatever force they are given, so the
    posterior is invariant however good the surrogate is: a bad one lowers acceptance. A draw takes
    one simulation.

    Parameters
    ----------
    surrogate
        A fixed one: it does not learn from the walkers that it moves.

    References
    ----------
    R. M. Neal, MCMC using Hamiltonian dynamics, in Handbook of Markov Chain Monte Carlo, CRC Press
    (2011), doi:10.1201/b10905-6, section 5.5.4. C. E. Rasmussen, Gaussian processes to speed up
    hybrid Monte Carlo for expensive Bayesian integrals, Bayesian Statistics 7 (2003) 651-659.
    """

    def __init__(self, surrogate: Surrogate) -> None:
        super().__init__()
        self._surrogate = surrogate

    def propose(self, model: Any, state: State) -> tuple[State, Array]:
        """The state after each walker was offered the end of a trajectory, and which took it."""
        points = self._surrogate.standard(state.coords)
        ends, _, growth = self._surrogate.trajectories(points, model.random)
        has_ended = np.isfinite(growth)
        proposed = State(state, copy=True)
        proposed.coords[has_ended] = self._surrogate.working(ends[has_ended])
        found = model.compute_log_prob_fn(proposed.coords[has_ended])
        proposed.log_prob[has_ended], proposed.blobs[has_ended] = found
        gain = np.where(has_ended, proposed.log_prob - state.log_prob - growth, -np.inf)
        accepted = np.log(model.random.uniform(size=len(gain))) < gain
        return self.update(state, proposed, accepted), accepted
