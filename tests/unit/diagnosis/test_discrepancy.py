"""The Gaussian process absorbs misfit, leaves the fit alone, and does not carry to new flexion."""

from dataclasses import replace

import numpy as np
import pytest
from linear_laxity import (
    N_VALUES,
    SD,
    LinearLaxity,
    drawn,
    linear_folds,
    linear_observations,
    linear_protocol,
    smooth_columns,
)
from scipy.optimize import approx_fprime
from tolerances import CLOSED_FORM, DIFFERENCE

from identknee.diagnosis.gain import (
    FLEXION,
    LEAST_SPREAD,
    Discrepancy,
    Observations,
    elpd_difference,
    fit_discrepancy,
    held_out,
)
from identknee.diagnosis.misfit import base_projector
from identknee.diagnosis.noise_model import build_noise_model
from identknee.model.discrepancy import LEAST_LENGTH, SmoothKernel
from identknee.runs.declare import Array

SOLVED = 1e6 * CLOSED_FORM


def cause_and_base(amplitude: float) -> tuple[LinearLaxity, LinearLaxity]:
    """A model with its cause, and the base model that lacks it."""
    theta = np.array([1.0, -1.0, 0.5, amplitude])
    after = drawn(smooth_columns(4, 8), theta, linear_observations(), 0)
    return after, replace(after, columns=after.columns[:, :3])


def absorb(base: LinearLaxity, observations: Observations) -> Discrepancy:
    return fit_discrepancy(base, observations, base.fitted(observations), linear_protocol())


def left(base: LinearLaxity, observations: Observations) -> Array:
    return -base.residuals(base.fitted(observations))


def test_it_absorbs_what_a_cause_explains_but_loses_at_a_flexion_it_has_not_seen() -> None:
    observations, folds = linear_observations(), linear_folds()
    after, base = cause_and_base(1.0)
    found = absorb(base, observations)
    theta = base.fitted(observations)
    explained = observations.rmse(left(after, observations)).noise
    assert observations.rmse(left(base, observations)).noise > 3 * explained
    # As good as the cause where it has seen the data: it may bend to noise, or miss a kink.
    assert observations.rmse(found.errors).noise == pytest.approx(explained, rel=0.15)
    assert found.process.absorbed > 0.8
    scored = held_out(after, observations, after.fitted(observations), folds)
    of_base = held_out(base, observations, theta, folds)
    of_process = held_out(base, found.observations, theta, folds)
    assert scored.rmse(FLEXION).noise < 1.15
    assert of_process.rmse(FLEXION).noise > 1.5 * scored.rmse(FLEXION).noise
    of_flexion = elpd_difference(of_process, scored).families[0]
    assert of_flexion.family == FLEXION
    assert of_flexion.difference > 2.0 * of_flexion.se
    # It knows at least that it does not know.
    over_base = elpd_difference(of_base, of_process).families[0]
    assert over_base.difference > 2.0 * over_base.se


def test_there_is_little_to_absorb_where_the_model_is_right() -> None:
    observations = linear_observations()
    base = drawn(smooth_columns(3, 8), np.array([1.0, -1.0, 0.5]), observations, 1)
    found = absorb(base, observations)
    assert np.median(found.spread) < 0.3
    assert found.process.absorbed < 0.15
    assert found.process.degrees_of_freedom < 0.15 * N_VALUES


def test_it_leaves_the_fit_as_it_is() -> None:
    observations = linear_observations()
    _, base = cause_and_base(1.0)
    found = absorb(base, observations)
    process = found.observations.noise.covariance - observations.noise.covariance
    seen = base.columns.T @ np.linalg.solve(observations.noise.covariance, process)
    assert np.abs(seen).max() < SOLVED * np.abs(base.columns).max() * np.abs(process).max() / SD**2


def test_what_it_leaves_is_what_kriging_leaves() -> None:
    observations = linear_observations()
    _, base = cause_and_base(0.4)
    found = absorb(base, observations)
    process = found.observations.noise.covariance - observations.noise.covariance
    errors = left(base, observations)
    kriged = process @ np.linalg.solve(found.observations.noise.covariance, errors)
    assert found.errors == pytest.approx(errors - kriged, rel=SOLVED, abs=SOLVED)


def test_lengths_and_spreads_stay_within_their_limits() -> None:
    observations = linear_observations()
    base = drawn(smooth_columns(3, 8), np.array([1.0, -1.0, 0.5]), observations, 1)
    rough = replace(base, measured=base.measured * np.tile([1.0, 5.0], N_VALUES)[:N_VALUES])
    found = absorb(rough, observations)
    assert found.process.load_length >= LEAST_LENGTH * (1 - SOLVED)
    assert found.process.flexion_length >= LEAST_LENGTH * (1 - SOLVED)
    assert found.spread.min() >= LEAST_SPREAD * (1 - SOLVED)


def test_coordinates_not_measured_have_no_process() -> None:
    whole = linear_observations(n_nuisances=0)
    kept = np.random.default_rng(0).random(N_VALUES) < 0.9
    kept &= whole.coordinate != 1
    measured = np.zeros((63, 5), dtype=bool)
    measured[whole.trial[kept], whole.coordinate[kept]] = True
    observations = Observations(
        trial=whole.trial[kept],
        coordinate=whole.coordinate[kept],
        sd=whole.sd[kept],
        noise=build_noise_model(np.full((63, 5), SD), measured, correlation=0.3),
        n_trials=63,
    )
    _, base = cause_and_base(1.0)
    base = replace(base, columns=base.columns[kept], measured=base.measured[kept])
    found = absorb(base, observations)
    assert found.spread.shape == (4,)
    assert found.errors.shape == (kept.sum(),)
    assert observations.rmse(found.errors).noise < observations.rmse(left(base, observations)).noise


def test_derivatives_of_the_marginal_likelihood_are_exact() -> None:
    observations = linear_observations()
    _, base = cause_and_base(1.0)
    projector = base_projector(observations.noise.whiten(base.columns))
    reduce = projector.project(observations.noise.whiten(np.eye(observations.trial.size)))
    kernel = SmoothKernel(
        linear_protocol(), observations.trial, observations.coordinate, observations.sd, reduce
    )
    target = projector.project(observations.noise.whiten(left(base, observations)))
    at = np.log(np.array([0.5, 1.0, 2.0, 1.0, 0.3, 0.6, 0.8]))
    _, gradient = kernel.misfit(at, target)
    differences = approx_fprime(at, lambda x: kernel.misfit(x, target)[0], 1e-6)
    size = np.abs(gradient).max()
    assert gradient == pytest.approx(differences, abs=10 * DIFFERENCE * size)
