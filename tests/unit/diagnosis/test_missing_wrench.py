"""The missing wrench: that of a structure the model lacks, its errors, its mean on the plateau."""

from dataclasses import replace

import numpy as np
import pytest
from line_gradient import line_gradient
from small_knee import small_knee, small_protocol

from identknee.diagnosis.misfit import TrialLayout
from identknee.diagnosis.missing_line import missing_pulls
from identknee.laxity.table import COORDINATES, Laxity, add_noise
from identknee.mechanics.pose import rotation_matrix
from identknee.model.effects.structures import MissingStructure
from identknee.model.laxity_model import LaxityModel
from identknee.model.missing_wrench import MissingWrench, missing_wrench
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array

# The Hessian is that of one pose, so that a small force is found to a share of itself.
LINEAR = 0.03


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    return LaxityModel(knee=small_knee(), protocol=small_protocol())


def with_errors(model: LaxityModel, theta: Array, of: LaxityModel) -> LaxityResiduals:
    laxity = model.simulate(theta)
    noisy = add_noise(laxity, sd_mm=0.2, sd_deg=0.3, seed=1, correlation=0.3)
    return LaxityResiduals(model=of, laxity=replace(noisy, coordinates=laxity.coordinates))


def noise_of(laxity: Laxity) -> tuple[Array, float]:
    """As the data state it."""
    assert laxity.sd is not None
    return laxity.sd, laxity.within_trial_correlation


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
    found = missing_wrench(problem, theta, *noise_of(problem.laxity))
    setting = extended.setting(np.r_[theta, 0.002, 6.0])
    poses = model.predict(theta).poses
    flexion = setting.flexion[model.paths.trial_node]
    # What the other lines do not do; the load that stands for a pull is minus its gradient.
    unchanged = extended.setting(theta=np.r_[theta, 0.0, 6.0])
    pull = line_gradient(unchanged, flexion, poses) - line_gradient(setting, flexion, poses)
    size = np.linalg.norm(pull, axis=0)
    assert (np.linalg.norm(found.wrench - pull, axis=0) < LINEAR * size.max()).all()


def test_it_weighs_as_much_as_the_residuals(model: LaxityModel) -> None:
    theta = model.parameters.center
    data = add_noise(model.simulate(theta), sd_mm=0.2, sd_deg=0.3, seed=2, correlation=0.3)
    problem = LaxityResiduals(model=model, laxity=data, weighting="noise")
    found = missing_wrench(problem, theta, *noise_of(problem.laxity))
    solved = np.linalg.solve(found.covariance, found.wrench[:, :, None])[:, :, 0]
    residuals = problem.residuals(theta)
    assert (found.wrench * solved).sum() == pytest.approx(residuals @ residuals, rel=1e-6)


def test_only_what_lies_outside_contact_is_quiet(model: LaxityModel) -> None:
    theta = model.parameters.center
    problem = with_errors(model, theta, model)
    found = missing_wrench(problem, theta, *noise_of(problem.laxity))
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
    found = missing_wrench(problem, theta, *noise_of(problem.laxity))
    assert np.isnan(found.wrench[2]).all()
    assert np.isnan(found.outside_covariance[2]).all()
    assert np.isfinite(np.delete(found.outside, 2, axis=0)).all()


N_TRIALS = 400
SPREAD = np.array([500.0, 800.0, 30.0, 200.0, 20.0])


def pulled(force: Array, moment: float, *, seed: int) -> tuple[MissingWrench, TrialLayout]:
    """Wrenches of a force in tibial axes [N] and a moment about the tibial axis [N mm], noisy."""
    generator = np.random.default_rng(seed)
    poses = generator.normal(0.0, [0.1, 0.3, 5.0, 5.0, 5.0], (N_TRIALS, 5))
    turned = np.stack([rotation_matrix(0.0, *pose[:2]) @ force for pose in poses])
    exact = np.column_stack([np.zeros(N_TRIALS), np.full(N_TRIALS, moment), turned])
    noisy = exact + generator.normal(0.0, SPREAD, exact.shape)
    covariance = np.broadcast_to(np.diag(SPREAD**2), (N_TRIALS, 5, 5))
    wrench = MissingWrench(
        wrench=noisy,
        covariance=covariance,
        outside=noisy,
        outside_covariance=covariance,
        poses=poses,
    )
    loads = np.zeros((N_TRIALS, 1))
    loads[: N_TRIALS // 2] = 1.0
    layout = TrialLayout(
        flexion_deg=np.where(np.arange(N_TRIALS) % 4 == 0, 30.0, 0.0),
        loads=loads,
        directions=(("internal moment", "external moment"),),
        coordinates=COORDINATES,
        is_measured=np.ones((N_TRIALS, 5), bool),
    )
    return wrench, layout


def test_its_mean_is_that_of_each_flexion_and_direction() -> None:
    force, moment = np.array([12.0, -80.0, 25.0]), 400.0
    pulls = missing_pulls(*pulled(force, moment, seed=3))
    assert [(x.flexion_deg, x.direction, x.n_trials) for x in pulls] == [
        (0.0, "internal moment", 150),
        (0.0, "no load", 150),
        (30.0, "internal moment", 50),
        (30.0, "no load", 50),
    ]
    truth = np.array([force[0], force[2], moment / 1000.0])
    for pull in pulls:
        # 4 standard errors: one in 16,000 of 12 numbers would be farther off.
        mean = [pull.anterior_force_N, pull.lateral_force_N, pull.internal_moment_Nm]
        sd = [pull.sd_anterior_force_N, pull.sd_lateral_force_N, pull.sd_internal_moment_Nm]
        np.testing.assert_array_less(np.abs(mean - truth), 4.0 * np.array(sd))


def test_noise_alone_asks_for_little() -> None:
    p_values = np.concatenate(
        [
            [x.p_value for x in missing_pulls(*pulled(np.zeros(3), 0.0, seed=seed))]
            for seed in range(100)
        ]
    )
    # The standard error of the mean of 400 uniform numbers is 0.014.
    assert p_values.mean() == pytest.approx(0.5, abs=5 * 0.0145)
    assert max(x.p_value for x in missing_pulls(*pulled(np.full(3, 60.0), 0.0, seed=1))) < 1e-6
