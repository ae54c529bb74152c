"""Distance from a rim, on a flat square where it is known."""

import numpy as np
import pytest
import trimesh

from identknee.mechanics.rims import rim_of
from identknee.runs.arrays import Array, IntArray

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


def test_the_rim_of_a_square_is_its_outline() -> None:
    rim = rim_of(*_square()).vertices
    assert len(rim) == 4 * 2 * HALF / EDGE
    assert np.abs(rim).max(axis=1) == pytest.approx(HALF)


def test_distance_is_to_the_nearest_place_of_the_outline() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-9, 0, -9], [9, 0, 9], (500, 3))
    exact = HALF - np.abs(points[:, [0, 2]]).max(axis=1)
    found = rim_of(*_square()).distance(points)
    # The nearest vertex lies at most half an edge along the outline.
    assert (found >= exact - 1e-12).all()
    assert (found <= np.hypot(exact, EDGE / 2) + 1e-12).all()


def test_a_closed_surface_has_no_rim() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=5.0)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces)
    assert np.isinf(rim_of(vertices, faces).distance(vertices)).all()
