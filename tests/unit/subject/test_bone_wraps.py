"""Ligaments over the surface of a bone, against a bone that is a cylinder."""

from dataclasses import replace

import numpy as np
import pytest

import identknee as ik
from identknee.subject.bone_wraps import with_wraps
from identknee.subject.knee import Knee
from identknee.subject.ligament import Obstacle, circle_through, way_over
from identknee.subject.surface import Surface

RADIUS, CENTRE = 14.0, np.array([0.0, -30.0, -22.0])


def tube(radius: float, n: int = 180, half: float = 40.0) -> Surface:
    """A cylinder along x, its normals outwards."""
    angles = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    circle = np.column_stack([np.zeros(n), radius * np.cos(angles), radius * np.sin(angles)])
    vertices = np.vstack([circle + CENTRE - [half, 0, 0], circle + CENTRE + [half, 0, 0]])
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    faces = np.vstack([np.column_stack([i, j, n + j]), np.column_stack([i, n + j, n + i])])
    outwards = np.cross(
        vertices[faces[0, 1]] - vertices[faces[0, 0]], vertices[faces[0, 2]] - vertices[faces[0, 0]]
    ) @ (vertices[faces[0, 0]] - CENTRE - [-half, 0, 0])
    return Surface(vertices=vertices, faces=faces if outwards > 0.0 else faces[:, ::-1])


def knee_with_bones() -> Knee:
    far = tube(5.0)
    femur = Surface(vertices=far.vertices + np.array([0.0, 100.0, 0.0]), faces=far.faces)
    return replace(ik.reference_knee(), bones=(femur, tube(RADIUS)))


def test_a_line_through_a_cylindrical_bone_gets_that_cylinder() -> None:
    knee = knee_with_bones()
    found = with_wraps(knee, ["MCL", "LCL"])
    mcl = found.ligament("MCL")
    assert mcl.wrap is not None
    assert mcl.wrap.bone == "tibia"
    # The line runs askew over the cylinder along x: across its own plane the section is nearly it.
    exact = Obstacle(
        bone="tibia", centre=CENTRE, radius_mm=RADIUS, axis=np.array([1.0, 0.0, 0.0]),
        side=np.array([0.0, 0.0, -1.0]),
    )  # fmt: skip
    straight = knee.ligament("MCL").length
    wanted = exact.length_of_way(mcl.femur, mcl.tibia)
    assert wanted > straight + 0.1
    assert mcl.length == pytest.approx(wanted, abs=0.02 * (wanted - straight) + 0.02)
    # The lateral line passes the bone.
    assert found.ligament("LCL").wrap is None


def test_the_mcl_of_the_measured_knee_runs_over_the_medial_tibia() -> None:
    knee = ik.example("s192803")
    found = with_wraps(knee, ["MCL"])
    wrap = found.ligament("MCL").wrap
    assert wrap is not None
    assert wrap.side is not None
    assert wrap.bone == "tibia"
    medial = -(knee.tibia_frame.axes @ wrap.side)[2]
    assert medial > 0.9
    longer = found.ligament("MCL").length - knee.ligament("MCL").length
    assert 0.05 < longer < 1.0
    # Others stay as they are.
    assert all(x.wrap is None for x in found.ligaments if x.name != "MCL")


def test_what_cannot_wrap_is_refused() -> None:
    with pytest.raises(ValueError, match="no surfaces"):
        with_wraps(ik.reference_knee(), ["MCL"])
    with pytest.raises(ValueError, match="called XCL"):
        with_wraps(knee_with_bones(), ["XCL"])


def test_a_way_over_a_circle_has_the_circle() -> None:
    angles = np.linspace(0.0, np.pi, 2001)
    circle = np.array([20.0, -3.0]) + 8.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    length, touching = way_over(circle[circle[:, 1] > 0.0], 40.0)
    far = np.hypot(20.0, 3.0)
    arc = np.pi - 2.0 * np.arccos(8.0 / far) - 2.0 * np.arctan2(3.0, 20.0)
    assert length == pytest.approx(2.0 * np.sqrt(far**2 - 64.0) + 8.0 * arc, abs=1e-4)
    middle, radius = circle_through(touching[[0, len(touching) // 2, -1]])
    np.testing.assert_allclose([*middle, radius], [20.0, -3.0, 8.0], atol=1e-9)
