"""Placements against differences and closed forms."""

import numpy as np
import pytest

from identknee.mechanics.pose import place
from identknee.runs.declare import Array

FLEXION = 0.6
POSE = np.array([0.2, -0.35, 1.5, -2.5, 3.5])
POINTS = np.array([[4.0, -20.0, 7.0], [-3.0, 11.0, -40.0]])
# Central differences of smooth functions, step 1e-5, lengths of about 40 mm.
DIFFERENCE = 1e-8


def test_angles_turn_the_way_the_conventions_say() -> None:
    flexed = place(np.pi / 2, np.zeros(5)).to_femur(np.array([[0.0, -1.0, 0.0]]))
    # The shank of a flexed knee points backward.
    assert flexed == pytest.approx(np.array([[-1.0, 0.0, 0.0]]), abs=1e-15)
    internal = place(0.0, np.array([0.0, 0.1, 0.0, 0.0, 0.0])).to_femur(np.array([[1.0, 0.0, 0.0]]))
    # The toes of a right leg turned inward point medially, toward -z.
    assert internal[0, 2] < 0.0
    varus = place(0.0, np.array([0.1, 0.0, 0.0, 0.0, 0.0])).to_femur(np.array([[0.0, -1.0, 0.0]]))
    assert varus[0, 2] < 0.0


def test_jacobian_is_the_slope_of_the_position() -> None:
    step = 1e-5
    for k, move in enumerate(step * np.eye(5)):
        slope = (
            place(FLEXION, POSE + move).to_femur(POINTS)
            - place(FLEXION, POSE - move).to_femur(POINTS)
        ) / (2 * step)
        assert place(FLEXION, POSE).jacobian(POINTS)[:, k] == pytest.approx(slope, abs=DIFFERENCE)


def test_bending_is_the_slope_of_the_jacobian() -> None:
    step = 1e-5
    forces = np.array([[1.0, -2.0, 0.5], [0.3, 0.7, -1.1]])

    def work(pose: Array) -> Array:
        total: Array = np.einsum("nai,ni->a", place(FLEXION, pose).jacobian(POINTS), forces)
        return total

    bending = place(FLEXION, POSE).bending(POINTS, forces)
    for k, move in enumerate(step * np.eye(5)):
        slope = (work(POSE + move) - work(POSE - move)) / (2 * step)
        assert bending[k] == pytest.approx(slope, abs=DIFFERENCE * 10)


def test_there_and_back() -> None:
    placement = place(FLEXION, POSE)
    assert placement.to_tibia(placement.to_femur(POINTS)) == pytest.approx(POINTS, rel=1e-13)
