"""Effects of the rig against what is written down here: sign, unit, size and place of each.

Nothing here comes from the model that the blind data test: a generator and a library that are wrong
alike would agree with one another.
"""

import numpy as np
import pytest
from blind_scene import FLEXION_DEG, IS_UNLOADING, LOADS, ORDER, drawn, experiment, numbers
from scipy.spatial.transform import Rotation
from tolerances import CLOSED_FORM

from identknee.blind import energy
from identknee.blind.experiment import _read
from identknee.runs.declare import Array

VARUS, INTERNAL, ANTERIOR, DISTRACTION, LATERAL = range(5)
VARUS_DEG, INTERNAL_DEG = 3, 4
# Moments in N mm as the experiment has them, from the N·m of the protocol.
INTERNAL_NMM, VARUS_NMM = 1000.0 * LOADS[:, 0], 1000.0 * LOADS[:, 1]
SEEDS = range(4)


def load_change(name: str, amplitude: float, seed: int = 3) -> tuple[Array, Array]:
    """What an effect adds to the loads of the trials and to the unloaded state."""
    changed, before = drawn(name, seed).apply(experiment(), amplitude), experiment()
    return changed.loads - before.loads, changed.preload - before.preload


def reading_change(name: str, amplitude: float, seed: int = 3) -> Array:
    return drawn(name, seed).apply(experiment(), amplitude).added


def test_compression_pushes_the_bones_together_in_every_state() -> None:
    """80 N less distraction, with and without a stated load."""
    loads, preload = load_change("compression", 80.0)
    np.testing.assert_allclose(preload, [0.0, 0.0, 0.0, -80.0, 0.0])
    np.testing.assert_allclose(loads, np.tile(preload, (5, 1)))
    assert numbers(drawn("compression"), 80.0) == {"force_N": 80.0}
    assert drawn("compression").sign == 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_gravity_hangs_on_the_shank_and_does_work_as_it_falls(seed: int) -> None:
    """A shank that sinks or swings back by 1 mm gives off its weight times 1 mm."""
    hidden = drawn("shank_gravity", seed)
    heavy, told = hidden.apply(experiment(), 30.0), numbers(hidden, 30.0)
    assert told["posterior_N"] >= 0.0
    assert told["distal_N"] >= 0.0
    assert np.linalg.norm(list(told.values())) == pytest.approx(30.0)
    np.testing.assert_allclose(heavy.weights[0, :3], [-told["posterior_N"], -told["distal_N"], 0.0])
    # In the middle of the shank, 18 cm below the knee.
    np.testing.assert_allclose(heavy.weights[0, 3:], [0.0, -180.0, 0.0])
    R, t = heavy.start
    held = _energy(heavy.arrays(), R, t)
    for way, force in ((np.array([-1.0, 0.0, 0.0]), "posterior_N"), (-np.eye(3)[1], "distal_N")):
        light = _energy(experiment().arrays(), R, t + way) - _energy(experiment().arrays(), R, t)
        fallen = _energy(heavy.arrays(), R, t + way) - held
        assert light - fallen == pytest.approx(told[force], abs=1e-6)


def _energy(arrays: tuple[object, ...], R: Array, t: Array) -> float:
    nothing = np.empty(0, np.int64)
    return float(energy.energy_of(R, t, np.zeros(5), arrays, nothing, np.empty(5), nothing)[0])


@pytest.mark.parametrize(("axis", "column"), [("IE", INTERNAL), ("VV", VARUS)])
def test_a_gain_is_a_share_of_the_stated_moment(axis: str, column: int) -> None:
    loads, preload = load_change(f"moment_gain_{axis}", 0.1)
    wanted = np.zeros((5, 5))
    wanted[:, column] = 0.1 * (INTERNAL_NMM if axis == "IE" else VARUS_NMM)
    np.testing.assert_allclose(loads, wanted, atol=1e-9)
    assert not preload.any()
    assert {drawn(f"moment_gain_{axis}", x).sign for x in range(12)} == {-1.0, 1.0}


@pytest.mark.parametrize("seed", SEEDS)
def test_an_offset_is_a_moment_in_newton_metres(seed: int) -> None:
    loads, preload = load_change("moment_offset", 0.5, seed)
    told = numbers(drawn("moment_offset", seed), 0.5)
    assert np.linalg.norm(list(told.values())) == pytest.approx(0.5)
    wanted = [1000.0 * told["VV_Nm"], 1000.0 * told["IE_Nm"], 0.0, 0.0, 0.0]
    np.testing.assert_allclose(preload, wanted)
    np.testing.assert_allclose(loads, np.tile(wanted, (5, 1)), atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_misaligned_axis_turns_part_of_a_moment_into_the_other(seed: int) -> None:
    """A moment M about an axis at a small angle a has M sin(a) about the one beside it."""
    loads, _ = load_change("axis_misalignment", 6.0, seed)
    told = numbers(drawn("axis_misalignment", seed), 6.0)
    assert np.linalg.norm(list(told.values())) == pytest.approx(6.0)
    internal = np.sin(np.radians(told["VV_to_IE_deg"])) * VARUS_NMM
    varus = np.sin(np.radians(told["IE_to_VV_deg"])) * INTERNAL_NMM
    np.testing.assert_allclose(loads[:, INTERNAL], internal, atol=1e-9)
    np.testing.assert_allclose(loads[:, VARUS], varus, atol=1e-9)
    assert not loads[:, ANTERIOR:].any()


@pytest.mark.parametrize("seed", SEEDS)
def test_shear_is_in_newton_for_each_newton_metre(seed: int) -> None:
    """At 10 N·m and 1 N/N·m a force of 10 N, not of 100 N."""
    loads, _ = load_change("parasitic_shear", 2.0, seed)
    told = numbers(drawn("parasitic_shear", seed), 2.0)
    assert np.linalg.norm(list(told.values())) == pytest.approx(2.0)
    for column, towards in ((ANTERIOR, "x"), (LATERAL, "z")):
        force = told[f"IE_{towards}_N_per_Nm"] * LOADS[:, 0]
        force = force + told[f"VV_{towards}_N_per_Nm"] * LOADS[:, 1]
        np.testing.assert_allclose(loads[:, column], force, atol=1e-9)
    assert not loads[:, [VARUS, INTERNAL, DISTRACTION]].any()


def test_an_offset_of_flexion_is_in_degrees() -> None:
    found = drawn("flexion_offset").apply(experiment(), 4.0)
    assert np.degrees(found.flexion_offset) == pytest.approx(4.0)
    assert {drawn("flexion_offset", x).sign for x in range(12)} == {-1.0, 1.0}


@pytest.mark.parametrize(
    ("axis", "column", "moment"), [("IE", INTERNAL_DEG, 0), ("VV", VARUS_DEG, 1)]
)
def test_a_soft_rig_turns_with_the_moment(axis: str, column: int, moment: int) -> None:
    found = reading_change(f"rig_compliance_{axis}", 0.2)
    wanted = np.zeros((5, 5))
    wanted[:, column] = 0.2 * LOADS[:, moment]
    np.testing.assert_allclose(found, wanted)


def test_readings_lag_behind_a_growing_load_and_run_ahead_of_a_falling_one() -> None:
    """Half the loop's width, against the load while it grows; varus has 0.4 of the width."""
    found = reading_change("hysteresis", 2.0)
    internal = [-1.0, -1.0, 0.0, 0.0, 0.0]  # 8 N·m growing, -6 N·m coming down
    varus = [0.0, 0.0, 0.4, 0.4, 0.0]  # 5 N·m coming down, -4 N·m growing
    np.testing.assert_allclose(found[:, INTERNAL_DEG], internal)
    np.testing.assert_allclose(found[:, VARUS_DEG], varus)
    assert not found[:, :3].any()
    assert numbers(drawn("hysteresis"), 2.0) == pytest.approx({"IE_deg": 2.0, "VV_deg": 0.8})
    assert IS_UNLOADING.tolist() == [False, True, True, False, False]


def test_creep_turns_further_with_the_load_in_every_later_trial() -> None:
    """At 10 N·m the amplitude for each e-fold of trials made; varus has 0.4 of it."""
    found = reading_change("creep", 1.5)
    internal = 1.5 * np.log(ORDER) * LOADS[:, 0] / 10.0
    np.testing.assert_allclose(found[:, INTERNAL_DEG], internal)
    np.testing.assert_allclose(found[:, VARUS_DEG], 0.6 * np.log(ORDER) * LOADS[:, 1] / 10.0)
    assert found[0, INTERNAL_DEG] > 0.0 > found[3, VARUS_DEG]
    assert numbers(drawn("creep"), 1.5) == pytest.approx({"IE_deg": 1.5, "VV_deg": 0.6})


def test_drift_goes_from_minus_half_to_half_over_the_series() -> None:
    found = reading_change("drift", 2.0)
    told = numbers(drawn("drift"), 2.0)
    names = ("lateral_shift_mm", "anterior_drawer_mm", "distraction_mm", "varus_deg")
    ends = np.array([told[x] for x in (*names, "internal_deg")])
    assert np.linalg.norm(ends) == pytest.approx(2.0)
    np.testing.assert_allclose(found[1], -0.5 * ends)  # made first
    np.testing.assert_allclose(found[3], 0.5 * ends)  # made last
    np.testing.assert_allclose(found[0], 0.0, atol=1e-12)  # made in the middle


# --- frames -------------------------------------------------------------------------------------


def pose(flexion_deg: float, coordinates: Array) -> tuple[Array, Array]:
    """Rotation and origin of the tibia of given coordinates, by the axes of Grood and Suntay."""
    shift, drawer, distraction, varus, internal = coordinates
    turn = Rotation.from_euler("ZXY", [-flexion_deg, varus, internal], degrees=True).as_matrix()
    e1, e3 = np.array([0.0, 0.0, 1.0]), turn[:, 1]
    e2 = np.cross(e3, e1) / np.linalg.norm(np.cross(e3, e1))
    return turn, shift * e1 + drawer * e2 - distraction * e3


def coordinates_of(turn: Array, origin: Array) -> Array:
    """The inverse of `pose`."""
    _, varus, internal = Rotation.from_matrix(turn).as_euler("ZXY", degrees=True)
    e1, e3 = np.array([0.0, 0.0, 1.0]), turn[:, 1]
    e2 = np.cross(e3, e1) / np.linalg.norm(np.cross(e3, e1))
    shift, drawer, along = np.linalg.solve(np.column_stack([e1, e2, e3]), origin)
    return np.array([shift, drawer, -along, varus, internal])


ACTUAL = np.random.default_rng(2).uniform(-8.0, 8.0, (5, 5))


@pytest.mark.parametrize("bone", ["femur", "tibia"])
def test_a_turned_frame_reads_the_same_pose_in_the_axes_that_it_has(bone: str) -> None:
    hidden = drawn(f"{bone}_frame")
    turned = hidden.apply(experiment(), 5.0)
    told = numbers(hidden, 5.0)
    vector = np.array([told[f"{x}_deg"] for x in "xyz"])
    assert np.linalg.norm(vector) == pytest.approx(5.0)
    # The columns are the axes that the rig takes for the bone's.
    axes = Rotation.from_rotvec(vector, degrees=True).as_matrix()
    poses = [pose(x, y) for x, y in zip(FLEXION_DEG, ACTUAL, strict=True)]
    read = _read(turned, list(poses))
    for (turn, origin), found in zip(poses, read, strict=True):
        if bone == "femur":
            wanted = coordinates_of(axes.T @ turn, axes.T @ origin)
        else:
            wanted = coordinates_of(turn @ axes, origin)
        np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_frames_as_they_are_read_the_pose_as_it_is() -> None:
    poses = [pose(x, y) for x, y in zip(FLEXION_DEG, ACTUAL, strict=True)]
    np.testing.assert_allclose(_read(experiment(), list(poses)), ACTUAL, atol=1e-9)


def test_readings_too_large_are_added_to_what_is_read() -> None:
    poses = [pose(x, y) for x, y in zip(FLEXION_DEG, ACTUAL, strict=True)]
    soft = drawn("rig_compliance_IE").apply(experiment(), 0.3)
    change = _read(soft, list(poses)) - ACTUAL
    np.testing.assert_allclose(change[:, INTERNAL_DEG], 0.3 * LOADS[:, 0], atol=1e-9)
    assert np.abs(change[:, :INTERNAL_DEG]).max() < 1e3 * CLOSED_FORM


@pytest.mark.parametrize("seed", SEEDS)
def test_muscles_pull_and_their_parts_make_up_the_amplitude(seed: int) -> None:
    hidden = drawn("muscle_tension", seed)
    told, tense = numbers(hidden, 80.0), hidden.apply(experiment(), 80.0)
    assert set(told) == {"quadriceps_N", "hamstrings_N", "gastrocnemius_N"}
    assert min(told.values()) >= 0.0
    assert np.linalg.norm(list(told.values())) == pytest.approx(80.0)
    # The hamstrings, two thirds of them medial, towards the hip.
    np.testing.assert_allclose(
        np.linalg.norm(tense.weights[:, :3], axis=1).sum(), told["hamstrings_N"]
    )
    assert (tense.weights[:, 1] >= 0.0).all()
    assert tense.weights[0, 5] < 0.0 < tense.weights[1, 5]
    # The others press the bones together, the quadriceps pulling forward less as the knee bends.
    change = tense.loads - experiment().loads
    assert (change[:, DISTRACTION] < 0.0).all()
    order = np.argsort(FLEXION_DEG, kind="stable")
    assert (np.diff(change[order, ANTERIOR]) <= CLOSED_FORM).all()
    np.testing.assert_allclose(change[:, LATERAL], 0.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_constant_pull_goes_to_one_side(seed: int) -> None:
    pulled = drawn("constant_pull", seed).apply(experiment(), 25.0)
    assert np.linalg.norm(pulled.weights[0, :3]) == pytest.approx(25.0)
    assert abs(pulled.weights[0, 2]) >= 0.6 * 25.0
    np.testing.assert_array_equal(pulled.loads, experiment().loads)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_rig_that_gives_way_one_way_reads_right_the_other_way(seed: int) -> None:
    read = reading_change("one_way_yield", 0.2, seed)
    moved = read[:, INTERNAL_DEG] != 0.0
    assert len(set(np.sign(LOADS[moved, 0]))) <= 1
    np.testing.assert_allclose(read[moved, INTERNAL_DEG], 0.2 * LOADS[moved, 0])
    np.testing.assert_array_equal(np.delete(read, INTERNAL_DEG, axis=1), 0.0)
