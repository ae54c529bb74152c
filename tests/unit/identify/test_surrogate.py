"""A surrogate of the posterior is exact for quadratic residuals, and is dropped for wild ones."""

from dataclasses import replace

import numpy as np
import pytest
from problems import ClosedForm, plain_parameters
from scipy.optimize import check_grad

from identknee.identify.posterior.moves import Surrogate, trained_surrogate
from identknee.identify.posterior.posterior import LogPosterior, StopRule
from identknee.identify.posterior.sample import Ensembles, sample
from identknee.runs.declare import Array

N = 5
GENERATOR = np.random.default_rng(0)
# More residuals than can be combined into fewer.
SLOPES = GENERATOR.normal(size=(40, N))
BENDS = 0.1 * GENERATOR.normal(size=(40, N, N))
BENDS += BENDS.transpose(0, 2, 1)
OFFSETS = GENERATOR.normal(size=40)


def bowl(*, ripple: float = 0.0, waves: float = 5.0) -> ClosedForm:
    """Quadratic residuals of five parameters, and waves across the posterior."""
    return ClosedForm(
        name="bowl",
        parameters=plain_parameters(N, -9.0, 9.0),
        start=np.zeros(N),
        minimum=np.zeros(N),
        lowest=0.0,
        residuals_at=lambda x: (
            OFFSETS + SLOPES @ x + 0.5 * x @ BENDS @ x + ripple * np.cos(waves * x.sum())
        ),
        jacobian_at=lambda x: SLOPES + BENDS @ x - waves * ripple * np.sin(waves * x.sum()),
    )


def learned(problem: ClosedForm) -> Surrogate | None:
    origin = np.zeros(N)
    return trained_surrogate(LogPosterior(problem=problem), [origin], np.random.default_rng(1))[0]


def test_quadratic_residuals_are_learned_to_the_last_digits() -> None:
    density = LogPosterior(problem=bowl())
    surrogate = learned(bowl())
    assert surrogate is not None
    points = np.random.default_rng(2).normal(size=(6, N))
    values, gradients = surrogate.energy(points)
    exact = [-density(x) for x in surrogate.working(points)]
    # Both lack other constants. Second derivatives are shrunk by a thousandth of one simulation.
    np.testing.assert_allclose(values - values[0], np.subtract(exact, exact[0]), atol=0.02)
    np.testing.assert_allclose(surrogate.standard(surrogate.working(points)), points, atol=1e-12)

    def energy(x: Array) -> float:
        return float(surrogate.energy(x[None])[0][0])

    for point, gradient in zip(points, gradients, strict=True):
        error = check_grad(energy, lambda x: surrogate.energy(x[None])[1][0], point)
        assert error < 1e-5 * np.linalg.norm(gradient)


def test_trajectories_keep_the_energy_and_run_back() -> None:
    surrogate = learned(bowl())
    assert surrogate is not None
    points = np.random.default_rng(3).normal(size=(200, N))
    ends, energies, growth = surrogate.trajectories(points, np.random.default_rng(4))
    change = energies - surrogate.energy(points)[0] + growth
    assert np.mean(np.minimum(1.0, np.exp(-change))) > 0.9
    np.testing.assert_allclose(energies, surrogate.energy(ends)[0])
    # A walker that has diverged is said to, and the others go on.
    lost = np.vstack([points[:2], np.full((1, N), 1e200)])
    ends, energies, growth = surrogate.trajectories(lost, np.random.default_rng(4))
    assert np.isnan(ends[2]).all()
    assert np.isnan([energies[2], growth[2]]).all()
    assert np.isfinite(ends[:2]).all()


def test_a_model_that_no_quadratic_follows_has_no_surrogate() -> None:
    assert learned(bowl(ripple=3.0, waves=7.0)) is None


@pytest.mark.parametrize(
    ("ripple", "waves"), [(0.2, 5.0), pytest.param(0.0, 1.0, marks=pytest.mark.slow)]
)
def test_the_sample_is_of_the_exact_posterior(ripple: float, waves: float) -> None:
    """Of a good surrogate and of a poor one: moments by another kind of moves agree."""
    rule = StopRule(drift=np.inf, budget=5_000)
    problem = bowl(ripple=ripple, waves=waves)
    found, other = (
        sample(problem, ensembles=Ensembles(moves=x, n_prior=0), rule=rule, seed=1)
        for x in ("surrogate", "newton")
    )
    error = np.hypot(found.last_check.mean_error, other.last_check.mean_error) * other.sd
    assert np.all(np.abs(found.mean - other.mean) < 5.0 * error)
    assert np.all(np.abs(found.sd - other.sd) < 5.0 * error)


@pytest.mark.slow
def test_one_simulation_gives_a_draw_where_the_surrogate_is_good() -> None:
    rule = StopRule(drift=np.inf, autocorrelation_times=100.0)
    found = sample(bowl(), ensembles=Ensembles(moves="surrogate", n_prior=0), rule=rule, seed=2)
    assert found.last_check.acceptance.mean() > 0.8
    assert 1000.0 * found.last_check.bulk.sum(axis=1).min() / found.n_walk_simulations > 300.0


def test_it_is_learned_inside_the_bounds() -> None:
    """Draws beyond them are not simulated."""
    whole = LogPosterior(problem=bowl())
    wide = plain_parameters(N, -9.0, 9.0)
    lower = np.where(np.arange(N) == 0, -0.02, wide.lower)
    narrow = LogPosterior(problem=replace(bowl(), parameters=replace(wide, lower=lower)))
    counts = []
    for density in (whole, narrow):
        surrogate, n_simulations = trained_surrogate(
            density, [np.zeros(N)], np.random.default_rng(1)
        )
        assert surrogate is not None
        counts.append(n_simulations)
    assert counts[1] < counts[0] == 1 + 2 * N + 6 * 64
