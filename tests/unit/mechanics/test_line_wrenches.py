"""Wrenches of lines: forces of known lines, work, and slopes against differences."""

import numpy as np
import pytest

from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.ligament_tensions import ligament_tensions, line_wrenches, twists_by_pose
from identknee.mechanics.pose import angles_of, place, rotation_matrix
from identknee.runs.declare import Array

GENERATOR = np.random.default_rng(3)
M = 4
LINES = LineLigaments(
    femoral=GENERATOR.normal(scale=15.0, size=(M, 3)),
    tibial=GENERATOR.normal(scale=15.0, size=(M, 3)) - [0.0, 30.0, 0.0],
    reference_length=GENERATOR.uniform(20.0, 28.0, M),
    transition=np.array([0.03, 0.03, 0.05, -1.0]),
    wrap_offset=np.array([0.0, 3.0, -2.0, 0.0]),
    wrap_place=np.array([0.5, 0.3, 0.6, 0.5]),
)
LAWS = GENERATOR.uniform(3e3, 9e3, M), GENERATOR.uniform(0.0, 0.05, M)
FLEXION = np.radians([10.0, 70.0])
POSES = np.column_stack([GENERATOR.normal(scale=0.1, size=(2, 2)), GENERATOR.normal(size=(2, 3))])


def test_a_line_pulls_its_tibial_insertion_towards_the_femoral_one() -> None:
    line = LineLigaments(
        femoral=np.array([[0.0, 10.0, 0.0]]), tibial=np.array([[5.0, -2.0, 0.0]]),
        reference_length=np.array([10.0]),
    )  # fmt: skip
    pose = np.array([[0.0, 0.0, -5.0, 0.0, 0.0]])
    found = line_wrenches(line, np.zeros(1), pose, np.array([1000.0]), np.zeros(1))
    # 12 mm at rest 10 mm: strain 0.2, less the toe of 0.03.
    np.testing.assert_allclose(found.values[0, 0], [0.0, 170.0, 0.0, 0.0, 0.0, 0.85], atol=1e-12)


def test_it_does_the_work_that_stretches_the_line() -> None:
    found = line_wrenches(LINES, FLEXION, POSES, *LAWS)
    pulled = ligament_tensions(LINES, FLEXION, POSES, *LAWS)
    work = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3]) * found.values
    by_pose = np.einsum("nmi,nij->nmj", work, twists_by_pose(POSES))
    expected = -pulled.tensions[..., None] * pulled.lengthening
    np.testing.assert_allclose(by_pose, expected, rtol=1e-10, atol=1e-8)


def test_slopes_are_those_of_differences() -> None:
    found = line_wrenches(LINES, FLEXION, POSES, *LAWS)
    by_pose = np.einsum("nmij,njk->nmik", found.by_twist, twists_by_pose(POSES))
    for k in range(5):
        move = 1e-6 * np.eye(5)[k]
        ends = [line_wrenches(LINES, FLEXION, POSES + s * move, *LAWS).values for s in (-1, 1)]
        slope = (ends[1] - ends[0]) / 2e-6
        np.testing.assert_allclose(by_pose[..., k], slope, atol=1e-6 * np.abs(slope).max())
    for i, (size, made) in enumerate(((1e-2, found.by_stiffness), (1e-7, found.by_strain))):
        ends = []
        for s in (-1, 1):
            laws = [*LAWS]
            laws[i] = laws[i] + s * size
            ends.append(line_wrenches(LINES, FLEXION, POSES, *laws).values)
        slope = (ends[1] - ends[0]) / (2.0 * size)
        np.testing.assert_allclose(made, slope, atol=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize("k", range(6))
def test_a_twist_is_a_motion_of_the_tibia_along_its_axes(k: int) -> None:
    """Also about its long axis and in flexion, which no coordinate of a pose is."""
    found = line_wrenches(LINES, FLEXION, POSES, *LAWS)
    step = 1e-6
    ends = [line_wrenches(LINES, *_moved(s * step, k), *LAWS).values for s in (-1, 1)]
    slope = (ends[1] - ends[0]) / (2.0 * step)
    np.testing.assert_allclose(found.by_twist[..., k], slope, atol=1e-6 * np.abs(slope).max())


def _moved(step: float, k: int) -> tuple[Array, Array]:
    """Flexion and pose after a twist by `step` along or about axis k of the tibia."""
    flexions, poses = [], []
    for flexion, pose in zip(FLEXION, POSES, strict=True):
        placed = place(float(flexion), pose)
        turn, shift = np.eye(3), np.zeros(3)
        if k < 3:
            shift[k] = step
        else:
            turn = rotation_matrix(*(-step * np.eye(3)[0] if k == 5 else step * np.eye(3)[k - 2]))
        angles = angles_of(placed.rotation @ turn)
        flexions.append(float(angles[0]))
        place_of_origin = placed.translation + placed.rotation @ shift
        turned = rotation_matrix(flexions[-1], 0.0, 0.0).T @ place_of_origin
        poses.append([*map(float, angles[1:]), *turned])
    return np.array(flexions), np.array(poses)
