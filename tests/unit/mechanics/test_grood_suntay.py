"""Joint coordinates against the axes they are defined by."""

import numpy as np
import pytest
from energy_evaluation import central_difference
from tolerances import CLOSED_FORM

from identknee.mechanics.pose import (
    coordinate_jacobian,
    coordinates_from_pose,
    pose_from_coordinates,
    rotation_matrix,
)
from identknee.runs.declare import Array

# Central differences with a step of 1e-6 of functions that are smooth and of size 100.
DIFFERENCE = 1e-7


def _poses(n: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return rng.uniform([-0.3, -0.8, -15, -50, -15], [0.3, 0.8, 15, 10, 15], (n, 5))


@pytest.mark.parametrize("flexion", [0.0, 0.7, 1.9])
def test_the_three_translations_add_up_to_the_tibial_origin(flexion: float) -> None:
    for pose in _poses(5, seed=1):
        shift, drawer, distraction, varus_deg, internal_deg = coordinates_from_pose(pose)
        rotation = rotation_matrix(flexion, pose[0], pose[1])
        lateral, superior = np.array([0.0, 0.0, 1.0]), rotation[:, 1]
        floating = np.cross(superior, lateral) / np.linalg.norm(np.cross(superior, lateral))
        origin = rotation_matrix(flexion, 0.0, 0.0) @ pose[2:]
        found = shift * lateral + drawer * floating - distraction * superior
        assert found == pytest.approx(origin, abs=1e-12 * 100)
        assert np.radians([varus_deg, internal_deg]) == pytest.approx(pose[:2], rel=CLOSED_FORM)


def test_poses_come_back() -> None:
    poses = _poses(20, seed=2).reshape(4, 5, 5)
    there = coordinates_from_pose(poses)
    assert there.shape == (4, 5, 5)
    assert pose_from_coordinates(there) == pytest.approx(poses, abs=1e-12 * 100)


def test_the_jacobian_is_the_slope() -> None:
    for pose in _poses(5, seed=3):
        expected = [central_difference(coordinates_from_pose, pose, k, 1e-6) for k in range(5)]
        found = coordinate_jacobian(pose)
        assert found == pytest.approx(np.transpose(expected), rel=DIFFERENCE, abs=1e-6)
    assert coordinate_jacobian(_poses(6, seed=4)).shape == (6, 5, 5)
