"""Nuisances of a knee: nothing at zero, exact slopes, and what each is known to do."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_knee import small_knee, small_protocol

from identknee.mechanics.distance_field import MOST_ROUNDING
from identknee.mechanics.pose import pose_from_coordinates
from identknee.model.effects.structures import structure_at
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.mechanics_inputs import frames_at
from identknee.model.nuisances import contact_rounding, insertions, nuisances_of
from identknee.runs.declare import Array
from identknee.subject.knee import Frame, Knee, Uncertainty

EVERYTHING = Uncertainty(
    insertions_mm=2.0,
    registration_deg=2.0,
    registration_mm=2.0,
    load_axes_deg=2.0,
    load_gain=0.05,
    flexion_deg=1.0,
    contact_modulus=0.3,
    contact_exponent=0.2,
    toe_region=0.3,
    reference_pose_deg=1.0,
    reference_pose_mm=1.0,
)
# Femoral and tibial end of a line that the small knee lacks.
SIDE = np.array([2.0, 3.0, 15.0]), np.array([3.0, -14.0, 17.0])


def uncertain(stated: Uncertainty) -> LaxityModel:
    return LaxityModel(knee=small_knee().with_uncertainty(stated), protocol=small_protocol())


def exact_knee() -> Knee:
    """The small knee known exactly, with the contact law of an uncertain one."""
    return replace(small_knee(), contact_rounding_mm=MOST_ROUNDING)


def displaced(model: LaxityModel, share: float, seed: int = 0) -> Array:
    """Theta with nuisances at so many standard deviations in random directions."""
    p = model.parameters
    drawn = np.random.default_rng(seed).standard_normal(p.n) * ~p.is_of_interest
    return np.asarray(p.start + share * p.prior_sd * drawn)


def test_a_knee_known_exactly_has_none() -> None:
    assert nuisances_of(small_knee()) == ()
    assert uncertain(EVERYTHING).parameters.nuisance_names[0].startswith("insertion.")


def test_contact_begins_gradually_where_something_is_uncertain() -> None:
    assert contact_rounding(small_knee()) == 0.0
    assert contact_rounding(exact_knee()) == MOST_ROUNDING
    # Errors of surfaces are the same for every parameter: they are no nuisance.
    for stated, expected in ((Uncertainty(surface_mm=0.1), 0.0), (EVERYTHING, MOST_ROUNDING)):
        assert contact_rounding(small_knee().with_uncertainty(stated)) == expected


def test_nuisances_at_zero_change_nothing() -> None:
    exact, model = LaxityModel(knee=exact_knee(), protocol=small_protocol()), uncertain(EVERYTHING)
    expected = exact.predict(exact.parameters.start, derivatives=False).coordinates
    made = model.predict(model.parameters.start, derivatives=False).coordinates
    np.testing.assert_allclose(made, expected, atol=1e-9)


def at_poses(model: LaxityModel, theta: Array) -> LaxityModel:
    """The model begun at measured poses, which are those it has at theta."""
    coordinates = model.predict(theta, derivatives=False).coordinates
    return replace(model, poses=pose_from_coordinates(coordinates))


@pytest.mark.parametrize("is_measured", [False, True])
@pytest.mark.parametrize("has_structure", [False, True])
def test_slopes_are_those_of_differences(is_measured: bool, has_structure: bool) -> None:
    model = uncertain(EVERYTHING)
    is_checked = ~model.parameters.is_of_interest
    theta = displaced(model, 0.3)
    if has_structure:
        side = structure_at(model.knee, "side", [SIDE], stiffness_sd=1.0)
        model, n = model.with_effects([side, *model.effects]), model.n_ligament_parameters
        theta = np.r_[theta[:n], 2.0, 5.0, np.ones(6), theta[n:]]
        is_checked = np.arange(theta.size) >= n
    if is_measured:
        model = at_poses(model, theta)
    jacobian = model.predict(theta).jacobian
    assert jacobian is not None
    for i in np.flatnonzero(is_checked):
        move = np.zeros(theta.size)
        move[i] = 2e-4 * model.parameters.prior_sd[i]
        ends = [model.predict(theta + s * move, derivatives=False).coordinates for s in (-1, 1)]
        slope = (ends[1] - ends[0]) / (2.0 * move[i])
        size = max(float(np.abs(slope).max()), 1e-3)
        np.testing.assert_allclose(jacobian[:, :, i], slope, atol=0.02 * size)


def moved(frame: Frame, values: Array) -> Frame:
    turn = Rotation.from_rotvec(np.radians(values[:3])).as_matrix()
    return Frame(origin=frame.to_common(values[3:]), axes=turn.T @ frame.axes)


def moved_knee(model: LaxityModel, values: Array) -> Knee:
    """The knee whose own frames are the measured ones."""
    return replace(
        model.knee,
        uncertainty=Uncertainty(),
        contact_rounding_mm=MOST_ROUNDING,
        femur_frame=moved(model.knee.femur_frame, values[:6]),
        tibia_frame=moved(model.knee.tibia_frame, values[6:]),
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("is_measured", [False, True])
def test_registration_is_a_knee_whose_frames_were_moved(seed: int, is_measured: bool) -> None:
    model = uncertain(Uncertainty(registration_deg=4.0, registration_mm=4.0))
    values = 4.0 * np.random.default_rng(seed).standard_normal(12)
    theta = np.r_[model.parameters.start[:-12], values]
    other = LaxityModel(knee=moved_knee(model, values), protocol=model.protocol)
    own = other.parameters.start
    if is_measured:
        other = at_poses(other, own)
        model = replace(model, poses=other.poses)
    expected, made = other.predict(own), model.predict(theta)
    assert expected.all_converged
    # The distance of the femur is another spline in other axes.
    np.testing.assert_allclose(made.coordinates, expected.coordinates, atol=5e-4)
    forces, expected_forces = tensions_of(model, made), tensions_of(other, expected)
    np.testing.assert_allclose(forces, expected_forces, atol=2e-3)
    frames = frames_at(values)
    for bone, first in ((1, 1), (0, 4)):
        places = frames.to_measured(made.centres[..., first : first + 3], bone)
        np.testing.assert_allclose(places, expected.centres[..., first : first + 3], atol=2e-3)


def test_load_gain_scales_one_kind_of_load() -> None:
    model = uncertain(Uncertainty(load_gain=0.05))
    theta = np.array(model.parameters.start)
    theta[model.parameters.index("load_gain.internal_moment")] = 0.1
    column = model.protocol.loads[:, 0]
    larger = replace(
        model.protocol, loads=np.column_stack([1.1 * column, model.protocol.loads[:, 1:]])
    )
    made = model.predict(theta, derivatives=False).coordinates
    exact = LaxityModel(knee=exact_knee(), protocol=larger)
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
    exact = LaxityModel(knee=exact_knee(), protocol=protocol)
    expected = exact.predict(exact.parameters.start, derivatives=False).coordinates
    made = model.predict(theta, derivatives=False).coordinates
    np.testing.assert_allclose(made, expected, atol=1e-6)
