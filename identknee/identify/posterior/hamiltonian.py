"""Trajectories along the exact gradient, for posteriors of many parameters."""

from typing import Any

import numpy as np
from emcee.moves import Move
from emcee.state import State

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
            mass = _mean_precision(state.blobs[~moving], state.coords.shape[1])
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


def _mean_precision(blobs: Array, n: int) -> Array:
    factors = _factors(blobs, n)
    return np.asarray(np.mean(factors @ factors.transpose(0, 2, 1), axis=0))


def _gradient(points: Array, blobs: Array) -> Array:
    """Gradient of minus the log density: precision times the way back from the step's end."""
    n = points.shape[1]
    factors = _factors(blobs, n)
    scaled = np.einsum("kji,kj->ki", factors, points - blobs[:, :n])
    return np.asarray(np.einsum("kij,kj->ki", factors, scaled))
