"""The paper's contact law against closed forms, brute force and recorded numbers."""

import numpy as np
import pytest
import trimesh

from identknee.mechanics.distance_field import PRESSURE_MODULUS
from identknee.mechanics.mesh_contact import (
    DEEPEST,
    Convention,
    MeshContact,
    Sheet,
    mesh_contact,
    penetrations,
)
from identknee.mechanics.pose import place
from identknee.runs.declare import Array, IntArray
from identknee.subject.folder import example

# Closed forms are sums of some hundred terms, each rounded once or twice.
CLOSED_FORM = 1e-12
# A central difference with a step of 1e-6 mm or rad of a function that is smooth there.
DIFFERENCE = 1e-6
# The recorded numbers are rounded to 1 N.
RECORDED_N = 0.5


def _grid(half: float, edge: float, shift: float = 0.0) -> tuple[Array, IntArray]:
    """A flat square sheet in the x-z plane, normals up; `shift` moves it along x and z."""
    ticks = np.arange(-half, half + 0.5 * edge, edge)
    n = len(ticks)
    x, z = np.meshgrid(ticks + shift, ticks + shift, indexing="ij")
    vertices = np.stack([x.ravel(), np.zeros(n * n), z.ravel()], axis=1)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    corner = (i * n + j).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + n + 1], axis=1),
            np.stack([corner, corner + n + 1, corner + n], axis=1),
        ]
    )
    return vertices, faces


def _dome(radius: float, height: float, half: float, edge: float) -> tuple[Array, IntArray]:
    """A paraboloid that rises to `height`, normals up."""
    vertices, faces = _grid(half, edge, shift=0.137 * edge)
    vertices[:, 1] = height - (vertices[:, 0] ** 2 + vertices[:, 2] ** 2) / (2.0 * radius)
    return vertices, faces


def _ceiling(half: float, edge: float) -> tuple[Array, IntArray]:
    """A flat sheet in the x-z plane, normals down, like a femur's."""
    vertices, faces = _grid(half, edge)
    return vertices, faces[:, ::-1]


def _plane_and_dome(convention: Convention) -> MeshContact:
    return mesh_contact(
        _ceiling(12.0, 1.0), [_dome(30.0, 0.8, 9.0, 0.6), _dome(20.0, -1.0, 4.0, 1.0)], convention
    )


def test_dome_under_a_plane_bears_the_closed_sum() -> None:
    contact = _plane_and_dome("tibia")
    wrench = contact.wrench(place(0.0, np.zeros(5)))
    vertices = contact.tibia[0].vertices
    depth = np.maximum(vertices[:, 1], 0.0)
    # Every triangle of the plane has half a square millimetre.
    sizes = PRESSURE_MODULUS * 0.5 * depth
    assert wrench.compartments == pytest.approx([sizes.sum(), 0.0], rel=CLOSED_FORM)
    assert wrench.n_touching == np.count_nonzero(depth)
    # The plane pushes down (-y), so the moment about x is -(z F_y) and y does no work in turning.
    expected = [sizes @ vertices[:, 2], 0.0, 0.0, -sizes.sum(), 0.0]
    assert wrench.force == pytest.approx(expected, rel=CLOSED_FORM, abs=CLOSED_FORM * sizes.sum())


def test_both_ways_is_the_sum_of_the_two() -> None:
    placement = place(0.1, np.array([0.02, -0.03, 0.4, 0.2, -0.3]))
    one, other, both = (
        _plane_and_dome(convention).wrench(placement) for convention in ("tibia", "femur", "both")
    )
    assert one.n_touching > 0
    assert other.n_touching > 0
    assert both.n_touching == one.n_touching + other.n_touching
    assert both.force == pytest.approx(one.force + other.force, rel=CLOSED_FORM)
    assert both.stiffness == pytest.approx(one.stiffness + other.stiffness, rel=CLOSED_FORM)


def test_both_ways_at_equal_edges_gives_the_integral() -> None:
    radius, height = 30.0, 0.8
    contact = mesh_contact(_ceiling(12.0, 0.25), [_dome(radius, height, 9.0, 0.25)], "both")
    integral = PRESSURE_MODULUS * np.pi * radius * height**2
    total = contact.wrench(place(0.0, np.zeros(5))).compartments.sum()
    # First-order in the edge: the sloping dome's normals and areas differ from the plane's by 4 %.
    assert total == pytest.approx(integral, rel=0.02)


@pytest.mark.parametrize("convention", ["tibia", "femur"])
def test_force_on_the_tibia_is_the_slope_of_the_frozen_energy(convention: Convention) -> None:
    contact = _plane_and_dome(convention)
    pose = np.array([0.011, -0.023, 0.041, 0.053, -0.031])

    def energy(moved: Array) -> float:
        placement = place(0.2, moved)
        return sum(
            0.5 * PRESSURE_MODULUS * float(areas @ depths**2)
            for sheet in contact.tibia
            for _, _, areas, depths in contact._touching(sheet, placement)
        )

    # All triangles of the plane have one area and normal, so for "tibia" the law has an energy;
    # those of the dome differ, and only a pose between two jumps may be differenced.
    wrench = contact.wrench(place(0.2, pose))
    step = 1e-6
    slope = [(energy(pose + step * e) - energy(pose - step * e)) / (2 * step) for e in np.eye(5)]
    assert wrench.force == pytest.approx(-np.array(slope), rel=DIFFERENCE, abs=1e-4)


def test_stiffness_of_a_translation_is_the_slope_of_the_force() -> None:
    contact = _plane_and_dome("tibia")
    pose = np.array([0.011, -0.023, 0.041, 0.053, -0.031])
    step = 1e-6
    stiffness = contact.wrench(place(0.2, pose)).stiffness
    for k in (2, 3, 4):
        move = step * np.eye(5)[k]
        change = (
            contact.wrench(place(0.2, pose + move)).force
            - contact.wrench(place(0.2, pose - move)).force
        )
        assert stiffness[k, 2:] == pytest.approx(-change[2:] / (2 * step), rel=DIFFERENCE, abs=1e-4)


def test_a_flexed_and_moved_pair_bears_the_same_load() -> None:
    still = _plane_and_dome("both")
    turned = place(0.7, np.array([0.2, -0.4, 5.0, -3.0, 2.0]))
    tibia = [(turned.to_tibia(sheet.vertices), sheet.faces) for sheet in still.tibia]
    moved = mesh_contact((still.femur.vertices, still.femur.faces), tibia, "both")
    expected = still.wrench(place(0.0, np.zeros(5)))
    found = moved.wrench(turned)
    assert found.n_touching == expected.n_touching
    assert found.compartments == pytest.approx(expected.compartments, rel=1e-10)


def _brute_force(points: Array, sheet: Sheet) -> dict[int, float]:
    """Depth of every point inside, by looking at all triangles for each."""
    corners = sheet.vertices[sheet.faces]
    edges = np.sort(sheet.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = sheet.vertices[unique[count == 1]]
    inside = {}
    for index, point in enumerate(points):
        repeated = np.tile(point, (len(corners), 1))
        places = trimesh.triangles.closest_point(corners, repeated)  # type: ignore[no-untyped-call]
        away = np.linalg.norm(places - point, axis=1)
        height = np.einsum("ij,ij->i", point - places, sheet.normals)
        tied = np.flatnonzero(away < away.min() + 1e-6)
        chosen = tied[np.argmax(np.abs(height[tied]))]
        along, reach = rim[:, 1] - rim[:, 0], places[chosen] - rim[:, 0]
        share = np.clip((reach * along).sum(1) / (along**2).sum(1), 0.0, 1.0)[:, None]
        on_rim = np.linalg.norm(reach - share * along, axis=1).min() < 1e-6
        if height[chosen] < 0.0 and away[chosen] < DEEPEST and not on_rim:
            inside[index] = -height[chosen]
    return inside


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_penetrations_agree_with_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = _dome(15.0, 1.0, 8.0, 1.3)
    vertices = vertices + 0.3 * rng.standard_normal(vertices.shape)
    sheet = Sheet(vertices=vertices, faces=faces)
    points = rng.uniform([-12.0, -9.0, -12.0], [12.0, 7.0, 12.0], size=(600, 3))
    found = penetrations(points, sheet)
    expected = _brute_force(points, sheet)
    assert len(expected) > 50
    assert dict(zip(found.point.tolist(), found.depth, strict=True)) == pytest.approx(expected)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_near_keeps_every_vertex_that_may_touch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    femur = Sheet(vertices=_ceiling(12.0, 1.0)[0], faces=_ceiling(12.0, 1.0)[1])
    dome = _dome(20.0, 0.0, 8.0, 0.7)
    tibia = Sheet(vertices=dome[0], faces=dome[1])
    placement = place(rng.uniform(0, 1), np.array([*rng.normal(0, 0.3, 2), *rng.normal(0, 4, 3)]))
    near = tibia.near(femur, placement.rotation, placement.translation)
    every = penetrations(placement.to_femur(tibia.vertices), femur)
    assert set(every.point.tolist()) <= set(near.tolist())


def test_a_vertex_deep_inside_without_crossing_triangles_counts() -> None:
    """The dome is wholly inside: no triangles intersect, yet every vertex is in contact."""
    contact = mesh_contact(_ceiling(12.0, 1.0), [_dome(100.0, 2.0, 3.0, 1.0)], "tibia")
    assert contact.wrench(place(0.0, np.zeros(5))).n_touching == len(contact.tibia[0].vertices)


def test_past_the_rim_and_too_deep_do_not_count() -> None:
    vertices, faces = _grid(2.0, 1.0)
    sheet = Sheet(vertices=vertices, faces=faces)
    points = np.array(
        [
            [0.3, -1.0, 0.2],
            [2.5, -1.0, 0.2],
            [0.3, 1.0, 0.2],
            [0.3, -DEEPEST - 0.1, 0.2],
            [2.1, -0.01, 2.1],
            [0.0, -0.5, 0.0],
        ]
    )
    found = penetrations(points, sheet)
    assert found.point.tolist() == [0, 5]
    assert found.depth == pytest.approx([1.0, 0.5], rel=CLOSED_FORM)


def test_apart_there_is_no_force() -> None:
    wrench = _plane_and_dome("both").wrench(place(0.0, np.array([0.0, 0.0, 0.0, -50.0, 0.0])))
    assert wrench.n_touching == 0
    assert not wrench.force.any()
    assert not wrench.stiffness.any()


def test_mistakes_are_named() -> None:
    good = _plane_and_dome("both")
    with pytest.raises(ValueError, match=r"convention.*tibia.*femur.*both"):
        MeshContact(femur=good.femur, tibia=good.tibia, convention="all")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="pressure_modulus"):
        MeshContact(femur=good.femur, tibia=good.tibia, pressure_modulus=0.0)
    vertices, faces = _grid(2.0, 1.0)
    faces[3] = faces[3, [0, 0, 1]]
    with pytest.raises(ValueError, match="triangle 3 of 32"):
        Sheet(vertices=vertices, faces=faces)


@pytest.mark.parametrize(
    ("convention", "medial", "lateral"), [("tibia", 104.0, 56.0), ("femur", 115.0, 59.0)]
)
def test_lenhart2015_at_the_reference_pose(
    convention: Convention, medial: float, lateral: float
) -> None:
    knee = example("lenhart2015")
    femur, *tibia = ((x.vertices, x.faces) for x in (knee.femur, *knee.tibia))
    contact = mesh_contact(femur, tibia, convention)
    wrench = contact.wrench(place(0.0, np.zeros(5)))
    assert wrench.compartments == pytest.approx([medial, lateral], abs=RECORDED_N)
