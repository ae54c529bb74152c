import numpy as np
import pytest

from identknee.mechanics.closest_point import mesh_distance
from identknee.subject import check as sheets
from identknee.subject.knee import Knee
from identknee.subject.surface import Surface, joined

SQUARE = Surface(
    vertices=np.array([[0, 0, 0], [0, 0, 3], [4, 0, 3], [4, 0, 0]], float),
    faces=np.array([[0, 1, 2], [0, 2, 3]]),
)


def test_a_sound_sheet() -> None:
    assert sheets.count_inconsistent_edges(SQUARE) == 0
    assert sheets.count_shared_edges(SQUARE) == 0
    assert sheets.count_near_duplicates(SQUARE, 1e-3) == 0
    assert sheets.count_slivers(SQUARE, 1e-3) == 0
    assert sheets.extent(SQUARE) == 5.0


def test_turned_triangle() -> None:
    turned = Surface(vertices=SQUARE.vertices, faces=np.array([[0, 1, 2], [0, 3, 2]]))
    assert sheets.count_inconsistent_edges(turned) == 1


def test_third_triangle_at_an_edge() -> None:
    vertices = np.vstack([SQUARE.vertices, [[2.0, 5.0, 1.0]]])
    fin = Surface(vertices=vertices, faces=np.vstack([SQUARE.faces, [[0, 2, 4]]]))
    assert sheets.count_shared_edges(fin) == 1


def test_near_duplicates_and_slivers() -> None:
    close = joined(SQUARE, SQUARE.moved(np.eye(3), [0.0, 1e-4, 0.0]))
    assert sheets.count_near_duplicates(close, 1e-3) == 4
    thin = Surface(
        vertices=np.array([[0, 0, 0], [4, 0, 0], [2, 1e-4, 0]], float), faces=np.array([[0, 1, 2]])
    )
    assert sheets.count_slivers(thin, 1e-3) == 1


def test_gap_and_facing_normals() -> None:
    above = Surface(vertices=SQUARE.vertices, faces=SQUARE.faces[:, ::-1])
    above = above.moved(np.eye(3), [0.3, 2.5, 0.1])
    assert sheets.gap_between(above, SQUARE) == pytest.approx(2.5, abs=1e-9)
    np.testing.assert_allclose(sheets.facing_normals(above, SQUARE), [0.0, -1.0, 0.0])
    assert sheets.gap_between(above.moved(np.eye(3), [0, -2.5, 0]), SQUARE) == 0.0


def test_part_of_a_fine_surface_faces_as_all_of_it(
    reference: Knee, monkeypatch: pytest.MonkeyPatch
) -> None:
    pairs = [(reference.femur, x) for x in reference.tibia]
    pairs += [(x, reference.femur) for x in reference.tibia]
    part = [sheets.facing_normals(*x) for x in pairs]
    monkeypatch.setattr(sheets, "LOOKED_AT", 10**6)
    whole = [sheets.facing_normals(*x) for x in pairs]
    np.testing.assert_allclose(part, whole, atol=0.05)


def test_overlap_equals_the_closed_form(reference: Knee) -> None:
    assert reference.femur_distance is not None
    femur = mesh_distance(reference.femur.vertices, reference.femur.faces)
    for plateau in reference.tibia:
        exact = -reference.femur_distance(plateau.vertices).min()
        # The femur's faces lie up to 0.008 mm inside its surface.
        assert sheets.overlap_of(plateau, femur) == pytest.approx(exact, abs=0.01)
    away = reference.tibia[0].moved(np.eye(3), [0.0, -30.0, 0.0])
    assert sheets.overlap_of(away, femur) == 0.0
    assert sheets.gap_between(away, reference.femur) > 20.0
