"""Candidates on a knee: the whitened coordinates that the residuals of a table would have."""

from dataclasses import replace

import numpy as np
import pytest
from narrow_knee import narrow_knee

from identknee.laxity.protocol import Protocol, concatenate, load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.candidate_laxity import CandidateLaxity, typical_errors, with_unloaded
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array

# The same numbers along two ways of multiplying them.
ROUNDING = 1e-10


def _data(model: LaxityModel, correlation: float = 0.3) -> Laxity:
    exact = model.simulate(model.parameters.center)
    return add_noise(exact, sd_mm=0.4, sd_deg=0.6, seed=0, correlation=correlation)


def _new() -> Protocol:
    return Protocol(
        name="new",
        trials=("pulled", "turned"),
        flexion_deg=np.array([4.0, 8.0]),
        loads=np.array([[0.2, 0, 20.0, 0, 0], [-0.3, 0, 0, 0, 0]]),
    )


def _candidates(model: LaxityModel, laxity: Laxity, **changes: object) -> CandidateLaxity:
    settings: dict[str, object] = {
        "protocol": _new(),
        "sd": typical_errors(laxity),
        "free": model.parameters.with_fixed((), model.parameters.center),
    }
    return CandidateLaxity(model=model, laxity=laxity, **(settings | changes))  # type: ignore[arg-type]


def _table(laxity: Laxity, protocol: Protocol, coordinates: Array, sd: Array) -> Laxity:
    return Laxity(
        protocol=protocol,
        coordinates=coordinates,
        sd=np.broadcast_to(sd, coordinates.shape).copy(),
        within_trial_correlation=laxity.within_trial_correlation,
        zero=laxity.zero,
    )


def test_they_are_the_residuals_of_a_table_with_these_errors(small_model: LaxityModel) -> None:
    laxity = _data(small_model)
    found = _candidates(small_model, laxity)
    theta = small_model.parameters.center * 1.01
    values, jacobians = found.predict(theta, [0, 1])
    at_zero = _table(laxity, _new(), np.zeros((2, 5)), typical_errors(laxity))
    problem = LaxityResiduals(model=small_model, laxity=at_zero, weighting="noise")
    np.testing.assert_allclose(values.ravel(), problem.residuals(theta), rtol=ROUNDING)
    expected = problem.jacobian(theta)
    size = np.abs(expected).max()
    np.testing.assert_allclose(jacobians.reshape(10, 8), expected, atol=ROUNDING * size)


def test_relative_data_have_relative_candidates(small_model: LaxityModel) -> None:
    exact = small_model.simulate(small_model.parameters.center)
    protocol = with_unloaded(small_model.protocol)
    model = small_model.with_protocol(protocol)
    exact = model.simulate(model.parameters.center)
    laxity = replace(add_noise(exact, sd_mm=0.4, sd_deg=0.6, seed=0), zero="unloaded")
    found = _candidates(model, laxity)
    theta = model.parameters.center
    values, jacobians = found.predict(theta, [1])
    unloaded = Protocol(
        name="unloaded", trials=("zero",), flexion_deg=np.array([8.0]), loads=np.zeros((1, 5))
    )
    both = small_model.with_protocol(concatenate([_new().select([1]), unloaded])).predict(theta)
    assert both.jacobian is not None
    sd = np.array([0.4, 0.4, 0.4, 0.6, 0.6])
    expected = (both.coordinates[0] - both.coordinates[1]) / sd
    np.testing.assert_allclose(values[0], expected, rtol=1e-9)
    slopes = (both.jacobian[0] - both.jacobian[1]) / sd[:, None]
    np.testing.assert_allclose(jacobians[0], slopes, atol=1e-9 * np.abs(slopes).max())


def test_a_trial_may_come_twice_and_in_any_order(small_model: LaxityModel) -> None:
    found = _candidates(small_model, _data(small_model))
    theta = small_model.parameters.center
    values, jacobians = found.predict(theta, [1, 0, 1])
    first, slopes = found.predict(theta, [0, 1])
    np.testing.assert_allclose(values, first[[1, 0, 1]], rtol=ROUNDING)
    np.testing.assert_allclose(jacobians, slopes[[1, 0, 1]], rtol=1e-8, atol=1e-10)


def test_only_what_the_data_measure_and_only_what_varies(small_model: LaxityModel) -> None:
    laxity = _data(small_model)
    coordinates, sd = np.array(laxity.coordinates), np.array(laxity.sd)
    coordinates[:, 2], sd[:, 2] = np.nan, np.nan
    part = replace(laxity, coordinates=coordinates, sd=sd)
    at = np.array(small_model.parameters.center)
    at[3] *= 1.1
    fixed = [x for i, x in enumerate(small_model.parameters.names) if i not in (0, 5)]
    found = _candidates(small_model, part, free=small_model.parameters.with_fixed(fixed, at))
    theta = small_model.parameters.center[[0, 5]] * 1.02
    values, jacobians = found.predict(theta, [0])
    assert values.shape == (1, 4)
    assert jacobians.shape == (1, 4, 2)
    whole = np.array(at)
    whole[[0, 5]] = theta
    everything = _candidates(small_model, part).predict(whole, [0])
    np.testing.assert_allclose(values, everything[0], rtol=ROUNDING)
    np.testing.assert_allclose(jacobians, everything[1][:, :, [0, 5]], rtol=ROUNDING)


def test_one_trial_that_fails_leaves_the_others(small_model: LaxityModel) -> None:
    torn = replace(_new(), loads=np.array([[30.0, 0, 0, 0, 0], [-0.3, 0, 0, 0, 0]]))
    values, jacobians = _candidates(small_model, _data(small_model), protocol=torn).predict(
        small_model.parameters.center, [0, 1]
    )
    assert np.isnan(values[0]).all()
    assert np.isnan(jacobians[0]).all()
    assert np.isfinite(values[1]).all()


def test_errors_are_medians_of_those_stated(small_model: LaxityModel) -> None:
    laxity = _data(small_model)
    np.testing.assert_array_equal(typical_errors(laxity), [0.4, 0.4, 0.4, 0.6, 0.6])
    with pytest.raises(ValueError, match="standard deviations"):
        typical_errors(small_model.simulate(small_model.parameters.center))


def test_bad_input_is_refused(small_model: LaxityModel) -> None:
    laxity = _data(small_model)
    with pytest.raises(ValueError, match="one coordinate"):
        _candidates(small_model, laxity, sd=np.full(5, np.nan))
    with pytest.raises(ValueError, match=r"deviation.* 0, got 0"):
        _candidates(small_model, laxity, sd=np.array([0.0, 1, 1, 1, 1]))


def test_a_trial_that_presses_near_a_rim_is_not_offered() -> None:
    model = LaxityModel(knee=narrow_knee(0.8), protocol=load_protocol("seed63"))
    theta = model.parameters.center
    found = model.predict(theta)
    near = found.rim_share > 0.0
    laxity = _data(model)
    offered = _candidates(model, laxity, protocol=model.protocol)
    values, slopes = offered.predict(theta, range(model.protocol.n))
    assert near.any()
    assert found.all_converged
    np.testing.assert_array_equal(np.isnan(values).all(axis=1), near)
    np.testing.assert_array_equal(np.isnan(slopes).all(axis=(1, 2)), near)
