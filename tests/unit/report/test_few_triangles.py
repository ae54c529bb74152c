"""Surfaces of few triangles: how many, how true, and turned which way."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from identknee.report.page.viewer import few_triangles
from identknee.subject.knee import Knee
from identknee.subject.surface import Surface

OFF = 0.2  # mm; a patch of 11 mm2 on a condyle of 20 mm bulges by a twentieth of a millimetre
AREA = 0.02  # of the surface; its rim is cut straight between places 3 mm apart
ALIKE = 0.9  # of the cosine between a triangle and the surface it stands for


def test_surface_is_kept_with_few_triangles(reference: Knee) -> None:
    whole = reference.femur
    mesh = few_triangles(whole, 700)
    assert 650 <= len(mesh.vertices) <= 700
    assert 1200 <= len(mesh.faces) <= 1400
    distance, _ = cKDTree(whole.vertices).query(mesh.vertices)
    assert distance.max() < OFF + np.sqrt(whole.areas.max())
    drawn = Surface(vertices=mesh.vertices, faces=mesh.faces)
    assert drawn.areas.sum() == pytest.approx(whole.areas.sum(), rel=AREA)


def test_triangles_face_the_way_the_surface_does(reference: Knee) -> None:
    whole = reference.femur
    mesh = few_triangles(whole, 700)
    drawn = Surface(vertices=mesh.vertices, faces=mesh.faces)
    centres = drawn.vertices[drawn.faces].mean(axis=1)
    nearest = cKDTree(whole.vertices[whole.faces].mean(axis=1)).query(centres)[1]
    cosines = np.einsum("ij,ij->i", drawn.normals, whole.normals[nearest])
    assert np.quantile(cosines, 0.05) > ALIKE


def test_small_surface_is_only_rounded(reference: Knee) -> None:
    plateau = reference.tibia[0]
    mesh = few_triangles(plateau, len(plateau.vertices))
    assert np.array_equal(mesh.faces, plateau.faces)
    assert np.abs(mesh.vertices - plateau.vertices).max() <= 0.005 + 1e-9


def test_vertex_of_no_triangle_does_no_harm() -> None:
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), [0.0]), axis=-1).reshape(-1, 3)
    corner = np.array([9 * i + j for i in range(8) for j in range(8)])
    faces = np.concatenate(
        [corner[:, None] + np.array([0, 1, 9]), corner[:, None] + np.array([1, 10, 9])]
    )
    stray = np.append(grid, [[4.0, 4.0, 90.0]], axis=0)
    mesh = few_triangles(Surface(vertices=stray, faces=faces), 20)
    used = np.unique(mesh.faces)
    assert np.isfinite(mesh.vertices).all()
    assert np.abs(mesh.vertices[used, 2]).max() < OFF


def test_vertices_at_the_ends_may_have_most_of_the_area() -> None:
    """Two large triangles beside many small ones, whichever the tree orders last."""
    strip = np.array([[0.1 * (i // 2), 0.1 * (i % 2), 0.0] for i in range(40)])
    small = np.array([[i, i + 1, i + 2] for i in range(38)])
    ends = np.array(
        [[x + dx, dy, 0.0] for x in (-200, 200) for dx, dy in ((0, 0), (50, 0), (0, 50))]
    )
    large = np.array([[40, 41, 42], [43, 44, 45]])
    whole = Surface(vertices=np.vstack([strip, ends]), faces=np.vstack([small, large]))
    mesh = few_triangles(whole, 45)
    assert 0 < len(mesh.vertices) <= 45
