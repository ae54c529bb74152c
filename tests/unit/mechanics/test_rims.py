"""Distance from a rim, on a flat square where it is known."""

import numpy as np
import pytest
import trimesh

from identknee.mechanics.contact_points import rim_distance
from identknee.runs import triangles
from identknee.runs.declare import Array, IntArray

HALF, EDGE = 10.0, 0.5


def _square() -> tuple[Array, IntArray]:
    ticks = np.arange(-HALF, HALF + EDGE / 2, EDGE)
    n = len(ticks)
    x, z = np.meshgrid(ticks, ticks, indexing="ij")
    vertices = np.stack([x.ravel(), np.zeros(n * n), z.ravel()], axis=1)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    faces = np.r_[np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)]
    return vertices, faces


def test_vertices_know_their_distance_from_the_outline() -> None:
    vertices, faces = _square()
    exact = HALF - np.abs(vertices[:, [0, 2]]).max(axis=1)
    assert rim_distance(vertices, faces).distances == pytest.approx(exact, abs=1e-12)


def test_a_place_has_the_distance_of_the_nearest_vertex() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform([-9, -2, -9], [9, 2, 9], (500, 3))
    exact = HALF - np.abs(places[:, [0, 2]]).max(axis=1)
    found = rim_distance(*_square()).at(places)
    # The nearest vertex lies at most half an edge's diagonal away along the sheet.
    assert np.abs(found - exact).max() <= np.sqrt(0.5) * EDGE


def test_few_places_are_looked_up_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sheet with more vertices than are looked at together gives the same."""
    places = np.random.default_rng(1).uniform([-9, -2, -9], [9, 2, 9], (50, 3))
    sheet = rim_distance(*_square())
    whole = sheet.at(places)
    monkeypatch.setattr(triangles, "AT_ONCE", 100)
    assert len(sheet.vertices) > 10 * triangles.AT_ONCE
    np.testing.assert_array_equal(sheet.at(places), whole)


def test_a_place_beside_the_sheet_is_on_the_rim() -> None:
    beside = np.array([[HALF + 5.0, 0.0, 0.0], [0.0, 3.0, -HALF - 4.0]])
    assert rim_distance(*_square()).at(beside).tolist() == [0.0, 0.0]


def test_a_closed_surface_has_no_rim() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=5.0)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces)
    assert np.isinf(rim_distance(vertices, faces).at(vertices)).all()
