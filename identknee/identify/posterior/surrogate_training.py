"""Surrogates of a posterior are learned by simulations where the one before has its mass."""

from collections.abc import Sequence

import numpy as np

from identknee.calibrate.evaluation import evaluate
from identknee.identify.posterior.density import (
    LogPosterior,
    inside,
    newton_kernel,
    working_center,
)
from identknee.identify.posterior.surrogate import Surrogate
from identknee.runs.arrays import Array

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


def trained(
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
