"""Residuals: predicted less measured, weighted, and their slopes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tolerances import DIFFERENCE

from identknee.laxity.table import Laxity, add_noise, relative_to_unloaded
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals, Weighting
from identknee.runs.declare import Array

SHIFT = np.array([1.0, -2.0, 3.0, 4.0, -5.0])


@pytest.fixture(scope="module")
def model(small_model: LaxityModel) -> LaxityModel:
    return small_model


@pytest.fixture(scope="module")
def laxity(model: LaxityModel) -> Laxity:
    return model.simulate(model.parameters.center)


@pytest.fixture(scope="module")
def theta(model: LaxityModel) -> Array:
    return model.parameters.center * 1.03


def _with_gaps(laxity: Laxity) -> Laxity:
    coordinates = np.array(laxity.coordinates)
    coordinates[1] = np.nan
    coordinates[2, [0, 3]] = np.nan
    return replace(laxity, coordinates=coordinates, sd=laxity.sd)


def test_at_the_truth_nothing_is_left(model: LaxityModel, laxity: Laxity) -> None:
    problem = LaxityResiduals(model=model, laxity=laxity)
    assert not problem.residuals(model.parameters.center).any()
    assert problem.parameters is problem.model.parameters


def test_unit_weights_are_plain_differences(
    model: LaxityModel, laxity: Laxity, theta: Array
) -> None:
    problem = LaxityResiduals(model=model, laxity=laxity)
    expected = model.predict(theta).coordinates - laxity.coordinates
    np.testing.assert_array_equal(problem.residuals(theta), expected.ravel())


def test_what_was_not_measured_is_left_out(
    model: LaxityModel, laxity: Laxity, theta: Array
) -> None:
    gaps = _with_gaps(laxity)
    found = LaxityResiduals(model=model, laxity=gaps).residuals(theta)
    assert found.shape == (6 * 5 - 7,)
    expected = model.predict(theta).coordinates - laxity.coordinates
    np.testing.assert_array_equal(found, expected[gaps.is_measured])


def test_noise_weights_divide_by_the_stated_errors(
    model: LaxityModel, laxity: Laxity, theta: Array
) -> None:
    noisy = add_noise(laxity, sd_mm=0.5, sd_deg=0.2, seed=1)
    found = LaxityResiduals(model=model, laxity=noisy, weighting="noise").residuals(theta)
    expected = (model.predict(theta).coordinates - noisy.coordinates) / [0.5, 0.5, 0.5, 0.2, 0.2]
    assert found == pytest.approx(expected.ravel(), rel=1e-12)


def test_a_shared_correlation_is_taken_out(
    model: LaxityModel, laxity: Laxity, theta: Array
) -> None:
    """The sum of squares is the Mahalanobis distance of the measured coordinates of each trial."""
    noisy = _with_gaps(add_noise(laxity, sd_mm=0.5, sd_deg=0.2, seed=1, correlation=0.4))
    found = LaxityResiduals(model=model, laxity=noisy, weighting="noise").residuals(theta)
    difference = model.predict(theta).coordinates - noisy.coordinates
    sd, total = np.array([0.5, 0.5, 0.5, 0.2, 0.2]), 0.0
    for trial in range(noisy.n):
        used = noisy.is_measured[trial]
        covariance = np.outer(sd, sd) * (0.4 + 0.6 * np.eye(5))
        inverse = np.linalg.inv(covariance[np.ix_(used, used)]) if used.any() else np.zeros((0, 0))
        total += difference[trial, used] @ inverse @ difference[trial, used]
    assert found.shape == (23,)
    assert found @ found == pytest.approx(total, rel=1e-10)


@pytest.mark.parametrize("weighting", ["unit", "noise"])
@pytest.mark.parametrize("zero", ["absolute", "unloaded"])
def test_the_jacobian_is_the_slope(
    model: LaxityModel, laxity: Laxity, theta: Array, weighting: Weighting, zero: str
) -> None:
    noisy = _with_gaps(add_noise(laxity, sd_mm=0.5, sd_deg=0.2, seed=1, correlation=0.3))
    protocol = model.protocol
    if zero == "unloaded":
        # The unloaded pose of 8 deg is needed as well.
        names = (*protocol.trials, "unloaded at 8")
        protocol = replace(
            protocol,
            trials=names,
            flexion_deg=np.r_[protocol.flexion_deg, 8.0],
            loads=np.r_[protocol.loads, np.zeros((1, 5))],
        )
        whole = model.with_protocol(protocol).simulate(model.parameters.center)
        noisy = relative_to_unloaded(add_noise(whole, sd_mm=0.5, sd_deg=0.2, seed=2))
    problem = LaxityResiduals(model=model, laxity=noisy, weighting=weighting)
    jacobian = problem.jacobian(theta)
    assert jacobian.shape == (int(noisy.is_measured.sum()), 8)
    for parameter in range(8):
        move = np.zeros(8)
        move[parameter] = 1e-5
        ends = problem.residuals(theta + move) - problem.residuals(theta - move)
        error = np.abs(ends / 2e-5 - jacobian[:, parameter])
        assert np.median(error) <= DIFFERENCE * np.abs(jacobian).max()


def test_data_relative_to_the_unloaded_pose_ignore_a_shift(model: LaxityModel) -> None:
    protocol = model.protocol.select([0, 1, 4])
    here = model.with_protocol(protocol)
    found = here.simulate(here.parameters.center)
    shifted = replace(found, coordinates=found.coordinates + SHIFT)
    problem = LaxityResiduals(model=here, laxity=relative_to_unloaded(shifted))
    assert problem.residuals(here.parameters.center) == pytest.approx(np.zeros(15), abs=1e-12)


def test_data_relative_to_a_pose_they_lack_are_refused(model: LaxityModel, laxity: Laxity) -> None:
    relative = replace(laxity, zero="unloaded")
    with pytest.raises(ValueError, match=r"'small'.*unloaded.*8"):
        LaxityResiduals(model=model, laxity=relative)


def test_noise_weights_need_stated_errors(model: LaxityModel, laxity: Laxity) -> None:
    with pytest.raises(ValueError, match="standard deviation"):
        LaxityResiduals(model=model, laxity=laxity, weighting="noise")


def test_where_a_trial_has_no_prediction_all_residuals_are_infinite(
    model: LaxityModel, laxity: Laxity
) -> None:
    problem = LaxityResiduals(model=model, laxity=laxity)
    slack = model.parameters.center * np.r_[np.zeros(4), np.ones(4)]
    assert np.isposinf(problem.residuals(slack)).all()
    assert np.isnan(problem.jacobian(slack)).all()


def test_a_trial_without_data_may_be_lost(model: LaxityModel, laxity: Laxity) -> None:
    """Its residuals are not there, so they cannot be infinite."""
    protocol = replace(
        laxity.protocol,
        trials=(*laxity.protocol.trials, "pulled apart"),
        flexion_deg=np.r_[laxity.protocol.flexion_deg, 0.0],
        loads=np.r_[laxity.protocol.loads, [[0.0, 0.0, 0.0, 1000.0, 900.0]]],
    )
    more = Laxity(protocol=protocol, coordinates=np.r_[laxity.coordinates, np.full((1, 5), np.nan)])
    problem = LaxityResiduals(model=model, laxity=more)
    theta = model.parameters.center
    assert not problem.model.predict(theta).is_converged[-1]
    assert problem.residuals(theta) == pytest.approx(np.zeros(30), abs=1e-9)
    assert np.isfinite(problem.jacobian(theta)).all()


def test_the_way_there_does_not_matter(model: LaxityModel, laxity: Laxity, theta: Array) -> None:
    """The Jacobian starts from the residuals' prediction where there is one, and is the same."""
    problem = LaxityResiduals(model=model, laxity=laxity)
    cold = problem.jacobian(theta)
    problem.residuals(theta)
    warm = problem.jacobian(theta)
    assert warm == pytest.approx(cold, rel=1e-6, abs=1e-8)


def test_noise_without_an_inverse_is_told(model: LaxityModel, laxity: Laxity) -> None:
    # The largest number below 1: rounding leaves one of these covariances without a root.
    sd = np.random.default_rng(0).uniform(0.1, 1.0, laxity.coordinates.shape)
    stated = replace(laxity, sd=sd, within_trial_correlation=float(np.nextafter(1.0, 0.0)))
    with pytest.raises(ValueError, match=r"trial .*inverse"):
        LaxityResiduals(model=model, laxity=stated, weighting="noise")


@pytest.mark.parametrize("sd", [1e-300, 1e300])
def test_noise_that_no_measurement_has_is_refused(
    model: LaxityModel, laxity: Laxity, sd: float
) -> None:
    stated = replace(laxity, sd=np.full(laxity.coordinates.shape, sd))
    with pytest.raises(ValueError, match=rf"{re.escape(f'{sd:g}')} .*1e-09 to"):
        LaxityResiduals(model=model, laxity=stated, weighting="noise")
