"""A mesh with a fault is read as the mesh without it, or refused for that fault."""

import base64
import gzip
import lzma
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mesh_defects import binary_stl, chosen, with_defect, write_polygons

from identknee.runs.errors import InputError
from identknee.subject.reference import reference_knee
from identknee.subject.surface import NOTHING, Surface, read_surface, write_surface


@pytest.fixture(scope="module")
def clean() -> Surface:
    tibia = reference_knee(3.0, femur_edge_mm=3.0).tibia[0]
    # In single precision, which STL files have, and in the order of an STL file's vertices.
    return Surface(vertices=tibia.vertices.astype(np.float32).astype(float), faces=tibia.faces)


DEFECTS = {
    "quad-last": "without_area",
    "quad-first": "without_area",
    "quad-middle": "without_area",
    "quad-closed": "without_area",
    "two-corners-alike": "without_area",
    "a-point": "without_area",
    "line": "without_area",
    "same-place": "without_area",
    "twice": "twice",
    "twice-turned": "twice",
    "both-sides": "twice",
    "turned": "turned",
    "turned-at-last": "turned",
    "turned-at-first": "turned",
    "stray": "unused",
}


@pytest.mark.parametrize("ending", ["obj", "ply", "vtp"])
@pytest.mark.parametrize("name", DEFECTS)
def test_a_repaired_mesh_is_the_clean_one(
    tmp_path: Path, clean: Surface, name: str, ending: str
) -> None:
    sound = read_surface(
        write_polygons(tmp_path / f"a.{ending}", clean.vertices, clean.faces.tolist())
    )
    assert sound.repairs.clauses == ()
    found = read_surface(write_polygons(tmp_path / f"b.{ending}", *with_defect(name, clean)))
    wanted = sound
    if name == "same-place":
        # Triangles with vertices of their own number them as they come, as STL files do.
        own = clean.vertices[clean.faces].reshape(-1, 3)
        faces = np.arange(len(own)).reshape(-1, 3).tolist()
        wanted = read_surface(write_polygons(tmp_path / f"c.{ending}", own, faces))
    np.testing.assert_array_equal(found.vertices, wanted.vertices)
    np.testing.assert_array_equal(found.faces, wanted.faces)
    n = 40 if name == "stray" else len(chosen(len(clean.faces)))
    assert getattr(found.repairs, DEFECTS[name]) == n
    assert len(found.repairs.clauses) == 1


@pytest.mark.parametrize(
    "name",
    ["twice", "both-sides", "turned", "turned-at-last", "turned-at-first", "a-point", "line"],
)
def test_an_stl_file_with_a_fault_is_the_clean_one(
    tmp_path: Path, clean: Surface, name: str
) -> None:
    vertices, polygons = with_defect(name, clean)
    for file, surface in (
        ("a.stl", clean),
        ("b.stl", Surface(vertices=vertices, faces=np.array(polygons))),
    ):
        (tmp_path / file).write_bytes(binary_stl(surface))
    sound, found = (read_surface(tmp_path / x) for x in ("a.stl", "b.stl"))
    np.testing.assert_array_equal(found.vertices, sound.vertices)
    np.testing.assert_array_equal(found.faces, sound.faces)
    assert found.repairs.clauses


def test_a_triangle_that_closes_a_gap_of_no_width_divides_its_neighbour(tmp_path: Path) -> None:
    # The square 0 1 2 3 with a vertex 4 on its diagonal, which one side has and the other has not.
    vertices = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]], float)
    polygons = [[0, 1, 2], [0, 2, 4], [0, 4, 3], [4, 2, 3]]
    found = read_surface(write_polygons(tmp_path / "a.obj", vertices, polygons))
    assert found.repairs.without_area == 1
    assert found.areas.sum() == pytest.approx(4.0)
    assert len(found.boundary_edges) == 4
    assert (found.normals[:, 2] == 1.0).all()


def test_half_of_it_turned_is_turned_back_by_area_in_each_part(tmp_path: Path) -> None:
    vertices = np.array([[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0], [0, 4, 0]], float)
    both = np.concatenate([vertices, vertices + np.array([9.0, 0.0, 0.0])])
    polygons = [[0, 1, 2], [0, 2, 3], [2, 3, 4], [5, 6, 7], [5, 7, 8], [7, 8, 9]]
    found = read_surface(write_polygons(tmp_path / "a.obj", both, polygons))
    assert (found.repairs.turned, found.normals[:, 2].min()) == (2, 1.0)


def test_a_band_with_one_side_stays_as_it_is(tmp_path: Path) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    across = np.stack(
        [np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)],
        axis=1,
    )
    middle = np.stack([4 * np.cos(angle), 4 * np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([middle - across, middle + across])
    polygons = []
    for i in range(12):
        a, b = i, i + 12
        c, d = ((i + 1) % 12, (i + 1) % 12 + 12) if i < 11 else (12, 0)
        polygons += [[a, c, b], [b, c, d]]
    found = read_surface(write_polygons(tmp_path / "a.obj", vertices, polygons))
    assert (found.repairs.turned, len(found.faces)) == (0, 24)


@pytest.mark.parametrize("counted", [7, 1, -3, -40, None])
def test_a_wrong_count_in_an_stl_file(tmp_path: Path, clean: Surface, counted: int | None) -> None:
    n = len(clean.faces)
    (tmp_path / "a.stl").write_bytes(binary_stl(clean))
    (tmp_path / "b.stl").write_bytes(
        binary_stl(clean, counted=0 if counted is None else n + counted)
    )
    sound, found = (read_surface(tmp_path / x) for x in ("a.stl", "b.stl"))
    np.testing.assert_array_equal(found.faces, sound.faces)
    np.testing.assert_array_equal(found.vertices, sound.vertices)
    assert len(found.repairs.clauses) == 1
    assert sound.repairs.clauses == ()


@pytest.mark.parametrize(
    "more",
    [
        bytes(17),
        bytes(50),
        bytes(117),
        bytes(1),
        b"made by a scanner, all rights reserved, and more",
    ],
)
def test_bytes_after_the_last_triangle(tmp_path: Path, clean: Surface, more: bytes) -> None:
    (tmp_path / "a.stl").write_bytes(binary_stl(clean))
    (tmp_path / "b.stl").write_bytes(binary_stl(clean, more=more))
    sound, found = (read_surface(tmp_path / x) for x in ("a.stl", "b.stl"))
    np.testing.assert_array_equal(found.faces, sound.faces)
    assert found.repairs.clauses
    write_surface(clean, tmp_path / "a.ply")
    (tmp_path / "b.ply").write_bytes((tmp_path / "a.ply").read_bytes() + more)
    again = read_surface(tmp_path / "b.ply")
    np.testing.assert_array_equal(again.faces, clean.faces)
    assert again.repairs.clauses


@pytest.mark.parametrize(
    ("name", "edit"),
    [
        ("a.stl", lambda x: x[:-20]),
        ("a.stl", lambda x: x[:83]),
        ("a.ply", lambda x: x[:-20]),
        ("a.ply", lambda x: x.replace(b"element face ", b"element face 9")),
        ("a.ply", lambda x: x.replace(b"element face 2", b"element face 1")),
        ("a.ply", lambda x: x.replace(b"element vertex ", b"element vertex 9")),
        ("a.vtp", lambda x: x.replace(b'NumberOfPoints="', b'NumberOfPoints="1')),
        ("a.vtp", lambda x: x.replace(b'NumberOfPolys="', b'NumberOfPolys="1')),
        ("a.vtp", lambda x: x.replace(b"PolyData", b"UnstructuredGrid")),
        ("a.vtp", lambda x: x[: len(x) // 2]),
    ],
)  # fmt: skip
def test_a_file_that_is_cut_off_is_refused(
    tmp_path: Path, clean: Surface, name: str, edit: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / name
    if name.endswith("vtp"):
        write_polygons(path, clean.vertices, clean.faces.tolist())
    else:
        write_surface(clean, path)
    before = path.read_bytes()
    path.write_bytes(edit(before))
    assert path.read_bytes() != before
    with pytest.raises(InputError) as caught:
        read_surface(path)
    assert caught.value.remedy


def _vtp(stored: str, packed: str) -> bytes:
    """Two triangles, their numbers stored in one of the ways that VTK has."""
    arrays = {
        "Points": np.array([[0, 0, 0], [0, 0, 2], [2, 0, 2], [2, 0, 0]], "<f4").tobytes(),
        "connectivity": np.array([0, 1, 2, 0, 2, 3], "<i8").tobytes(),
        "offsets": np.array([3, 6], "<i8").tobytes(),
    }
    packs: dict[str, Callable[[bytes], bytes]] = {"zlib": zlib.compress, "lzma": lzma.compress}
    pack = packs.get(packed)
    name = {"zlib": "vtkZLibDataCompressor", "lzma": "vtkLZMADataCompressor"}.get(packed, "")
    encode: Callable[[bytes], bytes] = (lambda x: x) if stored == "raw" else base64.b64encode
    appended, texts = b"", {}
    for key, data in arrays.items():
        if pack is None:
            block = encode(struct.pack("<Q", len(data)) + data)
        else:
            # Two blocks, the last of them shorter.
            cut = 16
            blocks = [pack(data[:cut]), pack(data[cut:])] if len(data) > cut else [pack(data)]
            last = len(data) - cut if len(data) > cut else 0
            sizes = struct.pack(f"<{3 + len(blocks)}Q", len(blocks), cut, last, *map(len, blocks))
            block = encode(sizes) + encode(b"".join(blocks))
        texts[key] = (
            f'format="binary">{block.decode()}</DataArray>'
            if stored == "inline"
            else f'format="appended" offset="{len(appended)}"/>'
        )
        appended += b"" if stored == "inline" else block
    compressor = f' compressor="{name}"' if name else ""
    head = (
        f'<VTKFile type="PolyData" byte_order="LittleEndian" header_type="UInt64"{compressor}>'
        '<PolyData><Piece NumberOfPoints="4" NumberOfPolys="2"><Points>'
        f'<DataArray type="Float32" NumberOfComponents="3" {texts["Points"]}</Points><Polys>'
        f'<DataArray type="Int64" Name="connectivity" {texts["connectivity"]}'
        f'<DataArray type="Int64" Name="offsets" {texts["offsets"]}</Polys></Piece></PolyData>'
    ).encode()
    if stored != "inline":
        kind = b"raw" if stored == "raw" else b"base64"
        head += b'<AppendedData encoding="' + kind + b'">\n_' + appended + b"</AppendedData>"
    return head + b"</VTKFile>"


@pytest.mark.parametrize("packed", ["", "zlib", "lzma"])
@pytest.mark.parametrize("stored", ["inline", "appended", "raw"])
def test_vtp_files_however_stored(tmp_path: Path, stored: str, packed: str) -> None:
    path = tmp_path / "a.vtp"
    path.write_bytes(_vtp(stored, packed))
    found = read_surface(path)
    assert found.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert found.vertices[2].tolist() == [2.0, 0.0, 2.0]
    assert found.repairs is not NOTHING
    assert found.repairs.clauses == ()


def _text_stl(surface: Surface) -> str:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        + "endloop\nendfacet\n"
        for corners in surface.vertices[surface.faces].tolist()
    )
    return f"solid x\n{facets}endsolid x\n"


def _obj(surface: Surface) -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in surface.vertices.tolist()]
    return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in surface.faces)])


@pytest.mark.parametrize("mark", [b"\xef\xbb\xbf", b"\xef\xbb\xbf# by an editor\n"])
def test_a_mark_before_the_text_of_a_mesh_is_passed_over(
    tmp_path: Path, clean: Surface, mark: bytes
) -> None:
    texts = {"obj": _obj(clean).encode()}
    if not mark.endswith(b"\n"):
        texts["stl"] = _text_stl(clean).encode()
    for ending, text in texts.items():
        (tmp_path / f"a.{ending}").write_bytes(text)
        (tmp_path / f"b.{ending}").write_bytes(mark + text)
        sound, found = (read_surface(tmp_path / f"{x}.{ending}") for x in "ab")
        np.testing.assert_array_equal(found.faces, sound.faces)
        np.testing.assert_array_equal(found.vertices, sound.vertices)


@pytest.mark.parametrize(("held", "named"), [
    ("obj", "stl"), ("ply", "stl"), ("vtp", "stl"), ("off", "obj"), ("stl", "obj"), ("obj", "ply"),
    ("vtk", "ply"), ("ply", "vtp"),
])  # fmt: skip
def test_a_file_of_another_kind_is_named(
    tmp_path: Path, clean: Surface, held: str, named: str
) -> None:
    texts = {
        "off": b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        "vtk": b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n",
        "stl": _text_stl(clean).encode(),
    }
    if held not in texts:
        write_polygons(tmp_path / f"made.{held}", clean.vertices, clean.faces.tolist())
        texts[held] = (tmp_path / f"made.{held}").read_bytes()
    (tmp_path / f"a.{named}").write_bytes(texts[held])
    with pytest.raises(InputError, match=f" {held.upper()} file"):
        read_surface(tmp_path / f"a.{named}")


@pytest.mark.parametrize("ending", ["stl", "obj"])
def test_decimal_commas_are_named(tmp_path: Path, clean: Surface, ending: str) -> None:
    text = _text_stl(clean) if ending == "stl" else _obj(clean)
    (tmp_path / f"a.{ending}").write_text(text.replace(".", ","))
    with pytest.raises(InputError, match="'2,0 ") as caught:
        read_surface(tmp_path / f"a.{ending}")
    assert caught.value.where == "vertex 1"
    assert "decimal points" in caught.value.remedy


@pytest.mark.parametrize("vertex", ["99999", "-99999"])
def test_a_vertex_that_is_not_there_is_named_by_its_line(
    tmp_path: Path, clean: Surface, vertex: str
) -> None:
    text = _obj(clean)
    (tmp_path / "a.obj").write_text(f"{text}\nf 1 2 {vertex}\n")
    with pytest.raises(InputError, match=r" -?99\d\d\d, .* 169 ") as caught:
        read_surface(tmp_path / "a.obj")
    assert caught.value.where == f"line {len(text.splitlines()) + 1}"


def test_a_count_that_is_too_large_may_be_a_file_cut_off(tmp_path: Path, clean: Surface) -> None:
    (tmp_path / "a.stl").write_bytes(binary_stl(clean)[: -50 * 9])
    (clause,) = read_surface(tmp_path / "a.stl").repairs.clauses
    assert "cut off" in clause


@pytest.mark.parametrize("counted", [-3, -40, 0])
@pytest.mark.parametrize("more", [bytes(17), bytes(100)])
def test_triangles_beyond_a_count_too_small_are_read_before_trailing_bytes(
    tmp_path: Path, clean: Surface, counted: int, more: bytes
) -> None:
    n = len(clean.faces)
    stated = n + counted if counted else 0
    (tmp_path / "a.stl").write_bytes(binary_stl(clean))
    (tmp_path / "b.stl").write_bytes(binary_stl(clean, counted=stated, more=more))
    sound, found = (read_surface(tmp_path / x) for x in ("a.stl", "b.stl"))
    np.testing.assert_array_equal(found.faces, sound.faces)
    assert len(found.repairs.clauses) == 2


def test_a_binary_stl_file_whose_header_has_words_of_a_text(tmp_path: Path, clean: Surface) -> None:
    data = binary_stl(clean, more=bytes(17))
    (tmp_path / "a.stl").write_bytes(b"solid with facet normal".ljust(80) + data[80:])
    assert len(read_surface(tmp_path / "a.stl").faces) == len(clean.faces)


@pytest.mark.parametrize("before", [b"solid " + b"name" * 600 + b"\n", b"# made by hand\n"])
def test_a_text_stl_file_is_one_whatever_stands_above_it(
    tmp_path: Path, clean: Surface, before: bytes
) -> None:
    (tmp_path / "a.stl").write_bytes(before + _text_stl(clean).encode())
    assert len(read_surface(tmp_path / "a.stl").faces) == len(clean.faces)


@pytest.mark.parametrize(("data", "why"), [
    (gzip.compress(bytes(500)), "GZ file"),
    (b"PK\x03\x04" + bytes(500), "ZIP file"),
    (b"solid x\nendsolid x\n", "no triangle"),
    (b"a letter of more words\n" * 9, "neither a binary STL"),
    (bytes(80) + struct.pack("<I", 7), "counts 7 triangles"),
])  # fmt: skip
def test_an_stl_file_without_triangles_is_refused_for_what_it_is(
    tmp_path: Path, data: bytes, why: str
) -> None:
    (tmp_path / "a.stl").write_bytes(data)
    with pytest.raises(InputError, match=why):
        read_surface(tmp_path / "a.stl")
