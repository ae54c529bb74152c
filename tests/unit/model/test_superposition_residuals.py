"""Residuals of in-situ forces: slopes, covariance, and what they add to a fit."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from bundled_knee import bundled_knee
from replayed_paths import SD, SD_N, Row, in_situ_forces

import identknee as ik
from identknee.calibrate.problem import SUPERPOSITION_TERM, TABLE_TERM
from identknee.checks.usable_trials import defined_everywhere, with_other_terms
from identknee.laxity.experiment_tables import joined
from identknee.laxity.experiments import Experiment
from identknee.laxity.forces import Superposition
from identknee.laxity.protocol import Protocol
from identknee.model.force_residuals import (
    SuperpositionResiduals,
    structure_wrenches,
    weighed,
)
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array
from identknee.runs.errors import ValueRefused
from identknee.subject.knee import Uncertainty

PROTOCOL = ik.load_protocol("table2").select([2, 3])
A, B = PROTOCOL.trials
ROWS = [
    (A, "ACL", "intact", "cut: ACL"),
    (A, "MCL", "cut: ACL", "cut: ACL, MCL"),
    (B, "LCL", "intact", "cut: LCL"),
]
CELL = {"load_cell_N": 3.0, "load_cell_Nm": 0.1}


def _model(knee: ik.Knee | None = None) -> LaxityModel:
    """A model with the constant errors of the rig's cell."""
    return LaxityModel(knee=knee or ik.reference_knee(), protocol=_in_a_rig(PROTOCOL))


def _in_a_rig(protocol: Protocol) -> Protocol:
    rig = Experiment(name="tests", rig="robot", mounting="robot-1", uncertainty=CELL)
    empty = ik.Laxity(protocol=protocol, coordinates=np.full((protocol.n, 5), np.nan))
    return joined([(rig, empty)]).protocol


def _theta(model: LaxityModel, seed: int = 5) -> Array:
    p = model.parameters
    steps = np.random.default_rng(seed).uniform(-0.2, 0.2, p.n) * p.prior_sd
    return np.where(p.is_log, p.start * np.exp(steps), p.start + steps)


def _made(model: LaxityModel, rows: Sequence[Row] = ROWS, **how: object) -> Superposition:
    return in_situ_forces(model, model.parameters.start, rows, **how)  # type: ignore[arg-type]


@pytest.mark.parametrize("sizes", [False, True])
def test_slopes_are_those_of_differences(sizes: bool) -> None:
    stated = Uncertainty(insertions_mm=2.0, registration_deg=2.0, registration_mm=2.0)
    model = _model(bundled_knee().with_uncertainty(stated))
    made = _made(model, pose_sd=(0.2, 0.2), sizes=sizes)
    problem = SuperpositionResiduals(model=model, superposition=made)
    assert problem.n == (3 if sizes else 18)
    theta = _theta(model)
    jacobian, spread = problem.jacobian(theta), model.parameters.prior_sd_in_own_units
    largest = np.abs(jacobian * spread).max()
    for i in range(theta.size):
        move = 1e-4 * spread[i] * np.eye(theta.size)[i]
        slope = (problem.residuals(theta + move) - problem.residuals(theta - move)) / 2e-4
        np.testing.assert_allclose(jacobian[:, i] * spread[i], slope, atol=1e-6 * largest)


def test_a_constant_error_of_the_cell_adds_to_every_reading_of_its_rig() -> None:
    model = _model()
    problem = SuperpositionResiduals(model=model, superposition=_made(model))
    theta = np.array(model.parameters.start)
    np.testing.assert_allclose(problem.residuals(theta), 0.0, atol=1e-9)
    theta[model.parameters.index("robot/load_cell.moment_z_Nm")] = 0.5
    moved = problem.predicted(theta) - problem.superposition.values
    expected = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.5], (3, 1))
    np.testing.assert_allclose(moved[:, :6], expected, atol=1e-9)


def test_a_cell_leaves_the_names_of_other_errors() -> None:
    knee = ik.reference_knee().with_uncertainty(Uncertainty(registration_deg=2.0))
    names = _model(knee).parameters.nuisance_names
    assert names[0] == "registration.femur_x_deg"
    assert names[-1] == "robot/load_cell.moment_z_Nm"


def _covariance(problem: SuperpositionResiduals) -> Array:
    """Covariance of the values that the residuals are whitened by."""
    model = problem.model
    at_start = problem.predicted(model.parameters.start)
    columns = []
    for row, i in np.argwhere(problem.superposition.is_measured):
        values = np.array(problem.superposition.values)
        values[row, i] = at_start[row, i] - 1.0
        moved = replace(problem.superposition, values=values)
        other = replace(problem, superposition=moved)
        columns.append(other.residuals(model.parameters.start))
    whitening = np.array(columns).T
    return np.asarray(np.linalg.inv(whitening.T @ whitening))


def test_consecutive_cuts_share_the_error_of_a_reading() -> None:
    problem = SuperpositionResiduals(model=_model(), superposition=_made(_model()))
    found = _covariance(problem)
    expected = np.kron([[1.0, -0.5, 0.0], [-0.5, 1.0, 0.0], [0.0, 0.0, 1.0]], np.diag(SD**2))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_an_error_of_the_pose_counts_by_the_stiffness_of_what_was_cut() -> None:
    model = _model()
    made = _made(model, pose_sd=(0.3, 0.1))
    found = _covariance(SuperpositionResiduals(model=model, superposition=made))
    start = model.parameters.start
    trials = [PROTOCOL.trials.index(x) for x in made.trials]
    by_twist = structure_wrenches(model, model.predict(start), trials, made.cut).by_twist
    spread = np.diag(np.repeat([0.3, np.radians(0.1)], 3) ** 2)
    for i in range(3):
        own = slice(6 * i, 6 * i + 6)
        expected = by_twist[i] @ spread @ by_twist[i].T + np.diag(SD**2)
        np.testing.assert_allclose(found[own, own], expected, rtol=1e-6, atol=1e-6)
    # Two runs have two errors: only the reading between is common.
    np.testing.assert_allclose(found[:6, 6:12], -0.5 * np.diag(SD**2), atol=1e-6)
    # Hundreds of N/mm along the ligament turn 0.3 mm into more than the load that stretched it.
    acl = model.knee.ligaments[0]
    slack_length = model.knee.reference_lengths[0] / (1.0 + 0.01 * acl.reference_strain_pct)
    share = np.linalg.norm(made.values[0, :3]) / (1e3 * acl.stiffness_kN)
    slope = np.sqrt(share / 0.03)  # of the toe, which ends at twice 3 %
    assert slope < 1.0
    stiffness = slope * 1e3 * acl.stiffness_kN / slack_length
    force = np.linalg.norm(found[:3, :3], 2)
    assert np.sqrt(force - SD_N**2) == pytest.approx(0.3 * stiffness, rel=0.02)


def test_what_is_weighed_once_keeps_its_covariance() -> None:
    model = _model()
    laxity = _laxity(model, _made(model, pose_sd=(0.3, 0.1)))
    theta = model.parameters.vector({"ACL.stiffness_kN": 20.0})
    made = weighed(laxity, model, theta).superposition
    assert made is not None
    problem = SuperpositionResiduals(model=model, superposition=made)
    at_start = SuperpositionResiduals(model=model, superposition=replace(made, covariance=None))
    # A stiffer ligament makes more of an error of the pose, also in what is left of the rows.
    assert np.all(problem.sd[0, :3] > 1.1 * at_start.sd[0, :3])
    left = SuperpositionResiduals(model=model, superposition=made.select([2, 0]))
    np.testing.assert_allclose(left.sd, problem.sd[[2, 0]], rtol=1e-9)


@pytest.mark.slow
def test_the_errors_of_simulated_readings_have_this_covariance() -> None:
    model = _model()
    start = model.parameters.start
    generator = np.random.default_rng(1)
    whitened = []
    for _ in range(200):
        made = _made(model, pose_sd=(0.05, 0.05), generator=generator)
        whitened.append(SuperpositionResiduals(model=model, superposition=made).residuals(start))
    found = np.cov(np.array(whitened).T)
    # 200 draws know a variance to 10 %, a correlation to 0.07.
    np.testing.assert_allclose(np.diag(found), 1.0, atol=0.4)
    np.testing.assert_allclose(found - np.diag(np.diag(found)), 0.0, atol=0.35)
    assert np.trace(found) / len(found) == pytest.approx(1.0, abs=0.06)


def _laxity(model: LaxityModel, made: Superposition) -> ik.Laxity:
    found = model.predict(model.parameters.start)
    sd = np.full(found.coordinates.shape, 0.5)
    return ik.Laxity(
        protocol=model.protocol, coordinates=found.coordinates, sd=sd, superposition=made
    )


def test_they_are_a_term_of_their_own_and_leave_lost_trials_out() -> None:
    model = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    laxity = _laxity(model, _made(model, pose_sd=(0.1, 0.1)))
    residuals = LaxityResiduals(model=model, laxity=laxity, weighting="noise")
    whole = with_other_terms(residuals)
    theta = _theta(model)
    assert whole.residuals(theta).size == 10 + 18
    lost = model.parameters.vector({f"{x}.reference_strain_pct": -15.0 for x in ("ACL", "PCL")})
    assert not model.predict(lost).is_converged.all()
    assert np.isinf(whole.residuals(lost)).all()
    held = defined_everywhere(residuals)
    assert np.isfinite(held.residuals(lost)).all()
    assert np.isfinite(held.jacobian(lost)).all()
    with pytest.raises(ValueError, match="--noise"):
        ik.fit("reference", replace(laxity, sd=None))


def test_a_fit_finds_the_knee_that_made_them() -> None:
    protocol = ik.load_protocol("drawer")
    model = LaxityModel(knee=ik.reference_knee(), protocol=protocol)
    rows = [(x, "ACL", "intact", "cut: ACL") for x in protocol.trials]
    laxity = _laxity(model, _made(model, rows, pose_sd=(0.1, 0.1)))
    found = ik.fit("reference", laxity, more_starts=0, start={"ACL.stiffness_kN": 8.0})
    np.testing.assert_allclose(found.search.theta, model.parameters.start, atol=1e-3)
    terms = {x.name: x.n for x in found.evidence}
    assert terms[TABLE_TERM] == 5 * protocol.n
    assert terms[SUPERPOSITION_TERM] == 6 * protocol.n
    widths = []
    for x in (laxity.without_forces(), laxity):
        profile = ik.profile("reference", x, parameters=["ACL.stiffness_kN"])
        made = profile.parameters["ACL.stiffness_kN"]
        assert made.lower is not None
        assert made.upper is not None
        widths.append(made.upper - made.lower)
    assert widths[1] < 0.7 * widths[0]


def test_of_a_group_those_bundles_count_that_were_left() -> None:
    model = LaxityModel(knee=bundled_knee(), protocol=PROTOCOL)
    rows = [
        (B, "MCLa", "intact", "cut: MCLa"),
        (B, "MCL", "cut: MCLa", "cut: MCL, MCLa"),
    ]
    theta = _theta(model)
    # The group as a whole, and one bundle after the other.
    made = in_situ_forces(model, theta, rows)
    whole = in_situ_forces(model, theta, [(B, "MCL", "intact", "cut: MCL")])
    predicted = SuperpositionResiduals(model=model, superposition=made).predicted(theta)
    sizes = predicted[:, 0]
    assert np.abs(sizes).min() > 1.0
    np.testing.assert_allclose(predicted[:, :6].sum(axis=0), whole.values[0, :6], rtol=1e-9)
    problem = SuperpositionResiduals(model=model, superposition=made)
    jacobian = problem.jacobian(theta)
    for i in range(theta.size):
        move = 1e-5 * model.parameters.prior_sd_in_own_units[i] * np.eye(theta.size)[i]
        slope = (problem.residuals(theta + move) - problem.residuals(theta - move)) / 2e-5
        made_slope = jacobian[:, i] * model.parameters.prior_sd_in_own_units[i]
        np.testing.assert_allclose(made_slope, slope, atol=1e-5 * np.abs(jacobian).max())


def test_what_was_cut_before_has_no_force() -> None:
    protocol = replace(PROTOCOL, state=("intact", "intact"))
    model = LaxityModel(knee=bundled_knee(), protocol=protocol)
    gone = _made(_model(bundled_knee()), [(A, "MCLa", "intact", "cut: MCLa")])
    for before, after, named in (
        ("cut: MCL", "cut: MCL, MCLa", "nothing of it was left"),
        ("cut: MCL 50%", "cut: MCL 50%, MCLa", "a part of it was cut"),
    ):
        wrong = replace(gone, before=(before,), after=(after,))
        with pytest.raises(ValueError, match=named):
            SuperpositionResiduals(model=model, superposition=wrong)
    protocol = replace(PROTOCOL, state=("cut: MCLa, MCLp", "intact"))
    model = LaxityModel(knee=bundled_knee(), protocol=protocol)
    made = _made(_model(bundled_knee()), [(A, "MCL", "intact", "cut: MCL")])
    later = replace(made, before=("cut: MCLa, MCLp",), after=("cut: MCL, MCLa, MCLp",))
    with pytest.raises(ValueRefused, match="cut before") as caught:
        SuperpositionResiduals(model=model, superposition=later)
    assert caught.value.why.startswith("MCL in ")
    wrong = replace(made, cut=("XYZ",), after=("cut: XYZ",))
    with pytest.raises(ValueError, match="XYZ"):
        SuperpositionResiduals(model=model, superposition=wrong)
