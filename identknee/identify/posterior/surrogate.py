"""A surrogate posterior whose residuals are quadratic functions of the parameters.

Residuals are weakly nonlinear over the mass of a posterior, even in dozens of parameters.
Trajectories on the surrogate cost almost nothing, so a draw costs one simulation at their end.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from emcee.moves import Move
from emcee.state import State

from identknee.calibrate.evaluation import evaluate
from identknee.identify.posterior.density import (
    LogPosterior,
    inside,
    newton_kernel,
    working_center,
)
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared

# A trajectory takes so many leapfrog steps, each of this length on average and up to this part of
# it longer or shorter; together about a quarter of a turn around the posterior.
N_STEPS, STEP, LONGER = 10, 0.2, 0.35
# Trajectories that lead farther [standard deviations] have diverged.
REACH = 1e3


@declared
class Surrogate:
    """Negative log posterior density in standard coordinates, with quadratic residuals.

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


# Simulations of the first round for each parameter, and of each later round.
FIRST_PER_PARAMETER, LATER = 2, 64
N_LATER = 6
# With fewer proposals accepted than this, the surrogate is of no use.
LEAST_ACCEPTANCE = 0.1
# Trajectories on the surrogate between two rounds.
N_EXPLORED = 20
# Second derivatives that the simulations leave open are taken for small, as by so many of them.
SHRINKAGE = 1e-3
# Combinations of residuals with coefficients below this [sd of the noise] are left out.
SMALLEST = 3e-3
# Added to the variances of draws, of which too few may be different.
SMALLEST_VARIANCE = 1e-6


def trained_surrogate(
    density: LogPosterior, optima: Sequence[Array], generator: np.random.Generator
) -> tuple[Surrogate | None, int]:
    """A surrogate for the posterior around the best of its optima, and the simulations made.

    Each simulation gives all residuals with their first derivatives, so a few hundred determine
    all second ones. Round after round they go where the surrogate before has its mass.

    Parameters
    ----------
    density
        The posterior.
    optima
        In working coordinates, shape ``(n,)`` each.
    generator
        For the draws.

    Returns
    -------
    surrogate, n_simulations
        None if trajectories on it would hardly ever be accepted.
    """
    learning = _Learning(density, optima)
    n = density.parameters.n
    spread: Array = np.eye(n)
    points = learning.learned(generator.standard_normal((FIRST_PER_PARAMETER * n, n)))[0]
    for _ in range(N_LATER):
        if not len(points):
            return None, learning.n_simulations
        surrogate = learning.surrogate(spread)
        points = points[generator.integers(len(points), size=LATER)]
        path = _explored(surrogate, density, points, generator)
        points, draws = path[-1], path[N_EXPLORED // 2 :].reshape(-1, n)
        variances = np.atleast_2d(np.cov(draws.T)) + SMALLEST_VARIANCE * np.eye(n)
        spread = np.asarray(np.linalg.cholesky(variances), dtype=np.float64)
        expected = surrogate.energy(points)[0]
        points, energies = learning.learned(points)
    is_useful = _acceptance(energies - expected) >= LEAST_ACCEPTANCE
    return learning.surrogate(spread) if is_useful else None, learning.n_simulations


class _Learning:
    """Least squares for the coefficients of all residuals, in standard coordinates."""

    def __init__(self, density: LogPosterior, optima: Sequence[Array]) -> None:
        parameters = density.parameters
        kernels = [
            newton_kernel(evaluate(density.problem, parameters.from_working(x)), parameters)
            for x in optima
        ]
        best = int(np.argmax([x.log_density for x in kernels]))
        self.n_simulations = len(kernels)
        self._density = density
        self._origin, self._factor = optima[best], kernels[best].factor
        self._pairs = np.triu_indices(parameters.n)
        n_terms = 1 + parameters.n + len(self._pairs[0])
        self._matrix = np.diag(np.where(np.arange(n_terms) > parameters.n, SHRINKAGE, 0.0))
        self._right: Array = np.zeros((n_terms, 0))

    def learned(self, points: Array) -> tuple[Array, Array]:
        """Simulate at points: those that have a prediction, and the energies of all of them.

        An energy is minus the log density without constants; infinite without a prediction.
        """
        parameters = self._density.parameters
        energies = np.full(len(points), np.inf)
        rows, right = [], []
        working = self._origin + np.linalg.solve(self._factor.T, points.T).T
        for i, theta in enumerate(parameters.from_working(working)):
            if not inside(theta, parameters):
                continue
            self.n_simulations += 1
            evaluation = evaluate(self._density.problem, theta)
            if evaluation.is_finite:
                deviations = (working[i] - working_center(parameters)) / parameters.prior_sd
                energies[i] = 0.5 * (evaluation.deviance + deviations @ deviations)
                slope = evaluation.jacobian * np.where(parameters.is_log, theta, 1.0)
                rows.append(self._terms(points[i]))
                right += [evaluation.residuals[None], np.linalg.solve(self._factor, slope.T)]
        if rows:
            terms, known = np.concatenate(rows), np.concatenate(right)
            self._matrix = self._matrix + terms.T @ terms
            self._right = terms.T @ known + (self._right if self._right.size else 0.0)
        return points[np.isfinite(energies)], energies

    def surrogate(self, spread: Array) -> Surrogate:
        """The surrogate of all simulations so far, with the spread that one before it had."""
        parameters, n = self._density.parameters, self._density.parameters.n
        coefficients = np.linalg.solve(self._matrix, self._right)
        variances, directions = np.linalg.eigh(coefficients.T @ coefficients)
        kept = coefficients @ directions[:, variances > SMALLEST**2]
        curvature = np.zeros((kept.shape[1], n, n))
        first, second = self._pairs
        curvature[:, first, second] = curvature[:, second, first] = kept[n + 1 :].T
        return Surrogate(
            origin=self._origin,
            factor=self._factor,
            constant=kept[0],
            slope=kept[1 : n + 1].T,
            curvature=curvature,
            spread=spread,
            center=working_center(parameters),
            sd=parameters.prior_sd,
        )

    def _terms(self, point: Array) -> Array:
        """What each coefficient adds to a residual and to its n derivatives, ``(1 + n, terms)``."""
        n, (first, second) = len(point), self._pairs
        terms = np.zeros((1 + n, self._matrix.shape[0]))
        share = np.where(first == second, 0.5, 1.0)
        columns = np.arange(n + 1, terms.shape[1])
        terms[0] = np.concatenate([[1.0], point, share * point[first] * point[second]])
        terms[1 + np.arange(n), 1 + np.arange(n)] = 1.0
        terms[1 + first, columns] += share * point[second]
        terms[1 + second, columns] += share * point[first]
        return terms


def _explored(
    surrogate: Surrogate, density: LogPosterior, points: Array, generator: np.random.Generator
) -> Array:
    """Path of walkers on the surrogate alone, within the bounds, shape ``(steps, k, n)``."""
    parameters = density.parameters
    path = []
    energies = surrogate.energy(points)[0]
    for _ in range(N_EXPLORED):
        ends, after, growth = surrogate.trajectories(points, generator)
        gain = energies - after - growth
        is_taken = np.log(generator.uniform(size=len(gain))) < gain
        is_taken &= inside(parameters.from_working(surrogate.working(ends)), parameters)
        points = np.where(is_taken[:, None], ends, points)
        energies = np.where(is_taken, after, energies)
        path.append(points)
    return np.array(path)


def _acceptance(errors: Array) -> float:
    """Mean acceptance of the surrogate's draws by walkers, which are where the exact density is.

    Parameters
    ----------
    errors
        Exact energy less the surrogate's at its draws, infinite without a prediction.
    """
    known = errors[np.isfinite(errors)]
    if not len(known):
        return 0.0
    weights = np.exp(known.min() - known)
    accepted = np.exp(np.minimum(0.0, known[:, None] - errors)).mean(axis=1)
    return float(weights @ accepted / weights.sum())
