"""Line ligaments against closed forms and differences."""

import numpy as np
import pytest

from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.ligament_tensions import ligament_wrench, line_tensions
from identknee.mechanics.pose import place

FEMORAL = np.array([[0.0, 5.0, -10.0], [3.0, -4.0, 12.0], [1.0, 8.0, 40.0]])
TIBIAL = np.array([[10.0, -20.0, 2.0], [-15.0, -25.0, 0.0], [-9.0, -45.0, 44.0]])
LINES = LineLigaments(
    femoral=FEMORAL, tibial=TIBIAL, reference_length=np.linalg.norm(FEMORAL - TIBIAL, axis=1)
)
STIFFNESS = np.array([10000.0, 18000.0, 6000.0])
STRAIN = np.array([0.08, 0.02, -0.3])
POSE = np.array([0.02, -0.03, 0.2, -0.3, 0.1])


def test_tension_follows_equation_3() -> None:
    strain = np.array([-0.1, 0.0, 0.02, 0.06, 0.09])
    tension, slope = line_tensions(strain, np.full(5, 2000.0))
    assert tension == pytest.approx([0.0, 0.0, 2000 * 0.02**2 / 0.12, 60.0, 120.0], rel=1e-14)
    assert slope == pytest.approx([0.0, 0.0, 2000 * 0.02 / 0.06, 2000.0, 2000.0], rel=1e-14)


def test_reference_pose_strains_to_the_reference_strain() -> None:
    wrench = ligament_wrench(place(0.0, np.zeros(5)), LINES, STIFFNESS, STRAIN)
    expected = [10000 * 0.05, 18000 * 0.02**2 / 0.12, 0.0]
    assert wrench.tensions == pytest.approx(expected, rel=1e-12)


def test_one_vertical_line_pulls_up() -> None:
    lines = LineLigaments(
        femoral=np.array([[0.0, 10.0, 0.0]]),
        tibial=np.array([[0.0, -10.0, 0.0]]),
        reference_length=np.array([20.0]),
    )
    wrench = ligament_wrench(place(0.0, np.zeros(5)), lines, np.array([1000.0]), np.array([0.1]))
    assert wrench.force == pytest.approx([0.0, 0.0, 0.0, 70.0, 0.0], rel=1e-12)
    assert wrench.stiffness[3, 3] == pytest.approx(1000.0 / (20.0 / 1.1), rel=1e-12)
    assert wrench.stiffness[2, 2] == pytest.approx(70.0 / 20.0, rel=1e-12)


def test_stiffness_is_the_slope_of_the_force() -> None:
    step = 1e-6
    stiffness = ligament_wrench(place(0.4, POSE), LINES, STIFFNESS, STRAIN).stiffness
    for k, move in enumerate(step * np.eye(5)):
        ahead = ligament_wrench(place(0.4, POSE + move), LINES, STIFFNESS, STRAIN).force
        behind = ligament_wrench(place(0.4, POSE - move), LINES, STIFFNESS, STRAIN).force
        # Forces of 1e5 N mm lose ten digits of sixteen to the step.
        expected = -(ahead - behind) / (2 * step)
        assert stiffness[k] == pytest.approx(expected, rel=1e-6, abs=1e-2)
