"""Every move leaves the density as it is, seen in moments that are known."""

import emcee
import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.stats import multivariate_normal, multivariate_t

from identknee.identify.posterior.moves import (
    MOVES,
    HamiltonianMove,
    KernelMixture,
    NewtonMove,
    OwnKernelMove,
    SnookerMove,
)
from identknee.runs.declare import Array

STEPS = 1000
# Five standard errors, of variances from the effective draws of the squares.
SIGMAS = 5.0


def skewed(points: Array) -> Array:
    """Log density of a Gumbel variable in each coordinate, and a kernel that fits it badly."""
    log_density = np.sum(-points - np.exp(-points), axis=1)
    factor = np.exp(-0.25 * np.clip(points, -4, 4))[:, :, None] * np.eye(points.shape[1])
    return np.column_stack([log_density, 0.7 * points, factor.reshape(len(points), -1)])


def sampled(move: emcee.moves.Move, n: int = 2, seed: int = 1) -> Array:
    walkers = 8 * n
    state = emcee.State(
        np.random.default_rng(seed).normal(size=(walkers, n)),
        random_state=np.random.RandomState(seed).get_state(),
    )
    sampler = emcee.EnsembleSampler(
        walkers, n, skewed, moves=move, vectorize=True, blobs_dtype=np.float64
    )
    sampler.run_mcmc(state, STEPS)
    return np.asarray(sampler.get_chain(discard=STEPS // 10))


@pytest.mark.parametrize(
    "move",
    [
        NewtonMove(),
        OwnKernelMove(),
        HamiltonianMove(),
        SnookerMove(),
        *[m() for m in MOVES.values()],
    ],
)
def test_moments_are_those_of_the_density(move: emcee.moves.Move) -> None:
    chain = sampled(move)
    gamma = 0.5772156649015329
    for values, expected in ((chain, gamma), ((chain - gamma) ** 2, np.pi**2 / 6)):
        tau = emcee.autocorr.integrated_time(values, quiet=True)
        error = values.std(axis=(0, 1)) * np.sqrt(tau / (values.shape[0] * values.shape[1]))
        assert np.all(np.abs(values.mean(axis=(0, 1)) - expected) < SIGMAS * error)


def test_trajectories_follow_the_gradient_in_many_dimensions() -> None:
    """Of a normal density in 40 coordinates, of very different width, most are accepted."""
    n, walkers, steps = 40, 12, 60
    sd = np.geomspace(0.01, 100.0, n)
    factor = np.diag(1.0 / sd).ravel()

    def normal(points: Array) -> Array:
        log_density = -0.5 * np.sum((points / sd) ** 2, axis=1)
        kernels = np.tile(np.concatenate([np.zeros(n), factor]), (len(points), 1))
        return np.column_stack([log_density, kernels])

    generator = np.random.default_rng(3)
    sampler = emcee.EnsembleSampler(
        walkers, n, normal, moves=HamiltonianMove(), vectorize=True, blobs_dtype=np.float64
    )
    state = emcee.State(
        2.0 * sd * generator.normal(size=(walkers, n)),
        random_state=np.random.RandomState(3).get_state(),
    )
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    assert sampler.acceptance_fraction.mean() > 0.8
    chain = sampler.get_chain(discard=10) / sd
    # Trajectories of a quarter to three quarters of a turn: draws three steps apart are new.
    error = np.sqrt(3.0 / (walkers * (steps - 10)))
    assert np.all(np.abs(chain.mean(axis=(0, 1))) < SIGMAS * error)
    assert np.all(np.abs(chain.var(axis=(0, 1)) - 1.0) < SIGMAS * np.sqrt(2.0) * error)


def bent(points: Array) -> Array:
    """Log density of a ridge along y = x^2 / 4, with the Gauss-Newton kernel."""
    x, y = points.T
    residuals = np.column_stack([x, 20.0 * (y - 0.25 * x**2)])
    rows = []
    for place, own, slope in zip(points, residuals, -10.0 * x, strict=True):
        jacobian = np.array([[1.0, 0.0], [slope, 20.0]])
        precision = jacobian.T @ jacobian
        center = place - np.linalg.solve(precision, jacobian.T @ own)
        factor = np.linalg.cholesky(precision)
        rows.append(np.concatenate([[-0.5 * own @ own], center, factor.ravel()]))
    return np.array(rows)


@pytest.mark.parametrize("seed", range(4))
def test_a_walker_far_out_on_a_bent_ridge_moves(seed: int) -> None:
    """Of 16 walkers one starts 4 sds out, where the kernels of the others do not reach."""
    places = np.random.default_rng(seed).normal(size=(16, 2))
    places[0, 0] = 4.0
    places[:, 1] = 0.25 * places[:, 0] ** 2
    sampler = emcee.EnsembleSampler(
        16, 2, bent, moves=MOVES["newton"](), vectorize=True, blobs_dtype=np.float64
    )
    random = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(emcee.State(places, random_state=random), 200)
    assert np.ptp(sampler.get_chain()[:, 0, 0]) > 0.0


def test_the_snooker_move_of_emcee_is_not_used() -> None:
    """Its variance of a normal variable is a fifth too small; ours must not inherit that."""
    classes = {type(move).__name__ for make in MOVES.values() for move, _ in make()}
    assert "DESnookerMove" not in classes


def test_the_mixture_has_the_density_it_draws_from() -> None:
    generator = np.random.default_rng(0)
    centers = generator.normal(size=(3, 2))
    factors = np.array([np.tril(generator.normal(size=(2, 2))) for _ in range(3)])
    factors[:, [0, 1], [0, 1]] = np.abs(factors[:, [0, 1], [0, 1]]) + 0.5
    mixture = KernelMixture(np.column_stack([centers, factors.reshape(3, 4)]))
    points = generator.normal(size=(5, 2))
    parts = []
    for center, factor in zip(centers, factors, strict=True):
        covariance = np.linalg.inv(factor @ factor.T)
        normal = multivariate_normal(center, covariance).pdf(points)
        parts.append(0.9 * normal + 0.1 * multivariate_t(center, covariance, df=3).pdf(points))
    expected = np.log(np.mean(parts, axis=0))
    np.testing.assert_allclose(mixture.log_density(points), expected, rtol=1e-10)
    draws = mixture.draw(200_000, np.random.RandomState(0))
    # Of any function of a draw that lies between 0 and 1.
    error = 0.5 / np.sqrt(len(draws))
    for low, high in ((-0.5, 0.5), (0.0, 2.0)):
        share = np.all((draws > low) & (draws < high), axis=1).mean()
        density, _ = dblquad(
            lambda y, x: float(np.exp(mixture.log_density(np.array([[x, y]]))[0])),
            *(low, high, low, high),
            epsabs=1e-6,
        )
        assert abs(share - density) < SIGMAS * error
