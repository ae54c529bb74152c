"""Readers of STL, PLY, OBJ and VTP files, and the faults that they refuse or remark on."""

import base64
import binascii
import lzma
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from identknee.runs.declare import Array, IntArray
from identknee.runs.errors import InputError

EXPORT_AGAIN = "Export the surface again."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RawMesh:
    """Vertices and triangles as a file has them, nothing repaired.

    Attributes
    ----------
    vertices
        Positions, lengths as they stand in the file, shape ``(n, 3)``.
    faces
        Vertex numbers of the triangles in the order of the file, shape ``(m, 3)``. A polygon is a
        fan of them about its first corner.
    remarks
        What of the file was not read or was read in another way than it says, as clauses.
    """

    vertices: Array
    faces: IntArray
    remarks: tuple[str, ...] = ()

    @property
    def is_soup(self) -> bool:
        """Whether no two triangles share a vertex, as in an STL file."""
        return np.array_equal(self.faces.ravel(), np.arange(len(self.vertices)))


def read_mesh(file: Path) -> RawMesh:
    """The mesh in a file, by its ending.

    Raises
    ------
    InputError
        If the file is not of that type, is cut off, or its counts cannot be right.
    """
    parse = PARSERS[file.suffix.lower()]
    try:
        data = _without_mark(file.read_bytes())
        _check_kind(file, data)
        # Some values that are not numbers are cast with a warning only; they are refused later.
        with np.errstate(invalid="ignore"):
            return parse(data)
    except MeshError as error:
        raise InputError(file, error.where, error.why, error.remedy) from error
    except (
        *(ValueError, IndexError, KeyError, OverflowError, MemoryError, TypeError, ET.ParseError),
        *(struct.error, zlib.error, lzma.LZMAError, binascii.Error),
    ) as error:
        raise InputError(
            file,
            "",
            f"this cannot be read as {file.suffix[1:].upper()} "
            f"({type(error).__name__}: {' '.join(str(error).split())[:120]})",
            EXPORT_AGAIN,
        ) from error


class MeshError(Exception):
    """Why a mesh cannot be read, and where in its file."""

    def __init__(self, why: str, where: str = "", remedy: str = EXPORT_AGAIN) -> None:
        super().__init__(why)
        self.why, self.where, self.remedy = why, where, remedy


# Byte-order mark of UTF-8 text, and the first bytes of files that may follow it.
MARK = b"\xef\xbb\xbf"
BEGINNINGS = (b"solid", b"ply", b"#", b"v ", b"o ", b"g ", b"mtllib", b"<")
# Files that hold others.
PACKED = {b"\x1f\x8b": ".gz", b"PK\x03\x04": ".zip"}
_OBJ_LINE = re.compile(rb"(v|o|g|mtllib|usemtl)[ \t]+[^\s\x00]")


def _without_mark(data: bytes) -> bytes:
    """The file without the mark that an editor put before its text."""
    rest = data.removeprefix(MARK)
    return rest if rest.lstrip().lower().startswith(BEGINNINGS) else data


def _check_kind(file: Path, data: bytes) -> None:
    """Refuse a file of another kind than its name says."""
    held = kind_of(data)
    if held and held != file.suffix.lower():
        said = f"it holds {'an' if held[1] in 'os' else 'a'} {held[1:].upper()} file"
        remedy = f"Call it {file.stem}{held}." if held in PARSERS else EXPORT_AGAIN
        remedy = "Unpack it." if held in PACKED.values() else remedy
        raise MeshError(f"{said}, whatever its name says", remedy=remedy)


def kind_of(data: bytes) -> str:
    r"""The ending that a file ought to have by its beginning; empty where nothing tells.

    Examples
    --------
    >>> kind_of(b"OFF\n8 6 0\n"), kind_of(b"# made by hand\nv 0 0 0\n"), kind_of(b"8 6")
    ('.off', '.obj', '')
    """
    start = data[:2048]
    if packed := next((x for begin, x in PACKED.items() if data.startswith(begin)), ""):
        return packed
    if start.startswith(b"ply") and b"format" in start:
        return ".ply"
    if b"<VTKFile" in start:
        return ".vtp"
    if start.startswith(b"# vtk DataFile"):
        return ".vtk"
    if re.match(rb"(ST)?C?N?OFF\s", start):
        return ".off"
    if start.lstrip()[:5].lower() == b"solid" and b"facet" in start.lower():
        return ".stl"
    lines = [x.strip() for x in start.splitlines()]
    first = next((x for x in lines if x and not x.startswith(b"#")), b"")
    return ".obj" if _OBJ_LINE.match(first) else ""


def _numbered(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


# A binary STL file: a header, the number of triangles, and for each 12 numbers and two bytes.
STL_HEADER, STL_TRIANGLE = 84, 50
STL_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])


def _stl(data: bytes) -> RawMesh:
    counted = int.from_bytes(data[80:STL_HEADER], "little") if len(data) >= STL_HEADER else -1
    # Many programs begin binary files with the word of text files, too; no text has a zero byte.
    is_text = b"\0" not in data[:2048]
    if is_text and len(data) != STL_HEADER + STL_TRIANGLE * counted:
        return _text_stl(data)
    if counted < 0:
        raise MeshError("it is too short for an STL file, and does not begin with solid")
    whole, rest = divmod(len(data) - STL_HEADER, STL_TRIANGLE)
    said = f"its header counts {_numbered(counted, 'triangle')}"
    if counted > whole and rest:
        raise MeshError(f"{said}, but the file ends within triangle {whole + 1}")
    if whole == 0:
        raise MeshError(f"there is no triangle in it, and {said}")
    rows = np.frombuffer(data, STL_ROW, whole, STL_HEADER)
    n, remarks = _n_triangles(rows, counted), []
    if n != counted:
        cut = ": the count is wrong, or the file was cut off" if counted > n else ""
        remarks.append(f"{said}, {n} are there{cut}")
    if (after := len(data) - STL_HEADER - STL_TRIANGLE * n) > 0:
        remarks.append(f"{_numbered(after, 'byte')} after the last triangle are not read")
    corners = rows["corners"][:n].reshape(-1, 3).astype(float)
    return RawMesh(vertices=corners, faces=np.arange(3 * n).reshape(-1, 3), remarks=tuple(remarks))


def _n_triangles(rows: Any, counted: int) -> int:
    """Number of rows that are triangles: those counted, and later ones if all are of their mesh.

    Rows at the end whose corners are one point, such as zeros, fill the file up.
    """
    corners = rows["corners"]
    is_triangle = (corners != corners[:, :1]).any(axis=(1, 2))
    n = int(np.max(np.flatnonzero(is_triangle), initial=-1)) + 1
    if counted >= n or counted == 0:
        return min(max(n, counted), len(rows))
    with np.errstate(all="ignore"):
        low = np.nanmin(corners[:counted], axis=(0, 1))
        size = np.nanmax(corners[:counted], axis=(0, 1)) - low
        margin = size.max()
        later = corners[counted:n]
        is_of_mesh = np.all((later >= low - margin) & (later <= low + size + margin))
    return n if is_of_mesh else counted


def _text_stl(data: bytes) -> RawMesh:
    words = data.decode("utf-8", "replace").lower().split()
    at = [i for i, x in enumerate(words) if x == "vertex"]
    n, ended = words.count("endloop"), words.count("endfacet")
    if not any(x in words for x in ("solid", "facet")):
        raise MeshError("it is neither a binary STL file nor a text that begins with solid")
    if len(at) != 3 * n or n != ended:
        raise MeshError(
            f"it has {_numbered(len(at), 'corner')} for {_numbered(ended, 'whole facet')}: it is "
            "cut off, or a facet is not a triangle"
        )
    if not any(x == "endsolid" for x in words):
        raise MeshError(f"it ends after {_numbered(n, 'facet')} without endsolid, as if cut off")
    vertices = _floats([words[i + 1 : i + 4] for i in at], "vertex")
    return RawMesh(vertices=vertices, faces=np.arange(3 * n).reshape(-1, 3))


def _floats(rows: Sequence[Sequence[str]], what: str) -> Array:
    """Rows of three numbers; the first that is none is named."""
    try:
        made = np.array(rows, float)
        if made.shape == (len(rows), 3) or not rows:
            return made.reshape(-1, 3)
    except ValueError:
        pass
    for i, row in enumerate(rows, 1):
        try:
            is_good = len([float(x) for x in row]) == 3
        except ValueError:
            is_good = False
        if not is_good:
            shown = " ".join(row)
            remedy = "Export it with decimal points." if "," in shown else EXPORT_AGAIN
            why = f"three numbers are wanted, got {shown[:60]!r}"
            raise MeshError(why, f"{what} {i}", remedy)
    raise MeshError("its vertices are not of three numbers each")


def _fan(polygons: Sequence[Sequence[int]] | IntArray) -> IntArray:
    """Triangles of polygons, those of each together, in their order."""
    if isinstance(polygons, np.ndarray):
        corners = polygons.shape[1]
        parts = [polygons[:, [0, i, i + 1]] for i in range(1, corners - 1)]
        return np.stack(parts, axis=1).reshape(-1, 3) if parts else np.zeros((0, 3), np.int64)
    made = [(x[0], x[i], x[i + 1]) for x in polygons for i in range(1, len(x) - 1)]
    return np.array(made, np.int64).reshape(-1, 3)


PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
PLY_CORNERS = ("vertex_indices", "vertex_index")


@dataclass(slots=True, kw_only=True)
class _PlyElement:
    """An element of a PLY header; of a list, ``counts`` has the type of its length."""

    name: str
    n: int
    names: list[str]
    types: list[str]
    counts: list[str]

    @property
    def has_lists(self) -> bool:
        return any(self.counts)


def _ply(data: bytes) -> RawMesh:
    end = re.search(rb"end_header[ \t]*\r?\n", data)
    if not data.startswith(b"ply") or end is None:
        raise MeshError("it does not begin with ply and a header that ends in end_header")
    order, elements = _ply_header(data[: end.start()].decode("ascii", "replace"))
    body = data[end.end() :]
    found, rest = (_text_ply if not order else _binary_ply)(body, elements, order)
    if rest and (last := elements[-1]).name == "face" and _goes_on(rest, last, order):
        raise MeshError(
            f"its header counts {_numbered(last.n, 'face')}, but more follow",
            remedy="Correct the count of faces in its header, or export it again.",
        )
    remarks = (f"{_numbered(len(rest), 'byte')} after the last element are not read",)
    return RawMesh(
        vertices=found["vertex"],
        faces=_fan(found["face"]),
        remarks=remarks if rest.strip() else (),
    )


def _ply_header(text: str) -> tuple[str, list[_PlyElement]]:
    """The byte order, empty for text, and the elements."""
    order, elements = None, list[_PlyElement]()
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["format"]:
            order = PLY_ORDERS.get(words[1])
        elif words[:1] == ["element"]:
            n = int(words[2])
            if n < 0:
                raise MeshError(f"its header counts {n} of {words[1]}")
            elements.append(_PlyElement(name=words[1], n=n, names=[], types=[], counts=[]))
        elif words[:1] == ["property"]:
            is_list = words[1] == "list"
            elements[-1].names.append(words[-1])
            elements[-1].types.append(PLY_TYPES[words[-2]])
            elements[-1].counts.append(PLY_TYPES[words[2]] if is_list else "")
    if order is None:
        raise MeshError("its header states no format that is known")
    known = {x.name: x for x in elements}
    if "vertex" not in known or not {"x", "y", "z"} <= set(known["vertex"].names):
        raise MeshError("its header has no vertices with x, y and z")
    if "face" not in known:
        raise MeshError("there is no triangle in it", remedy="Export the surface, not points.")
    if len(known) < len(elements):
        raise MeshError("its header has two elements of one name")
    face = known["face"]
    lists = {x for x, count in zip(face.names, face.counts, strict=True) if count}
    if not set(PLY_CORNERS) & lists:
        raise MeshError("its faces have no list of vertex_indices")
    return order, elements


def _cut_off(element: _PlyElement, there: int) -> MeshError:
    return MeshError(
        f"its header counts {element.n} of {element.name}, but only {there} are there: it is cut "
        "off, or the count is wrong"
    )


def _text_ply(
    body: bytes, elements: Sequence[_PlyElement], _order: str
) -> tuple[dict[str, Any], bytes]:
    lines = body.decode("ascii", "replace").splitlines()
    rows = [x.split() for x in lines if x.strip()]
    found: dict[str, Any] = {"face": []}
    for element in elements:
        own, rows = rows[: element.n], rows[element.n :]
        if len(own) < element.n:
            raise _cut_off(element, len(own))
        if element.name == "vertex":
            columns = [element.names.index(x) for x in "xyz"]
            found["vertex"] = _floats(
                [[x[i] for i in columns if i < len(x)] for x in own], "vertex"
            )
        elif element.name == "face":
            found["face"] = [_text_polygon(element, x, i) for i, x in enumerate(own, 1)]
    return found, "\n".join(" ".join(x) for x in rows).encode()


def _text_polygon(element: _PlyElement, words: Sequence[str], number: int) -> list[int]:
    place, polygon = 0, list[int]()
    for name, count in zip(element.names, element.counts, strict=True):
        n = int(words[place]) if count and place < len(words) else 1
        first = place + (1 if count else 0)
        place = first + n
        if place > len(words) or n < 0:
            raise MeshError(
                f"a face of {n} corners is wanted, got {' '.join(words)[:60]!r}; the counts of the "
                "header may be wrong",
                f"face {number}",
            )
        if name in PLY_CORNERS:
            polygon = [int(x) for x in words[first:place]]
    return polygon


def _binary_ply(
    body: bytes, elements: Sequence[_PlyElement], order: str
) -> tuple[dict[str, Any], bytes]:
    found: dict[str, Any] = {"face": []}
    place = 0
    for element in elements:
        fixed = _fixed_rows(body, place, element, order)
        if fixed is None:
            polygons, place = _rows_of_lists(body, place, element, order)
            if element.name == "face":
                found["face"] = polygons
            continue
        place += fixed.nbytes
        if element.name == "vertex":
            found["vertex"] = np.stack([fixed[x].astype(float) for x in "xyz"], axis=1)
        elif element.name == "face":
            name = next(x for x in PLY_CORNERS if x in element.names)
            found["face"] = fixed[name].astype(np.int64)
    return found, body[place:]


def _fixed_rows(body: bytes, place: int, element: _PlyElement, order: str) -> Any:
    """The rows of an element whose lists are all as long as those of the first; else None."""
    lengths = [0] * len(element.names)
    if element.has_lists and element.n:
        at = place
        for i, (kind, count) in enumerate(zip(element.types, element.counts, strict=True)):
            if count:
                size = np.dtype(count).itemsize
                if at + size > len(body):
                    raise _cut_off(element, 0)
                lengths[i] = int(np.frombuffer(body, order + count, 1, at)[0])
                at += size
            at += np.dtype(kind).itemsize * (lengths[i] if count else 1)
    columns: list[Any] = []
    for i, (name, kind, count) in enumerate(
        zip(element.names, element.types, element.counts, strict=True)
    ):
        if count:
            columns += [(f"\n{i}", order + count), (name, order + kind, (lengths[i],))]
        else:
            columns.append((name, order + kind))
    row = np.dtype(columns)
    there = (len(body) - place) // row.itemsize if row.itemsize else element.n
    if there < element.n:
        if element.has_lists:
            return None
        raise _cut_off(element, there)
    rows = np.frombuffer(body, row, element.n, place)
    is_same = all((rows[f"\n{i}"] == lengths[i]).all() for i, x in enumerate(element.counts) if x)
    return rows if is_same else None


def _rows_of_lists(
    body: bytes, place: int, element: _PlyElement, order: str
) -> tuple[list[list[int]], int]:
    """The corners in each row of an element, and where it ends."""
    polygons = []
    kinds = [
        (x in PLY_CORNERS, np.dtype(order + kind), np.dtype(order + count) if count else None)
        for x, kind, count in zip(element.names, element.types, element.counts, strict=True)
    ]
    for i in range(element.n):
        polygon: list[int] = []
        for is_corners, kind, count in kinds:
            n = 1
            if count is not None:
                if place + count.itemsize > len(body):
                    raise _cut_off(element, i)
                n = int(np.frombuffer(body, count, 1, place)[0])
                place += count.itemsize
            if n < 0 or place + n * kind.itemsize > len(body):
                raise _cut_off(element, i)
            if is_corners:
                polygon = [int(x) for x in np.frombuffer(body, kind, n, place)]
            place += n * kind.itemsize
        polygons.append(polygon)
    return polygons, place


def _goes_on(rest: bytes, element: _PlyElement, order: str) -> bool:
    """Whether what follows the faces that are counted is a further face."""
    if not order:
        words = rest.split()
        return len(words) > 3 and words[0] in (b"3", b"4")
    if len(element.names) > 1:
        return False
    one = np.dtype(element.counts[0]).itemsize + 3 * np.dtype(element.types[0]).itemsize
    is_triangle = int(np.frombuffer(rest, order + element.counts[0], 1)[0]) == 3
    return len(rest) % one == 0 and is_triangle


OBJ_WORDS = frozenset(
    (
        *("v", "f", "vn", "vt", "vp", "g", "o", "s", "l", "p", "usemtl", "mtllib", "usemap"),
        *("maplib", "mg", "lod", "bevel", "c_interp", "d_interp", "shadow_obj", "trace_obj"),
        *("cstype", "deg", "bmat", "step", "curv", "curv2", "surf", "parm", "trim", "hole"),
        *("scrv", "sp", "end", "con"),
    )
)


def _obj(data: bytes) -> RawMesh:
    text = data.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ")
    places, polygons, unknown = list[list[str]](), list[list[int]](), 0
    of_polygon = list[int]()
    for i, line in enumerate(text.split("\n"), 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0] == "v":
            places.append(words[1:4])
        elif words[0] == "f":
            numbers = [int(x.split("/", 1)[0]) for x in words[1:]]
            if 0 in numbers:
                raise MeshError("vertices are numbered from 1, got 0", f"line {i}")
            polygons.append([x - 1 if x > 0 else len(places) + x for x in numbers])
            of_polygon.append(i)
        elif words[0] not in OBJ_WORDS:
            unknown += 1
    if not places:
        raise MeshError("there is no vertex in it")
    n = len(places)
    for i, polygon in zip(of_polygon, polygons, strict=True):
        if outside := [x for x in polygon if not 0 <= x < n]:
            why = f"a face has vertex {outside[0] + 1}, and there are {n} vertices"
            raise MeshError(why, f"line {i}", "Repair the mesh and export it again.")
    remarks = (f"{_numbered(unknown, 'line')} that no OBJ file has are not read",)
    return RawMesh(
        vertices=_floats(places, "vertex"),
        faces=_fan(polygons),
        remarks=remarks if unknown else (),
    )


VTK_TYPES = {
    **{f"Int{8 * n}": f"i{n}" for n in (1, 2, 4, 8)},
    **{f"UInt{8 * n}": f"u{n}" for n in (1, 2, 4, 8)},
    "Float32": "f4",
    "Float64": "f8",
}
VTK_UNPACK: dict[str, Callable[[bytes], bytes]] = {
    "vtkZLibDataCompressor": zlib.decompress,
    "vtkLZMADataCompressor": lzma.decompress,
}


class _VtkFile:
    """An XML file of VTK: how its arrays are stored."""

    def __init__(self, data: bytes) -> None:
        start = data.find(b"<AppendedData")
        self._appended, self._is_base64 = b"", True
        if start >= 0:
            # Raw bytes are no XML: they are cut out before it is parsed.
            opened = data.index(b">", start)
            self._is_base64 = b"base64" in data[start:opened]
            self._appended = data[data.index(b"_", opened) + 1 :]
            data = data[:start] + b"</VTKFile>"
        self.root = ET.fromstring(data)
        if self.root.tag != "VTKFile" or self.root.get("type") != "PolyData":
            raise MeshError(
                "it is no VTK file of type PolyData", remedy="Save the surface as PolyData (.vtp)."
            )
        self._order = ">" if self.root.get("byte_order") == "BigEndian" else "<"
        self._header = np.dtype(self._order + VTK_TYPES[self.root.get("header_type", "UInt32")])
        packed = self.root.get("compressor")
        if packed and packed not in VTK_UNPACK:
            raise MeshError(
                f"it is compressed by {packed}, which is not read",
                remedy="Save it with zlib or without compression.",
            )
        self._unpack = VTK_UNPACK.get(packed or "")

    def array(self, element: ET.Element | None) -> Array | IntArray:
        """The numbers of a ``DataArray``."""
        if element is None:
            return np.zeros(0)
        kind = np.dtype(self._order + VTK_TYPES[element.get("type", "Float32")])
        stored = element.get("format", "ascii")
        if stored == "ascii":
            whole = kind.kind in "iu"
            return np.array((element.text or "").split(), np.int64 if whole else float)
        if stored == "appended":
            content = self._appended[int(element.get("offset", "0")) :]
            content = _unwrapped(content) if self._is_base64 else content
        else:
            content = _unwrapped((element.text or "").encode("ascii"))
        size = self._header.itemsize
        if self._unpack is None:
            length = int(np.frombuffer(content, self._header, 1)[0])
            if len(content) < size + length:
                raise MeshError(f"array {element.get('Name', '')} is cut off")
            return np.frombuffer(content[size : size + length], kind)
        n = int(np.frombuffer(content, self._header, 1)[0])
        if n == 0:
            return np.zeros(0, kind)
        lengths = np.frombuffer(content, self._header, n, 3 * size)
        place, blocks = (3 + n) * size, []
        for length in lengths.tolist():
            blocks.append(self._unpack(content[place : place + length]))
            place += length
        return np.frombuffer(b"".join(blocks), kind)


def _unwrapped(text: bytes) -> bytes:
    """The bytes of runs of base64 one after the other, each perhaps padded."""
    packed = re.match(rb"[A-Za-z0-9+/=\s]*", text)
    runs = re.findall(rb"[A-Za-z0-9+/]+={0,2}", b"".join((packed[0] if packed else b"").split()))
    return b"".join(base64.b64decode(x) for x in runs)


def _vtp(data: bytes) -> RawMesh:
    file = _VtkFile(data)
    pieces = file.root.findall("PolyData/Piece")
    if not pieces:
        raise MeshError("it has no piece with points")
    places, polygons, lines, parts, start = [], list[list[int]](), 0, set[float](), 0
    for piece in pieces:
        own = np.asarray(file.array(piece.find("Points/DataArray")), float).reshape(-1, 3)
        stated = int(piece.get("NumberOfPoints", len(own)))
        if stated != len(own):
            raise MeshError(f"it states {stated} points, but {len(own)} are there")
        counts = [0, 0, 0, 0]
        for i, kind in enumerate(("Verts", "Lines", "Polys", "Strips")):
            cells = [[start + x for x in cell] for cell in _cells(file, piece.find(kind))]
            counts[i] = len(cells)
            if kind == "Polys":
                polygons += cells
            elif kind == "Strips":
                # Every other triangle of a strip is wound the other way.
                polygons += [
                    x[j : j + 3] if j % 2 == 0 else [x[j + 1], x[j], x[j + 2]]
                    for x in cells
                    for j in range(len(x) - 2)
                ]
        stated = int(piece.get("NumberOfPolys", counts[2]))
        if stated != counts[2]:
            raise MeshError(f"it states {stated} polygons, but {counts[2]} are there")
        lines += counts[0] + counts[1]
        named = [x for x in piece.iterfind("CellData/DataArray") if x.get("Name") == "part"]
        values = file.array(named[0]) if named else np.zeros(0)
        parts |= set(np.asarray(values, float)[counts[0] + counts[1] :].tolist())
        places.append(own)
        start += len(own)
    if len(parts) > 1:
        raise MeshError(
            f"it holds {len(parts)} surfaces, told apart by its array part, as subject export "
            "writes them",
            remedy="Save one part, for example by a threshold in ParaView.",
        )
    remarks = (f"{_numbered(lines, 'point or line')} beside the triangles are not read",)
    return RawMesh(
        vertices=np.concatenate(places), faces=_fan(polygons), remarks=remarks if lines else ()
    )


def _cells(file: _VtkFile, element: ET.Element | None) -> Iterator[list[int]]:
    """The points of each cell of a kind."""
    arrays = {} if element is None else {x.get("Name"): x for x in element.iterfind("DataArray")}
    ends = file.array(arrays.get("offsets")).tolist()
    points = file.array(arrays.get("connectivity")).tolist()
    if ends and ends[-1] != len(points):
        raise MeshError(f"its cells have {len(points)} corners, but {ends[-1]} are counted")
    first = 0
    for end in ends:
        yield points[first:end]
        first = end


PARSERS: dict[str, Callable[[bytes], RawMesh]] = {
    ".stl": _stl,
    ".ply": _ply,
    ".obj": _obj,
    ".vtp": _vtp,
}
