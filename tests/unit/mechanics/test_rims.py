"""Distance from a rim, on a flat square where it is known."""

import numpy as np
import pytest
import trimesh

from identknee.mechanics.rims import PADDING, SPACING, map_rims, rim_distance
from identknee.runs.arrays import Array, IntArray

HALF, EDGE = 10.0, 0.5
# The place looked up lies up to half a cell's diagonal off, its nearest vertex half an edge's.
LOOK_UP = 0.5 * np.sqrt(3.0) * SPACING + 0.5 * np.sqrt(2.0) * EDGE


def _square() -> tuple[Array, IntArray]:
    ticks = np.arange(-HALF, HALF + EDGE / 2, EDGE)
    n = len(ticks)
    x, z = np.meshgrid(ticks, ticks, indexing="ij")
    vertices = np.stack([x.ravel(), np.zeros(n * n), z.ravel()], axis=1)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    faces = np.r_[np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)]
    return vertices, faces


def _from_edge(points: Array) -> Array:
    return np.asarray(HALF - np.abs(points[:, [0, 2]]).max(axis=1))


def test_vertices_know_their_distance_to_the_rim() -> None:
    vertices, faces = _square()
    assert rim_distance(vertices, faces) == pytest.approx(_from_edge(vertices), abs=1e-12)


def test_places_near_the_sheet_are_looked_up() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-9, -2, -9], [9, 2, 9], (500, 3))
    found = map_rims(*_square()).at(points)
    assert np.abs(found - _from_edge(points)).max() <= LOOK_UP


def test_far_from_the_sheet_is_past_the_rim() -> None:
    far = np.array([[0.0, PADDING + 2.0, 0.0], [HALF + PADDING + 2.0, 0.0, 0.0]])
    rims = map_rims(*_square())
    assert rims.at(far).tolist() == [0.0, 0.0]
    # Beside the sheet, the nearest vertex is on the rim.
    assert rims.at(np.array([[HALF + 2.0, 0.0, 0.0]])).tolist() == [0.0]


def test_a_closed_surface_has_no_rim() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=5.0)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces)
    assert np.isinf(rim_distance(vertices, faces)).all()
    assert np.isinf(map_rims(vertices, faces).at(vertices)).all()
