"""Nuisances of a knee: nothing at zero, exact slopes, and what each is known to do."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_knee import small_knee, small_protocol

from identknee.laxity.protocol import Protocol
from identknee.mechanics.grood_suntay import coordinates_from_pose, pose_from_coordinates
from identknee.model.laxity_model import LaxityModel
from identknee.model.nuisances.geometry import insertions
from identknee.model.nuisances.library import nuisances_of
from identknee.runs.arrays import Array
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee
from identknee.subject.uncertainty import Uncertainty

EVERYTHING = Uncertainty(
    insertions_mm=2.0,
    registration_deg=2.0,
    registration_mm=2.0,
    load_axes_deg=2.0,
    load_gain=0.05,
    flexion_deg=1.0,
    contact_modulus=0.3,
    reference_pose_deg=1.0,
    reference_pose_mm=1.0,
)


def uncertain(stated: Uncertainty) -> LaxityModel:
    return LaxityModel(knee=small_knee().with_uncertainty(stated), protocol=small_protocol())


def displaced(model: LaxityModel, share: float, seed: int = 0) -> Array:
    """Theta with nuisances at so many standard deviations in random directions."""
    p = model.parameters
    drawn = np.random.default_rng(seed).standard_normal(p.n) * ~p.is_of_interest
    return np.asarray(p.start + share * p.prior_sd * drawn)


def test_a_knee_known_exactly_has_none() -> None:
    assert nuisances_of(small_knee()) == ()
    assert uncertain(EVERYTHING).parameters.nuisance_names[0].startswith("insertion.")


def test_nuisances_at_zero_change_nothing() -> None:
    exact, model = uncertain(Uncertainty()), uncertain(EVERYTHING)
    expected = exact.predict(exact.parameters.start, derivatives=False).coordinates
    made = model.predict(model.parameters.start, derivatives=False).coordinates
    np.testing.assert_allclose(made, expected, atol=1e-9)


def at_poses(model: LaxityModel, theta: Array) -> LaxityModel:
    """The model begun at measured poses, which are those it has at theta."""
    coordinates = model.predict(theta, derivatives=False).coordinates
    return replace(model, poses=pose_from_coordinates(coordinates))


@pytest.mark.parametrize("is_measured", [False, True])
def test_slopes_are_those_of_differences(is_measured: bool) -> None:
    model = uncertain(EVERYTHING)
    theta = displaced(model, 0.3)
    if is_measured:
        model = at_poses(model, theta)
    jacobian = model.predict(theta).jacobian
    assert jacobian is not None
    for i in np.flatnonzero(~model.parameters.is_of_interest):
        move = np.zeros(theta.size)
        move[i] = 2e-4 * model.parameters.prior_sd[i]
        ends = [model.predict(theta + s * move, derivatives=False).coordinates for s in (-1, 1)]
        slope = (ends[1] - ends[0]) / (2.0 * move[i])
        size = max(float(np.abs(slope).max()), 1e-3)
        np.testing.assert_allclose(jacobian[:, :, i], slope, atol=0.02 * size)


def moved(frame: Frame, values: Array) -> Frame:
    turn = Rotation.from_rotvec(np.radians(values[:3])).as_matrix()
    return Frame(origin=frame.to_common(values[3:]), axes=turn.T @ frame.axes)


def test_the_measured_attitude_turns_loads_and_flexion() -> None:
    """A tibia turned by 35 deg flexes about another axis; what is left is the flexion moment's."""
    protocol = Protocol(
        name="two",
        trials=("external", "internal"),
        flexion_deg=np.array([60.0, 60.0]),
        loads=np.array([[-10.0, 0.0, 0.0, 0.0, 0.0], [10.0, 0.0, 0.0, 0.0, 0.0]]),
    )
    stated = Uncertainty(registration_deg=2.0)
    model = LaxityModel(knee=reference_knee().with_uncertainty(stated), protocol=protocol)
    for seed in (1, 2):
        values = 2.0 * np.random.default_rng(seed).standard_normal(6)
        theta = np.r_[model.parameters.start[:-6], values]
        knee: Knee = replace(
            model.knee,
            uncertainty=Uncertainty(),
            femur_frame=moved(model.knee.femur_frame, np.r_[values[:3], np.zeros(3)]),
            tibia_frame=moved(model.knee.tibia_frame, np.r_[values[3:], np.zeros(3)]),
        )
        other = LaxityModel(knee=knee, protocol=protocol)
        laxity = other.simulate(other.parameters.start)
        without, given = (
            np.abs(x.predict(theta, derivatives=False).coordinates - laxity.coordinates).max()
            for x in (model, model.with_tests(laxity))
        )
        assert given < 0.6 * without


@pytest.mark.parametrize("seed", range(3))
def test_registration_is_a_knee_whose_frames_were_moved(seed: int) -> None:
    model = uncertain(Uncertainty(registration_deg=2.0, registration_mm=2.0))
    values = 0.5 * np.random.default_rng(seed).standard_normal(12)
    theta = np.r_[model.parameters.start[:-12], values]
    made = model.predict(theta, derivatives=False).coordinates
    knee: Knee = replace(
        model.knee,
        uncertainty=Uncertainty(),
        femur_frame=moved(model.knee.femur_frame, values[:6]),
        tibia_frame=moved(model.knee.tibia_frame, values[6:]),
    )
    other = LaxityModel(knee=knee, protocol=model.protocol)
    expected = other.predict(other.parameters.start, derivatives=False).coordinates
    # Loads and flexion are turned as in a knee without varus and internal rotation: what is left
    # is the product of both angles.
    unmoved = model.predict(model.parameters.start, derivatives=False).coordinates
    assert np.abs(made - expected).max() < 0.2
    assert np.abs(made - expected).max() < 0.25 * np.abs(unmoved - expected).max()


def registration_errors(stated: Uncertainty, values: Array) -> tuple[Array, Array]:
    """How far registration is off, begun at the measured poses and at the scanned one."""
    model = uncertain(stated)
    theta = np.r_[model.parameters.start[: -values.size], values]
    whole = values if values.size == 12 else np.r_[0, 0, 0, values[:3], 0, 0, 0, values[3:]]
    knee: Knee = replace(
        model.knee,
        uncertainty=Uncertainty(),
        femur_frame=moved(model.knee.femur_frame, whole[:6]),
        tibia_frame=moved(model.knee.tibia_frame, whole[6:]),
    )
    other = LaxityModel(knee=knee, protocol=model.protocol)
    expected = other.predict(other.parameters.start, derivatives=False).coordinates
    poses = at_poses(other, other.parameters.start).poses
    made = [replace(model, poses=x).predict(theta, derivatives=False) for x in (poses, None)]
    return made[0].coordinates - expected, made[1].coordinates - expected


def test_shifts_of_the_measured_frames_are_exact_in_the_measured_pose() -> None:
    shifts = 3.0 * np.random.default_rng(4).standard_normal(6)
    measured, scanned = registration_errors(Uncertainty(registration_mm=3.0), shifts)
    assert np.abs(measured).max() < 1e-9
    assert np.abs(scanned).max() > 0.01


def test_turns_of_the_measured_frames_are_nearer_in_the_measured_pose() -> None:
    # What is left is the moment that holds flexion: it acts in the frames of the geometry.
    stated = Uncertainty(registration_deg=2.0, registration_mm=2.0)
    drawn = [2.0 * np.random.default_rng(seed).standard_normal(12) for seed in range(6)]
    measured, scanned = zip(*(registration_errors(stated, x) for x in drawn), strict=True)
    assert np.linalg.norm(measured) < 0.5 * np.linalg.norm(scanned)


def test_where_a_search_begins_is_read_as_the_measured_pose() -> None:
    stated = Uncertainty(registration_deg=4.0, registration_mm=4.0)
    model = at_poses(uncertain(stated), uncertain(stated).parameters.start)
    theta = displaced(model, 1.0)
    begun = model.setting(theta).measured
    assert begun is not None
    assert model.poses is not None
    read = model.extension.observe(
        coordinates_from_pose(begun), model.amplitudes(theta), model.tests
    )
    np.testing.assert_allclose(read, coordinates_from_pose(model.poses), atol=1e-9)


def test_load_gain_scales_one_kind_of_load() -> None:
    model = uncertain(Uncertainty(load_gain=0.05))
    theta = np.array(model.parameters.start)
    theta[model.parameters.index("load_gain.internal_moment")] = 0.1
    column = model.protocol.loads[:, 0]
    larger = replace(
        model.protocol, loads=np.column_stack([1.1 * column, model.protocol.loads[:, 1:]])
    )
    made = model.predict(theta, derivatives=False).coordinates
    exact = LaxityModel(knee=small_knee(), protocol=larger)
    expected = exact.predict(exact.parameters.start, derivatives=False).coordinates
    np.testing.assert_allclose(made, expected, atol=1e-6)


def test_insertions_along_principal_axes_have_the_covariance_stated() -> None:
    covariance = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, 0.0], [0.5, 0.0, 1.0]])
    rows = tuple(tuple(x) for x in covariance.tolist())
    knee = small_knee().with_uncertainty(Uncertainty(insertions_mm={"front": {"tibia": rows}}))
    effect = insertions(knee)
    assert effect.parameters.n == 3
    spread = effect.matrix @ np.diag(effect.parameters.prior_sd**2) @ effect.matrix.T
    seen = np.flatnonzero(np.diag(spread))
    np.testing.assert_allclose(spread[np.ix_(seen, seen)], covariance, atol=1e-12)


def test_more_flexion_is_a_protocol_at_other_angles() -> None:
    model = uncertain(Uncertainty(flexion_deg=1.0))
    theta = np.array(model.parameters.start)
    theta[-1] = 1.5
    protocol = replace(model.protocol, flexion_deg=model.protocol.flexion_deg + 1.5)
    exact = LaxityModel(knee=small_knee(), protocol=protocol)
    expected = exact.predict(exact.parameters.start, derivatives=False).coordinates
    made = model.predict(theta, derivatives=False).coordinates
    np.testing.assert_allclose(made, expected, atol=1e-6)


@pytest.mark.parametrize(("name", "sign"), [("femur_z_deg", -1.0), ("tibia_z_deg", 1.0)])
def test_a_measured_frame_turned_about_z_is_another_flexion(name: str, sign: float) -> None:
    """Femoral axes turned towards flexion are flexed less against the tibia: Rz(1) Rz(-f)."""
    model = uncertain(Uncertainty(registration_deg=2.0))
    theta = np.array(model.parameters.start)
    theta[model.parameters.index(f"registration.{name}")] = 1.0
    turned = model.setting(theta).flexion - model.setting(theta, is_changed=False).flexion
    np.testing.assert_allclose(np.degrees(turned), sign, atol=1e-9)
