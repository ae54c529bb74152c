"""The missing wrench: that of a structure the model lacks, and its errors."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import small_knee, small_protocol

from identknee.diagnosis.missing_wrench import missing_wrench
from identknee.laxity.noise import add_noise
from identknee.model.effects.structures import MissingStructure
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array

# The Hessian is that of one pose, so that a small force is found to a share of itself.
LINEAR = 0.03


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    return LaxityModel(knee=small_knee(), protocol=small_protocol())


def with_errors(model: LaxityModel, theta: Array, of: LaxityModel) -> LaxityResiduals:
    laxity = model.simulate(theta)
    noisy = add_noise(laxity, sd_mm=0.2, sd_deg=0.3, seed=1, correlation=0.3)
    return LaxityResiduals(model=of, laxity=replace(noisy, coordinates=laxity.coordinates))


def test_it_is_the_pull_of_the_structure_left_out(model: LaxityModel) -> None:
    hidden = MissingStructure(
        name="hidden",
        femoral=np.array([[-3.0, 3.0, 15.0]]),
        tibial=np.array([[4.0, -15.0, 16.0]]),
        stiffness_sd=1.0,
        sites_vary=False,
    )
    extended = model.with_effects([hidden])
    theta = model.parameters.center
    problem = with_errors(extended, np.r_[theta, 0.002, 6.0], model)
    found = missing_wrench(problem, theta)
    setting = extended.setting(np.r_[theta, 0.002, 6.0])
    poses = model.predict(theta).poses
    flexion = setting.flexion[model.paths.trial_node]
    # What the other lines do not do; the load that stands for a pull is minus its gradient.
    unchanged = extended.setting(theta=np.r_[theta, 0.0, 6.0])
    pull = unchanged.line_gradient(flexion, poses) - setting.line_gradient(flexion, poses)
    size = np.linalg.norm(pull, axis=0)
    assert (np.linalg.norm(found.wrench - pull, axis=0) < LINEAR * size.max()).all()


def test_it_weighs_as_much_as_the_residuals(model: LaxityModel) -> None:
    theta = model.parameters.center
    data = add_noise(model.simulate(theta), sd_mm=0.2, sd_deg=0.3, seed=2, correlation=0.3)
    problem = LaxityResiduals(model=model, laxity=data, weighting="noise")
    found = missing_wrench(problem, theta)
    solved = np.linalg.solve(found.covariance, found.wrench[:, :, None])[:, :, 0]
    residuals = problem.residuals(theta)
    assert (found.wrench * solved).sum() == pytest.approx(residuals @ residuals, rel=1e-6)


def test_only_what_lies_outside_contact_is_quiet(model: LaxityModel) -> None:
    theta = model.parameters.center
    problem = with_errors(model, theta, model)
    found = missing_wrench(problem, theta)
    superior = np.sqrt(found.covariance[:, 3, 3])
    outside = np.sqrt(np.einsum("nii->ni", found.outside_covariance))
    assert (np.linalg.matrix_rank(found.outside_covariance[0], rtol=1e-9)) == 3
    assert (outside[:, 3] < 0.2 * superior).all()


def test_a_trial_with_a_blank_has_none(model: LaxityModel) -> None:
    theta = model.parameters.center
    laxity = with_errors(model, theta, model).laxity
    coordinates = np.array(laxity.coordinates)
    coordinates[2, 1] = np.nan
    problem = LaxityResiduals(model=model, laxity=replace(laxity, coordinates=coordinates))
    found = missing_wrench(problem, theta)
    assert np.isnan(found.wrench[2]).all()
    assert np.isnan(found.outside_covariance[2]).all()
    assert np.isfinite(np.delete(found.outside, 2, axis=0)).all()


def test_errors_must_be_stated(model: LaxityModel) -> None:
    laxity = model.simulate(model.parameters.center)
    with pytest.raises(ValueError, match="standard deviation"):
        missing_wrench(LaxityResiduals(model=model, laxity=laxity), model.parameters.center)
