"""Rotations and their angles."""

import numpy as np
import pytest
from tolerances import CLOSED_FORM

from identknee.mechanics.pose import angles_of, rotation_matrix, start_pose


def test_each_angle_turns_about_its_axis() -> None:
    quarter = np.pi / 2
    # Flexion takes the tibia's y forward to x; varus y to z; internal rotation z to x.
    assert rotation_matrix(quarter, 0, 0) @ [0, 1, 0] == pytest.approx([1, 0, 0], abs=CLOSED_FORM)
    assert rotation_matrix(0, quarter, 0) @ [0, 1, 0] == pytest.approx([0, 0, 1], abs=CLOSED_FORM)
    assert rotation_matrix(0, 0, quarter) @ [0, 0, 1] == pytest.approx([1, 0, 0], abs=CLOSED_FORM)


@pytest.mark.parametrize("seed", range(5))
def test_angles_come_back_and_rotations_are_orthonormal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = rng.uniform([-0.2, -0.6, -1.2], [2.8, 0.6, 1.2])
    rotation = rotation_matrix(*angles)
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=CLOSED_FORM)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=CLOSED_FORM)
    assert angles_of(rotation) == pytest.approx(angles, abs=CLOSED_FORM)


def test_a_start_pose_places_the_tibia_where_it_was() -> None:
    angles, origin = (0.4, -0.1, 0.25), np.array([3.0, -40.0, 2.0])
    flexion, pose = start_pose(rotation_matrix(*angles), origin)
    assert flexion == pytest.approx(0.4, abs=CLOSED_FORM)
    assert pose[:2] == pytest.approx([-0.1, 0.25], abs=CLOSED_FORM)
    assert rotation_matrix(flexion, 0, 0) @ pose[2:] == pytest.approx(origin, abs=1e-12)


def test_rounding_beyond_a_right_angle_is_no_error() -> None:
    rotation = rotation_matrix(0.0, np.pi / 2, 0.0)
    rotation[2, 1] = 1.0 + 1e-15
    assert angles_of(rotation)[1] == pytest.approx(np.pi / 2)
