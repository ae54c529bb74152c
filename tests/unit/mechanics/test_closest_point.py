"""Signed distances against trimesh, and past a rim against the rule."""

from typing import Any

import numpy as np
import pytest
import trimesh
from tolerances import SAME_POSE

from identknee.mechanics.closest_point import LEAF_SIZE, _build_tree, mesh_distance
from identknee.mechanics.closest_triangle import disc_distance, write_discs
from identknee.runs.declare import Array, IntArray
from identknee.subject.reference import reference_knee

# The way past a rim is the root of a difference: a rounding of 1e-16 becomes 1e-8.
ROOT = 1e-7


def _far_from_rim(mesh: trimesh.Trimesh, points: Array) -> tuple[Array, Array]:
    """Distance by trimesh, and whether the closest point lies off the rim."""
    query: Any = trimesh.proximity.closest_point
    closest, distance, _ = query(mesh, points)
    edges, count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    rim = mesh.vertices[edges[count == 1]]
    if len(rim) == 0:
        return distance, np.ones(len(points), bool)
    a, b = rim[:, 0], rim[:, 1] - rim[:, 0]
    share = np.einsum("nrk,rk->nr", closest[:, None] - a, b) / (b**2).sum(axis=1)
    foot = a + np.clip(share, 0.0, 1.0)[..., None] * b
    from_rim = np.linalg.norm(closest[:, None] - foot, axis=2).min(axis=1)
    return distance, from_rim > 1e-6


@pytest.fixture(scope="module")
def sheet() -> trimesh.Trimesh:
    femur = reference_knee(edge_mm=4.0, femur_edge_mm=4.0).femur
    return trimesh.Trimesh(femur.vertices, femur.faces, process=False)


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    round_one = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    return trimesh.Trimesh(round_one.vertices * [1.0, 1.4, 0.8], round_one.faces)


def _distance(mesh: trimesh.Trimesh, points: Array) -> Array:
    return mesh_distance(np.array(mesh.vertices), np.array(mesh.faces))(points)


def test_distance_to_an_open_sheet_is_trimeshs(sheet: trimesh.Trimesh) -> None:
    rng = np.random.default_rng(0)
    lower, upper = sheet.bounds
    points = rng.uniform(lower - 6.0, upper + 6.0, (300, 3))
    expected, off_rim = _far_from_rim(sheet, points)
    assert off_rim.sum() > 100
    found = np.abs(_distance(sheet, points))
    assert found[off_rim] == pytest.approx(expected[off_rim], abs=SAME_POSE)


def test_a_sheets_outer_side_is_positive(sheet: trimesh.Trimesh) -> None:
    middle, normal = sheet.triangles_center, sheet.face_normals
    for offset in (-0.3, -1e-6, 1e-6, 0.3):
        found = _distance(sheet, middle + offset * normal)
        _, off_rim = _far_from_rim(sheet, middle + offset * normal)
        # A flat face's own side of a curved sheet: the closest face may be another one.
        assert (np.sign(found[off_rim]) == np.sign(offset)).all()
        assert (np.abs(found[off_rim]) <= abs(offset) + SAME_POSE).all()


def test_inside_of_a_closed_surface_is_negative(ball: trimesh.Trimesh) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-14.0, 14.0, (400, 3))
    query: Any = trimesh.proximity.signed_distance
    expected = -query(ball, points)
    assert (expected < 0.0).sum() > 50
    assert _distance(ball, points) == pytest.approx(expected, abs=SAME_POSE)


def test_the_sign_holds_beside_sharp_edges_and_corners() -> None:
    """Closest features of a box seen from outside are mostly edges and corners."""
    box = trimesh.creation.box((4.0, 6.0, 8.0))
    points = np.random.default_rng(2).uniform(-9.0, 9.0, (500, 3))
    beyond = np.abs(points) - [2.0, 3.0, 4.0]
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    expected = np.where(outside > 0.0, outside, beyond.max(axis=1))
    assert _distance(box, points) == pytest.approx(expected, abs=SAME_POSE)


def _square(half: float) -> tuple[Array, IntArray]:
    corners = np.array([[-half, 0, -half], [half, 0, -half], [half, 0, half], [-half, 0, half]])
    return corners, np.array([[0, 2, 1], [0, 3, 2]])


def test_past_a_rim_the_sheet_goes_on_as_its_tangent_plane() -> None:
    """The way past the rim is added to the height over the plane."""
    distance = mesh_distance(*_square(5.0))
    rng = np.random.default_rng(3)
    points = rng.uniform([-9, -3, -9], [9, 3, 9], (500, 3))
    past = np.maximum(np.abs(points[:, [0, 2]]) - 5.0, 0.0)
    expected = points[:, 1] + np.linalg.norm(past, axis=1)
    assert distance(points) == pytest.approx(expected, abs=ROOT)


def test_a_point_that_leaves_sideways_loses_contact_within_its_depth() -> None:
    distance = mesh_distance(*_square(5.0))
    depth = 0.4
    along = np.array([[5.0 + x, -depth, 0.0] for x in (-0.1, 0.0, 0.39, 0.41)])
    assert (distance(along) < 0.0).tolist() == [True, True, True, False]
    assert distance(along)[1] == pytest.approx(-depth, abs=ROOT)


def test_the_order_of_the_points_does_not_matter(sheet: trimesh.Trimesh) -> None:
    """The last point's triangle is where the search for the next begins."""
    points = np.random.default_rng(4).uniform(-30.0, 30.0, (200, 3))
    there = _distance(sheet, points)
    back = _distance(sheet, points[::-1])[::-1]
    # Ties between features of one distance may fall either way on a rim, nowhere else.
    _, off_rim = _far_from_rim(sheet, points)
    np.testing.assert_array_equal(there[off_rim], back[off_rim])


@pytest.mark.parametrize("n", [1, 4, 5, 37, 100])
def test_a_tree_holds_every_triangle_once_in_boxes_within_boxes(n: int) -> None:
    corners = np.random.default_rng(n).standard_normal((n, 3, 3))
    order, boxes, spans = _build_tree(corners)
    assert sorted(order.tolist()) == list(range(n))
    leaves: list[int] = []
    for here, (first, end, right) in enumerate(spans.tolist()):
        inside = corners[order[first:end]].reshape(-1, 3)
        np.testing.assert_array_equal(boxes[here], [inside.min(axis=0), inside.max(axis=0)])
        if right < 0:
            assert 0 < end - first <= LEAF_SIZE
            leaves += range(first, end)
            continue
        middle = spans[here + 1, 1]
        assert (spans[here + 1, 0], spans[right, 0], spans[right, 1]) == (first, middle, end)
    assert leaves == list(range(n))


def _disc_distances(points: Array, disc: Array) -> Array:
    return np.sqrt([disc_distance(*x, disc) for x in points])


def test_a_disc_holds_its_triangles_and_is_thin(sheet: trimesh.Trimesh) -> None:
    """A point is no nearer a node's triangles than its disc, and nodes of a sheet are flat."""
    corners = np.array(sheet.triangles)
    order, _, spans = _build_tree(corners)
    discs = np.empty((len(spans), 8))
    normals = np.ascontiguousarray(sheet.face_normals[order])
    write_discs(np.ascontiguousarray(corners[order]), normals, spans, discs)
    points = np.random.default_rng(5).uniform(-60.0, 60.0, (20, 3))
    for disc, (first, end, _) in zip(discs, spans.tolist(), strict=True):
        own = corners[order[first:end]].reshape(-1, 3)
        assert (_disc_distances(own, disc) == 0.0).all()
        away = np.linalg.norm(points[:, None] - own, axis=2).min(axis=1)
        assert (_disc_distances(points, disc) <= away).all()
    leaves = discs[spans[:, 2] < 0]
    assert np.median(leaves[:, 6] / leaves[:, 7]) < 0.15
    # A disc is no ball: above its middle it is as far away as its own plane.
    flat = leaves[0]
    above = flat[:3] + 10.0 * flat[3:6]
    assert disc_distance(*above, flat) == pytest.approx((10.0 - flat[6]) ** 2)
