"""Effects on what is read: frames, the rig and the history of a trial."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tolerances import CLOSED_FORM

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import COORDINATES
from identknee.mechanics.pose import angles_of, rotation_matrix
from identknee.model.effects.effect import ReadingError
from identknee.model.effects.effect import TrialRecord as AsRun
from identknee.model.effects.readings import (
    creep,
    drift,
    femur_frame,
    hysteresis,
    rig_compliance,
    tibia_frame,
)
from identknee.runs.declare import Array

N = 5
LOADS = np.array(
    [
        [8.0, 0.0, 0.0, 0.0, 0.0],
        [-6.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 5.0, 0.0, 0.0, 0.0],
        [0.0, -4.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0],
    ]
)
PROTOCOL = Protocol(
    name="five",
    trials=tuple("abcde"),
    flexion_deg=np.array([0.0, 30.0, 60.0, 90.0, 10.0]),
    loads=LOADS,
)
PLAIN = AsRun(flexion_deg=PROTOCOL.flexion_deg, loads=PROTOCOL.loads)
RECORDED = AsRun(
    flexion_deg=PROTOCOL.flexion_deg,
    loads=PROTOCOL.loads,
    order=np.array([3, 1, 2, 5, 4]),
    phase=("loading", "unloading", "unloading", "loading", "loading"),
)
READ = np.random.default_rng(2).uniform(-10.0, 10.0, (N, 5))


def oblique(flexion_rotation: Array, origin: Array) -> Array:
    """Coordinates from rotation (3, 3) and origin (3,), by the axes of Grood and Suntay."""
    e1, e3 = np.array([0.0, 0.0, 1.0]), flexion_rotation[:, 1]
    e2 = np.cross(e3, e1)
    e2 /= np.linalg.norm(e2)
    shift, drawer, along = np.linalg.solve(np.column_stack([e1, e2, e3]), origin)
    _, varus, internal = angles_of(flexion_rotation)
    return np.array([shift, drawer, -along, np.degrees(varus), np.degrees(internal)])


def displacement(flexion_deg: float, coordinates: Array) -> tuple[Array, Array]:
    """Rotation and origin of the tibia in the femur, the inverse of `oblique`."""
    shift, drawer, distraction, varus, internal = coordinates
    rotation = rotation_matrix(*np.radians([flexion_deg, varus, internal]))
    e1, e3 = np.array([0.0, 0.0, 1.0]), rotation[:, 1]
    e2 = np.cross(e3, e1) / np.linalg.norm(np.cross(e3, e1))
    return rotation, shift * e1 + drawer * e2 - distraction * e3


@pytest.mark.parametrize("bone", ["femur", "tibia"])
def test_turned_frames_read_the_same_displacement_in_other_axes(bone: str) -> None:
    values = np.array([3.0, -2.0, 4.0])[: 2 if bone == "femur" else 3]
    turn = Rotation.from_rotvec(np.radians(np.resize(np.r_[values, 0.0], 3))).as_matrix()
    effect = femur_frame() if bone == "femur" else tibia_frame()
    found = effect.observe(READ, values, PLAIN)
    for flexion, actual, read in zip(PROTOCOL.flexion_deg, READ, found, strict=True):
        rotation, origin = displacement(flexion, actual)
        # The columns of `turn` are the axes that the rig has, in true axes.
        wanted = (
            oblique(turn.T @ rotation, turn.T @ origin)
            if bone == "femur"
            else oblique(rotation @ turn, origin)
        )
        np.testing.assert_allclose(read, wanted, rtol=1e-9, atol=1e-9)


def test_a_tibial_frame_turned_about_its_length_is_read_as_rotation() -> None:
    found = tibia_frame().observe(READ, np.array([0.0, 4.0, 0.0]), PLAIN)
    np.testing.assert_allclose(found[:, 4] - READ[:, 4], 4.0, rtol=CLOSED_FORM)
    np.testing.assert_allclose(found[:, :4], READ[:, :4], rtol=1e-9, atol=1e-9)


def test_a_turned_femur_reads_flexion_as_varus() -> None:
    """About its y axis it takes sin(flexion) of the turn for the other two rotations."""
    still = np.zeros((N, 5))
    found = femur_frame().observe(still, np.array([0.0, 1.0]), PLAIN)
    flexion = np.radians(PROTOCOL.flexion_deg)
    # First order in a turn of 1 deg.
    np.testing.assert_allclose(found[:, 3], np.sin(flexion), atol=0.02)
    np.testing.assert_allclose(found[:, 4], -np.cos(flexion), atol=0.02)


@pytest.mark.parametrize(("axis", "load", "angle"), [("IE", 0, 4), ("VV", 1, 3)])
def test_a_soft_rig_adds_its_own_rotation(axis: str, load: int, angle: int) -> None:
    found = rig_compliance(axis).observe(READ, np.array([0.2]), PLAIN)
    wanted = np.array(READ)
    wanted[:, angle] += 0.2 * LOADS[:, load]
    np.testing.assert_allclose(found, wanted, rtol=CLOSED_FORM)


def test_hysteresis_lags_behind_the_load() -> None:
    found = hysteresis().observe(READ, np.array([2.0, 1.0]), RECORDED) - READ
    np.testing.assert_allclose(found[:, 4], [-1.0, -1.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found[:, 3], [0.0, 0.0, 0.5, 0.5, 0.0], atol=1e-12)
    np.testing.assert_array_equal(found[:, :3], 0.0)


def test_creep_grows_with_the_logarithm_of_what_was_done() -> None:
    found = creep().observe(READ, np.array([1.0, 0.5]), RECORDED) - READ
    np.testing.assert_allclose(found[:, 4], [0.8 * np.log(3.0), 0.0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(
        found[:, 3], [0, 0, 0.25 * np.log(2.0), -0.2 * np.log(5.0), 0], atol=1e-12
    )


def test_drift_is_straight_in_order_and_zero_halfway() -> None:
    values = np.array([1.0, -2.0, 0.0, 0.5, 4.0])
    found = drift().observe(READ, values, RECORDED) - READ
    shares = np.array([0.0, -0.5, -0.25, 0.5, 0.25])
    np.testing.assert_allclose(found, np.outer(shares, values), atol=1e-12)
    assert [x.removeprefix("drift.") for x in drift().parameters.names] == list(COORDINATES)


def test_one_trial_does_not_drift() -> None:
    one = AsRun(
        flexion_deg=np.zeros(1),
        loads=LOADS[:1],
        order=np.array([7]),
    )
    found = drift().observe(READ[:1], np.ones(5), one) - READ[:1]
    np.testing.assert_allclose(found, -0.5)


@pytest.mark.parametrize(
    ("effect", "missing"),
    [
        (hysteresis(), "add a column phase"),
        (creep(), "add a column order"),
        (drift(), "add a column order"),
    ],
    ids=["hysteresis", "creep", "drift"],
)
def test_an_unknown_history_is_refused(effect: ReadingError, missing: str) -> None:
    with pytest.raises(ValueError, match=f"{effect.name}.*{missing}"):
        effect.observe(READ, np.zeros(effect.parameters.n), PLAIN)
