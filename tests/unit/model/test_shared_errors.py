"""Errors that many values share: what each changes, and residuals averaged over them."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import small_knee, small_protocol

from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals, has_shared_errors, shared_errors
from identknee.subject.knee import EXACTLY, Uncertainty


def uncertain(stated: Uncertainty) -> LaxityModel:
    return LaxityModel(knee=small_knee().with_uncertainty(stated), protocol=small_protocol())


def test_zeros_are_common_to_a_flexion_angle() -> None:
    model = uncertain(Uncertainty(zero_mm=0.3, zero_deg=0.5))
    columns = shared_errors(model, model.parameters.start)
    covariance = np.einsum("aik,bjk->aibj", columns, columns)
    flexion = model.protocol.flexion_deg
    sizes = np.array([0.3, 0.3, 0.3, 0.5, 0.5]) ** 2
    for a, b in np.ndindex(model.protocol.n, model.protocol.n):
        expected = np.diag(sizes) * (flexion[a] == flexion[b])
        np.testing.assert_allclose(covariance[a, :, b], expected, atol=1e-15)


def test_a_robot_has_one_zero_for_angles_that_it_reads_a_little_apart() -> None:
    protocol = small_protocol()
    apart = 0.1 * np.arange(protocol.n)
    read = replace(protocol, flexion_deg=protocol.flexion_deg + apart)
    knee = small_knee().with_uncertainty(Uncertainty(zero_mm=0.3))
    found, meant = (
        shared_errors(model, model.parameters.start)
        for model in (LaxityModel(knee=knee, protocol=x) for x in (read, protocol))
    )
    assert np.unique(read.flexion_deg).size == read.n > np.unique(protocol.flexion_deg).size
    np.testing.assert_allclose(found, meant)


def test_flexion_errs_trial_by_trial() -> None:
    model = uncertain(Uncertainty(trial_flexion_deg=0.5))
    columns = shared_errors(model, model.parameters.start)
    protocol, trial = model.protocol, 2
    ends = []
    for sign in (-1.0, 1.0):
        flexion = np.array(protocol.flexion_deg)
        flexion[trial] += 0.05 * sign
        other = LaxityModel(knee=small_knee(), protocol=replace(protocol, flexion_deg=flexion))
        ends.append(other.predict(other.parameters.start, derivatives=False).coordinates)
    slopes = 0.5 * (ends[1] - ends[0]) / 0.1
    np.testing.assert_allclose(columns[:, :, trial], slopes, atol=0.02 * np.abs(slopes).max())


def test_surfaces_change_readings_in_proportion_to_their_error() -> None:
    thin, thick = (uncertain(Uncertainty(surface_mm=x)) for x in (0.1, 0.3))
    start = thin.parameters.start
    np.testing.assert_allclose(3.0 * shared_errors(thin, start), shared_errors(thick, start))
    assert np.abs(shared_errors(thin, start)).max() > 0.01


def test_residuals_are_independent_once_shared_errors_are_taken_out() -> None:
    model = uncertain(Uncertainty(zero_mm=0.3, trial_flexion_deg=0.5))
    start = np.array(model.parameters.start)
    generator = np.random.default_rng(3)
    coordinates = model.simulate(start).coordinates + generator.normal(
        0.0, 0.4, (model.protocol.n, 5)
    )
    laxity = Laxity(
        protocol=model.protocol, coordinates=coordinates, sd=np.full_like(coordinates, 0.4)
    )
    columns = shared_errors(model, start)
    made = LaxityResiduals(model=model, laxity=laxity, weighting="noise", shared=columns)
    flat = columns.reshape(-1, columns.shape[2])
    covariance = 0.16 * np.eye(len(flat)) + flat @ flat.T
    plain = LaxityResiduals(model=model, laxity=laxity).residuals(start)
    residuals = made.residuals(start)
    expected = float(plain @ np.linalg.solve(covariance, plain))
    assert float(residuals @ residuals) == pytest.approx(expected, rel=1e-9)


def test_shared_errors_need_a_noise() -> None:
    model = uncertain(Uncertainty(zero_mm=0.3))
    laxity = model.simulate(np.array(model.parameters.start))
    with pytest.raises(ValueError, match="their noise"):
        LaxityResiduals(
            model=model, laxity=laxity, shared=shared_errors(model, model.parameters.start)
        )


def test_a_knee_known_exactly_has_no_shared_errors() -> None:
    assert not has_shared_errors(EXACTLY)
    assert not has_shared_errors(Uncertainty(insertions_mm=2.0))
    assert has_shared_errors(Uncertainty(surface_mm=0.1))
