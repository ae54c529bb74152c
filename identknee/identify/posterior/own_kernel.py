"""Steps by the kernel of the walker that moves, for walkers far from all others."""

from typing import Any

import numpy as np
from emcee.moves import Move
from emcee.state import State

from identknee.runs.arrays import Array


class OwnKernelMove(Move):  # type: ignore[misc]
    """Steps of random length that leave the Gauss-Newton kernel of the walker that moves as it is.

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
