"""Triangles worked on in parts, against all at once."""

import numpy as np
import pytest

from identknee.runs import triangles
from identknee.runs.triangles import blocks, doubled_areas, lengths, longest_sides, side_names


def test_blocks_hold_every_row_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(triangles, "AT_ONCE", 3)
    assert [np.arange(7)[x].tolist() for x in blocks(7)] == [[0, 1, 2], [3, 4, 5], [6]]
    assert not list(blocks(0))


def test_sides_areas_and_normals_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 12], [3, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 1, 4]])
    monkeypatch.setattr(triangles, "AT_ONCE", 3)
    assert longest_sides(vertices, faces).tolist() == [5.0, 160.0**0.5, 153.0**0.5, 3.0]
    found = doubled_areas(vertices, faces)
    assert found.tolist() == [[0, 0, 12], [48, 0, 0], [0, 36, 0], [0, 0, 0]]
    assert lengths(found).tolist() == [12.0, 48.0, 36.0, 0.0]


def test_a_side_has_one_number_whichever_way_it_is_passed() -> None:
    named = side_names(np.array([[0, 1, 2], [2, 1, 3]]), 4)
    assert named[0, 1] == named[1, 0] == 1 * 4 + 2
    assert len(np.unique(named)) == 5
