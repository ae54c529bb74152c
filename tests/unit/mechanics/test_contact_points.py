"""Contact points: whole areas, kept vertices, centroids of even patches."""

import numpy as np
import pytest
from tolerances import CLOSED_FORM

from identknee.mechanics.contact_points import contact_points, triangle_areas
from identknee.mechanics.equilibria import ContactPoints
from identknee.subject.knee import Knee

# Sums of a few thousand areas.
SUM = 1e-11


def _of(knee: Knee, number: int | None) -> ContactPoints:
    return contact_points([(x.vertices, x.faces) for x in knee.tibia], number)


@pytest.mark.parametrize("number", [None, 2000, 1500, 700, 60])
def test_areas_add_up_to_the_surfaces(reference: Knee, number: int | None) -> None:
    found = _of(reference, number)
    for c, surface in enumerate(reference.tibia):
        area = found.areas[found.compartment == c].sum()
        assert area == pytest.approx(surface.areas.sum(), rel=SUM)
    assert (found.areas > 0.0).all()


@pytest.mark.parametrize("number", [None, 1500])
def test_few_enough_vertices_are_kept(reference: Knee, number: int | None) -> None:
    found = _of(reference, number)
    vertices = np.concatenate([x.vertices for x in reference.tibia])
    np.testing.assert_array_equal(found.points, vertices)
    expected = np.concatenate([x.vertex_areas for x in reference.tibia])
    assert found.areas == pytest.approx(expected, rel=CLOSED_FORM)


def test_patches_keep_the_first_moment(reference: Knee) -> None:
    """Each is the centroid of its patch, so together they have the surface's centroid."""
    found = _of(reference, 300)
    for c, surface in enumerate(reference.tibia):
        mine = found.compartment == c
        centre = found.areas[mine] @ found.points[mine] / found.areas[mine].sum()
        assert centre == pytest.approx(surface.centroid, abs=SUM * 100)


def test_patches_are_as_many_as_wanted_and_even(reference: Knee) -> None:
    found = _of(reference, 300)
    assert len(found.points) == pytest.approx(300, abs=3)
    share = found.areas * 300 / found.areas.sum()
    # Lloyd's patches differ by their place on the rim; none is a sliver or twice the others.
    assert share.min() > 0.4
    assert share.max() < 1.8
    counts = np.bincount(found.compartment)
    areas = np.array([x.areas.sum() for x in reference.tibia])
    assert counts / counts.sum() == pytest.approx(areas / areas.sum(), abs=0.01)


def test_patches_lie_near_the_surface(reference: Knee) -> None:
    """A centroid of a curved patch lies off it by the patch's sagitta: here 3 mm across, R 20."""
    found = _of(reference, 300)
    for c, surface in enumerate(reference.tibia):
        points = found.points[found.compartment == c]
        nearest = np.linalg.norm(points[:, None] - surface.vertices[None], axis=2).min(axis=1)
        assert nearest.max() < 1.2


def test_clusters_are_the_same_every_time(reference: Knee) -> None:
    np.testing.assert_array_equal(_of(reference, 200).points, _of(reference, 200).points)


def test_one_triangle_can_be_cut_into_patches() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, 4.0]])
    sheets = [(corners, np.array([[0, 2, 1]]))] * 2
    found = contact_points(sheets, 4)
    assert len(found.points) == 4
    assert found.areas.sum() == pytest.approx(16.0, rel=SUM)
    assert found.points[:, 1] == pytest.approx(np.zeros(4), abs=CLOSED_FORM)


def test_areas_of_triangles() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    assert triangle_areas(vertices, np.array([[0, 1, 2]])) == pytest.approx([6.0])
