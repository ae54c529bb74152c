"""Moves of an ensemble of walkers, for emcee's sampler.

Residuals are weakly nonlinear over the mass of a posterior, even in dozens of parameters.
Trajectories on the surrogate cost almost nothing, so a draw costs one simulation at their end.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from emcee.moves import DEMove, Move, StretchMove
from emcee.moves.red_blue import RedBlueMove
from emcee.state import State
from scipy.special import gammaln, logsumexp

from identknee.calibrate.problem import evaluate
from identknee.identify.posterior.posterior import (
    LogPosterior,
    inside,
    newton_kernel,
    working_center,
)
from identknee.runs.declare import Array, array, declared

# A trajectory takes so many leapfrog steps, each of this length on average and up to this part of
# it longer or shorter; together about a quarter of a turn around the posterior.
SURROGATE_STEPS, SURROGATE_STEP, LONGER = 10, 0.2, 0.35
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
        steps = SURROGATE_STEP * random.uniform(1.0 - LONGER, 1.0 + LONGER, size=(len(points), 1))
        before = np.sum(momentum**2, axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            gradient = self.energy(points)[1] @ self.spread
            for _ in range(SURROGATE_STEPS):
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
        # Path of walkers on the surrogate alone, within the bounds, shape ``(steps, k, n)``.
        walkers, parameters, steps = points, density.parameters, []
        before = surrogate.energy(walkers)[0]
        for _ in range(N_EXPLORED):
            ends, after, growth = surrogate.trajectories(walkers, generator)
            gain = before - after - growth
            taken = np.log(generator.uniform(size=len(gain))) < gain
            taken &= inside(parameters.from_working(surrogate.working(ends)), parameters)
            walkers = np.where(taken[:, None], ends, walkers)
            before = np.where(taken, after, before)
            steps.append(walkers)
        path = np.array(steps)
        points, draws = path[-1], path[N_EXPLORED // 2 :].reshape(-1, n)
        variances = np.atleast_2d(np.cov(draws.T)) + SMALLEST_VARIANCE * np.eye(n)
        spread = np.asarray(np.linalg.cholesky(variances), dtype=np.float64)
        expected = surrogate.energy(points)[0]
        points, energies = learning.learned(points)
    # Mean acceptance of the surrogate's draws by walkers, which are where the exact density is.
    errors, acceptance = energies - expected, 0.0
    known = errors[np.isfinite(errors)]
    if len(known):
        weights = np.exp(known.min() - known)
        accepted = np.exp(np.minimum(0.0, known[:, None] - errors)).mean(axis=1)
        acceptance = float(weights @ accepted / weights.sum())
    is_useful = acceptance >= LEAST_ACCEPTANCE
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
                # What each coefficient adds to a residual and to its n derivatives.
                point, n, (first, second) = points[i], len(points[i]), self._pairs
                row = np.zeros((1 + n, self._matrix.shape[0]))
                share = np.where(first == second, 0.5, 1.0)
                columns = np.arange(n + 1, row.shape[1])
                row[0] = np.concatenate([[1.0], point, share * point[first] * point[second]])
                row[1 + np.arange(n), 1 + np.arange(n)] = 1.0
                row[1 + first, columns] += share * point[second]
                row[1 + second, columns] += share * point[first]
                rows.append(row)
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


# Step of a trajectory for one parameter, in standard deviations; for n of them it shrinks with the
# fourth root of n (Beskos et al., doi:10.3150/12-BEJ414), so that acceptance stays as it is.
STEP = 1.3
# Part of that step which a trajectory takes: short ones lead walkers in from far away, and lengths
# that differ keep trajectories from coming back to where they began.
SHORTEST, LONGEST = 0.4, 1.1
N_STEPS = 4


class HamiltonianMove(Move):  # type: ignore[misc]
    """Trajectories of Hamiltonian dynamics, with the mean precision of the other half as mass.

    Each walker carries, as its blob, the kernel of a Gauss-Newton step
    (`identknee.identify.posterior.posterior.NewtonKernel`), of which the gradient is read off. One
    half of the walkers moves at a time. A trajectory takes `N_STEPS` simulations with Jacobian and
    ends nearly anywhere in the posterior; it ends early where the model has no prediction, and the
    walker then stays. In contrast to proposals from kernels, acceptance hardly falls with the
    number of parameters.

    Leapfrog steps keep volume and can be run backwards whatever force they are given, and the mass
    does not depend on the half that moves, so the posterior is invariant.

    References
    ----------
    R. M. Neal, MCMC using Hamiltonian dynamics, in Handbook of Markov Chain Monte Carlo, CRC Press
    (2011), doi:10.1201/b10905-6, equations 5.18 to 5.20.
    """

    def propose(self, model: Any, state: State) -> tuple[State, Array]:
        """The state after each half has moved, and which walkers did."""
        n_walkers = len(state.coords)
        accepted = np.zeros(n_walkers, dtype=bool)
        half = model.random.permutation(n_walkers) % 2
        for side in (0, 1):
            moving = half == side
            start = State(
                state.coords[moving], log_prob=state.log_prob[moving], blobs=state.blobs[moving]
            )
            factors = _factors(state.blobs[~moving], state.coords.shape[1])
            mass = np.asarray(np.mean(factors @ factors.transpose(0, 2, 1), axis=0))
            # One trajectory from each walker; `gain` is minus the growth of the energy, infinite
            # where a trajectory met a place without prediction.
            k, n = start.coords.shape
            x, blobs, log_prob = start.coords.copy(), start.blobs.copy(), start.log_prob.copy()
            momentum = model.random.standard_normal((k, n)) @ np.linalg.cholesky(mass).T
            step = STEP / n**0.25 * model.random.uniform(SHORTEST, LONGEST, size=(k, 1))
            before = log_prob - _kinetic(momentum, mass)
            alive = np.arange(k)
            for _ in range(N_STEPS):
                momentum[alive] -= 0.5 * step[alive] * _gradient(x[alive], blobs[alive])
                x[alive] += step[alive] * np.linalg.solve(mass, momentum[alive].T).T
                log_prob[alive], blobs[alive] = model.compute_log_prob_fn(x[alive])
                alive = alive[np.isfinite(log_prob[alive])]
                if not alive.size:
                    break
                momentum[alive] -= 0.5 * step[alive] * _gradient(x[alive], blobs[alive])
            gain = np.where(
                np.isfinite(log_prob), log_prob - _kinetic(momentum, mass) - before, -np.inf
            )
            end = State(x, log_prob=log_prob, blobs=blobs)
            accepted[moving] = np.log(model.random.rand(len(gain))) < gain
            state = self.update(state, end, accepted, moving)
        return state, accepted


def _kinetic(momentum: Array, mass: Array) -> Array:
    return np.asarray(0.5 * np.sum(momentum * np.linalg.solve(mass, momentum.T).T, axis=1))


def _factors(blobs: Array, n: int) -> Array:
    return np.asarray(blobs[:, n:].reshape(-1, n, n))


def _gradient(points: Array, blobs: Array) -> Array:
    """Gradient of minus the log density: precision times the way back from the step's end."""
    n = points.shape[1]
    factors = _factors(blobs, n)
    scaled = np.einsum("kji,kj->ki", factors, points - blobs[:, :n])
    return np.asarray(np.einsum("kij,kj->ki", factors, scaled))


class OwnKernelMove(Move):  # type: ignore[misc]
    """Steps of random length that leave the walker's own Gauss-Newton kernel invariant.

    Each walker carries its kernel as its blob, as for `HamiltonianMove`. From
    far out on a bent ridge, where the kernels of other walkers do not reach, a mixture of them
    hardly ever leads a walker in; its own does. Where residuals are linear every step is accepted.

    References
    ----------
    S. L. Cotter et al., MCMC methods for functions: modifying old algorithms to make them faster,
    Stat. Sci. 28 (2013) 424-446, doi:10.1214/13-STS421: the preconditioned Crank-Nicolson proposal,
    which here has the kernel of one point in place of the prior.
    """

    def propose(self, model: Any, state: State) -> tuple[State, Array]:
        """The state after every walker has tried to move, and which did."""
        n_walkers, n = state.coords.shape
        length = model.random.uniform(size=(n_walkers, 1))
        mean, factor = _step(state.coords, state.blobs, length)
        standard = model.random.standard_normal((n_walkers, n, 1))
        proposed = mean + length * np.linalg.solve(factor.transpose(0, 2, 1), standard)[:, :, 0]
        log_prob, blobs = model.compute_log_prob_fn(proposed)
        gain = log_prob - state.log_prob
        # Where there is no density there is no kernel.
        can = np.isfinite(log_prob)
        gain[can] += _log_density(proposed[can], blobs[can], length[can], state.coords[can])
        gain[can] -= _log_density(state.coords[can], state.blobs[can], length[can], proposed[can])
        accepted = np.log(model.random.rand(n_walkers)) < gain
        new = State(proposed, log_prob=log_prob, blobs=blobs)
        return self.update(state, new, accepted), accepted


def _step(origin: Array, blobs: Array, length: Array) -> tuple[Array, Array]:
    """Mean of a step from each origin, and the Cholesky factor of the kernel's precision."""
    n = origin.shape[1]
    center = blobs[:, :n]
    mean = center + np.sqrt(1.0 - length**2) * (origin - center)
    return mean, blobs[:, n:].reshape(-1, n, n)


def _log_density(origin: Array, blobs: Array, length: Array, end: Array) -> Array:
    """Log density of a step from each origin to each end, but for what both ways share."""
    mean, factor = _step(origin, blobs, length)
    standard = np.einsum("kji,kj->ki", factor, end - mean) / length
    diagonal = np.einsum("kii->ki", factor)
    return np.asarray(np.sum(np.log(diagonal) - 0.5 * standard**2, axis=1))


SNOOKER_RANGE = (1.2, 2.2)
HEAVY_PART, HEAVY_DEGREES = 0.1, 3.0


class NewtonMove(Move):  # type: ignore[misc]
    """Proposals from the Gauss-Newton kernels of the other half of the walkers.

    Each walker carries, as its blob, the normal density that approximates the posterior as seen
    from where it stands (`identknee.identify.posterior.posterior.NewtonKernel`). One half of the
    walkers moves at a time: a proposal is drawn from the mixture of the other half's kernels,
    whatever the place of the walker that moves, and is accepted by the rule of Metropolis and
    Hastings with the density of that mixture. Where the residuals are linear nearly every proposal
    is accepted and the draws are independent; where walkers stand in several basins, proposals lead
    from one to another.

    The densities are exact and the other half stands still meanwhile, so the posterior is
    invariant.

    References
    ----------
    J. Martin et al., A stochastic Newton MCMC method for large-scale statistical inverse problems,
    SIAM J. Sci. Comput. 34 (2012) A1460-A1487, doi:10.1137/110845598: the kernel of one point.
    """

    def propose(self, model: Any, state: State) -> tuple[State, Array]:
        """The state after each half has moved, and which walkers did."""
        n_walkers = len(state.coords)
        accepted = np.zeros(n_walkers, dtype=bool)
        half = model.random.permutation(n_walkers) % 2
        for side in (0, 1):
            moving = half == side
            mixture = KernelMixture(state.blobs[~moving])
            proposed = mixture.draw(int(moving.sum()), model.random)
            log_prob, blobs = model.compute_log_prob_fn(proposed)
            correction = mixture.log_density(state.coords[moving]) - mixture.log_density(proposed)
            gain = log_prob - state.log_prob[moving] + correction
            accepted[moving] = np.log(model.random.rand(len(proposed))) < gain
            new = State(proposed, log_prob=log_prob, blobs=blobs)
            state = self.update(state, new, accepted, moving)
        return state, accepted


class KernelMixture:
    """Equal mixture of kernels given as walkers' blobs, nine parts normal, one part heavy-tailed.

    The heavy tails, of Student's t distribution with three degrees of freedom, are for walkers far
    from all others: a normal mixture is so thin there that it would accept hardly any of
    their moves.

    Parameters
    ----------
    blobs
        For each kernel its centre, then the Cholesky factor of its precision row by row, shape
        ``(k, n + n * n)``.

    References
    ----------
    T. Hesterberg, Weighted average importance sampling and defensive mixture distributions,
    Technometrics 37 (1995) 185-194, doi:10.1080/00401706.1995.10484303.
    """

    def __init__(self, blobs: Array) -> None:
        k = len(blobs)
        n = round(np.sqrt(blobs.shape[1] + 0.25) - 0.5)
        self.centers = np.asarray(blobs[:, :n])
        self.factors = np.asarray(blobs[:, n:].reshape(k, n, n))
        diagonal = np.einsum("kii->ki", self.factors)
        self._log_weights = np.sum(np.log(diagonal), axis=1) - np.log(k)

    def draw(self, count: int, random: np.random.RandomState) -> Array:
        """So many draws, shape ``(count, n)``."""
        chosen = random.randint(len(self.centers), size=count)
        standard = random.standard_normal((count, self.centers.shape[1]))
        is_heavy = random.uniform(size=count) < HEAVY_PART
        stretch = np.sqrt(HEAVY_DEGREES / random.chisquare(HEAVY_DEGREES, size=count))
        standard *= np.where(is_heavy, stretch, 1.0)[:, None]
        transposed = self.factors[chosen].transpose(0, 2, 1)
        steps = np.linalg.solve(transposed, standard[:, :, None])[:, :, 0]
        return np.asarray(self.centers[chosen] + steps)

    def log_density(self, points: Array) -> Array:
        """Log density of points, shape ``(count, n)``; shape ``(count,)``."""
        scaled = np.einsum("kji,pkj->pki", self.factors, points[:, None, :] - self.centers)
        squares = np.sum(scaled**2, axis=2)
        return np.asarray(logsumexp(self._log_weights + _log_kernel(squares, points), axis=1))


def _log_kernel(squares: Array, points: Array) -> Array:
    """Log density of one kernel of unit precision, by squared distance from its centre."""
    n, degrees = points.shape[1], HEAVY_DEGREES
    normal = -0.5 * squares - 0.5 * n * np.log(2.0 * np.pi)
    heavy = (
        gammaln(0.5 * (degrees + n))
        - gammaln(0.5 * degrees)
        - 0.5 * n * np.log(degrees * np.pi)
        - 0.5 * (degrees + n) * np.log1p(squares / degrees)
    )
    return np.asarray(np.logaddexp(np.log(1.0 - HEAVY_PART) + normal, np.log(HEAVY_PART) + heavy))


class SnookerMove(RedBlueMove):  # type: ignore[misc]
    """Steps along the line through another walker, as long as two more are apart along it.

    emcee 3.1.6 has a snooker move too, but scales its line by the square root of its length where
    its length is meant, so that it samples another density than asked for (a normal one of variance
    1 with variance 0.8; mended after that release, https://github.com/dfm/emcee/pull/531).

    References
    ----------
    C. J. F. ter Braak and J. A. Vrugt, Differential evolution Markov chain with snooker updater and
    fewer chains, Stat. Comput. 18 (2008) 435-446, doi:10.1007/s11222-008-9104-9.
    """

    def get_proposal(
        self, sample: Array, complement: list[Array], random: np.random.RandomState
    ) -> tuple[Array, Array]:
        """Proposals, shape ``(k, n)``, and the logarithm of their correction, shape ``(k,)``."""
        others = np.concatenate(complement)
        triples = np.array([random.choice(len(others), 3, replace=False) for _ in sample])
        origin, one, two = (others[triples[:, i]] for i in range(3))
        line = sample - origin
        length = np.linalg.norm(line, axis=1)
        direction = line / length[:, None]
        along = np.sum(direction * (one - two), axis=1)
        step = random.uniform(*SNOOKER_RANGE, size=len(sample)) * along
        proposed = sample + step[:, None] * direction
        new_length = np.linalg.norm(proposed - origin, axis=1)
        return proposed, (sample.shape[1] - 1) * np.log(new_length / length)


def surrogate_moves(surrogate: Surrogate) -> list[tuple[Move, float]]:
    """For many parameters: mostly trajectories on a surrogate, and the exact ones for far away."""
    return [(SurrogateMove(surrogate), 0.85), (NewtonMove(), 0.05), (HamiltonianMove(), 0.1)]


MOVES: dict[str, Callable[[], list[tuple[Move, float]]]] = {
    # The default: mostly Newton moves, with a few that bring back outlying walkers.
    "newton": lambda: [
        (NewtonMove(), 0.85),
        (OwnKernelMove(), 0.05),
        (DEMove(), 0.08),
        (SnookerMove(), 0.02),
    ],
    # For many parameters: mostly trajectories; Newton steps lead from one basin to another.
    "hamiltonian": lambda: [(HamiltonianMove(), 0.85), (NewtonMove(), 0.15)],
    # Without derivatives.
    "difference": lambda: [(DEMove(), 0.8), (SnookerMove(), 0.2)],
    # The default of emcee, for comparison.
    "stretch": lambda: [(StretchMove(), 1.0)],
}
