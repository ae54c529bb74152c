import struct
from pathlib import Path

import numpy as np
import pytest

from identknee.runs.errors import InputError
from identknee.subject.surface import Surface, joined, read_surface, write_surface

SINGLE = 1e-6  # relative rounding of the single precision that STL has
SQUARE = Surface(
    vertices=np.array([[0, 0, 0], [0, 0, 2], [2, 0, 2], [2, 0, 0]], float),
    faces=np.array([[0, 1, 2], [0, 2, 3]]),
)
TEXT_STL = """solid one
facet normal 0 1 0
 outer loop
  vertex 0 0 0
  vertex 0 0 2
  vertex 2 -0 2
 endloop
endfacet
facet normal 0 1 0
 outer loop
  vertex 0 0 0
  vertex 2 0 2
  vertex 2 0 0
 endloop
endfacet
endsolid one
"""


def test_derived_geometry() -> None:
    assert SQUARE.areas.tolist() == [2.0, 2.0]
    assert SQUARE.normals.tolist() == [[0.0, 1.0, 0.0]] * 2
    np.testing.assert_allclose(SQUARE.vertex_areas, [4 / 3, 2 / 3, 4 / 3, 2 / 3])
    assert len(SQUARE.boundary_edges) == 4
    assert not SQUARE.is_closed
    assert SQUARE.centroid.tolist() == [1.0, 0.0, 1.0]
    assert not SQUARE.vertices.flags.writeable
    assert not SQUARE.normals.flags.writeable


def test_triangle_without_area_has_no_normal() -> None:
    flat = Surface(vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]]))
    assert flat.normals.tolist() == [[0.0, 0.0, 0.0]]


def test_tetrahedron_is_closed() -> None:
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert Surface(vertices=np.vstack([np.zeros(3), np.eye(3)]), faces=faces).is_closed


@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        ([[0, 0, np.nan], [0, 0, 1], [1, 0, 0]], [[0, 1, 2]], "finite"),
        ([[0, 0, 0], [0, 0, 1], [1, 0, 0]], [[0, 1, 3]], "0 to 3"),
        ([[0, 0, 0], [0, 0, 1], [1, 0, 0]], np.zeros((0, 3)), "m > 0"),
    ],
)
def test_refuses(vertices: object, faces: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Surface(vertices=np.array(vertices, float), faces=np.array(faces, int))


def test_copies() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = SQUARE.moved(turn, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(moved.vertices[1], [1.0, 2.0, 5.0])
    np.testing.assert_allclose(moved.normals[0], [-1.0, 0.0, 0.0], atol=SINGLE)
    assert SQUARE.scaled(3.0).areas.sum() == 36.0
    mirrored = SQUARE.mirrored()
    assert mirrored.vertices[1].tolist() == [0.0, 0.0, -2.0]
    assert mirrored.normals.tolist() == SQUARE.normals.tolist()
    np.testing.assert_array_equal(mirrored.mirrored().faces, SQUARE.faces)


def test_joined_surfaces_stay_apart() -> None:
    both = joined(SQUARE, SQUARE.scaled(2.0))
    assert both.faces.max() == 7
    assert both.areas.sum() == 20.0
    assert len(both.boundary_edges) == 8


def test_text_stl_is_merged(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_text(TEXT_STL)
    surface = read_surface(path)
    assert surface.vertices.shape == (4, 3)
    assert surface.vertices[0].tolist() == [0.0, 0.0, 0.0]
    assert len(surface.boundary_edges) == 4


@pytest.mark.parametrize("ending", ["ply", "obj"])
def test_double_precision_survives(tmp_path: Path, ending: str) -> None:
    generator = np.random.default_rng(0)
    surface = Surface(vertices=generator.normal(size=(30, 3)), faces=np.arange(30).reshape(10, 3))
    back = read_surface(write_surface(surface, tmp_path / f"a.{ending}"))
    np.testing.assert_array_equal(back.vertices, surface.vertices)
    np.testing.assert_array_equal(back.faces, surface.faces)


def test_a_ply_file_is_as_small_as_its_numbers_allow(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    short = generator.normal(size=(30, 3)).astype(np.float32)
    for vertices, n_bytes in ((short, 4), (short.astype(float) + 1e-12, 8)):
        surface = Surface(vertices=np.array(vertices, float), faces=np.arange(30).reshape(10, 3))
        path = write_surface(surface, tmp_path / "a.ply")
        _, _, body = path.read_bytes().partition(b"end_header\n")
        assert len(body) == 30 * 3 * n_bytes + 10 * 13
        np.testing.assert_array_equal(read_surface(path).vertices, surface.vertices)


def test_binary_stl_keeps_single_precision(tmp_path: Path) -> None:
    surface = SQUARE.moved(np.eye(3), [0.1, 0.2, 0.3])
    back = read_surface(write_surface(surface, tmp_path / "a.STL"))
    np.testing.assert_allclose(
        back.vertices[back.faces], surface.vertices[surface.faces], rtol=SINGLE
    )


def test_text_ply_and_quads(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n0 0 2\n2 0 2\n2 0 0\n4 0 1 2 3\n"
    )
    assert read_surface(path).areas.sum() == 4.0


def test_vertices_of_no_triangle_are_dropped(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("v 9 9 9\nv 0 0 0\nv 0 0 1\nv 1 0 0\nv 0 0 0\nv 1 1 0\nf 2 3 4\nf 5 4 6\n")
    surface = read_surface(path)
    assert surface.vertices.tolist() == [[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 1, 0]]
    assert surface.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert surface.repairs.unused == 1


NAN_STL = (
    bytes(80)
    + struct.pack("<I", 1)
    + struct.pack("<12fH", 0, 1, 0, 0, 0, 0, 0, 0, 1, float("nan"), 0, 0, 0)
)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.stl", b"", "the file is empty"),
        ("a.stl", b"this is a letter, not a mesh", "a.stl"),
        ("a.stl", bytes(80) + struct.pack("<I", 7) + bytes(50), "a.stl"),
        ("a.stl", bytes(84), "no triangle"),
        ("a.ply", b"ply\nformat klingon 1.0\nend_header\n", "a.ply"),
        ("a.obj", b"v 0 0 0\nv 0 0 1\nv 1 0 0\n", "no triangle"),
        ("a.obj", b"v 0 0 0\nv 0 0 1\nv 1 0 0\nf 1 2 9\n", "a.obj"),
        ("a.stl", NAN_STL, "not a finite number"),
        ("a.vtk", b"# vtk", "type .vtk"),
    ],
)
def test_unusable_files(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_surface(path)
    assert said in str(caught.value)
    assert caught.value.remedy


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.stl.*such"):
        read_surface(tmp_path / "a.stl")


def test_unknown_ending_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"Use \.ply"):
        write_surface(SQUARE, tmp_path / "a.vtk")
    assert list(tmp_path.iterdir()) == []
