"""Moves of an ensemble of walkers, for emcee's sampler."""

from collections.abc import Callable
from typing import Any

import numpy as np
from emcee.moves import DEMove, Move, StretchMove
from emcee.moves.red_blue import RedBlueMove
from emcee.state import State
from scipy.special import gammaln, logsumexp

from identknee.identify.posterior.surrogate import Surrogate, SurrogateMove
from identknee.runs.arrays import Array

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
    (`identknee.identify.posterior.density.NewtonKernel`), of which the gradient is read off. One
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
            end, gain = _trajectories(model, start, mass)
            accepted[moving] = np.log(model.random.rand(len(gain))) < gain
            state = self.update(state, end, accepted, moving)
        return state, accepted


def _trajectories(model: Any, start: State, mass: Array) -> tuple[State, Array]:
    """Ends of one trajectory from each walker, and minus the growth of the energy, shape ``(k,)``.

    The growth is infinite where a trajectory met a place without prediction.
    """
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
    gain = np.where(np.isfinite(log_prob), log_prob - _kinetic(momentum, mass) - before, -np.inf)
    return State(x, log_prob=log_prob, blobs=blobs), gain


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

    Each walker carries its kernel as its blob, as for `identknee.identify.posterior.moves`. From
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
    from where it stands (`identknee.identify.posterior.density.NewtonKernel`). One half of the
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
    from all others: a normal mixture is so thin there that it would hardly ever let them go.

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
        differences = points[:, None, :] - self.centers
        scaled = np.einsum("kji,pkj->pki", self.factors, differences)
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


def newton_moves() -> list[tuple[Move, float]]:
    """The default: mostly Newton moves, with a few that bring back outlying walkers."""
    return [(NewtonMove(), 0.85), (OwnKernelMove(), 0.05), (DEMove(), 0.08), (SnookerMove(), 0.02)]


def hamiltonian_moves() -> list[tuple[Move, float]]:
    """For many parameters: mostly trajectories; Newton steps lead from one basin to another."""
    return [(HamiltonianMove(), 0.85), (NewtonMove(), 0.15)]


def surrogate_moves(surrogate: Surrogate) -> list[tuple[Move, float]]:
    """For many parameters: mostly trajectories on a surrogate, and the exact ones for far away."""
    return [(SurrogateMove(surrogate), 0.85), (NewtonMove(), 0.05), (HamiltonianMove(), 0.1)]


def difference_moves() -> list[tuple[Move, float]]:
    """Differential evolution for four steps in five and snooker for the fifth; no derivatives."""
    return [(DEMove(), 0.8), (SnookerMove(), 0.2)]


def stretch_moves() -> list[tuple[Move, float]]:
    """The stretch move, emcee's default, for comparison."""
    return [(StretchMove(), 1.0)]


MOVES: dict[str, Callable[[], list[tuple[Move, float]]]] = {
    "newton": newton_moves,
    "hamiltonian": hamiltonian_moves,
    "difference": difference_moves,
    "stretch": stretch_moves,
}
