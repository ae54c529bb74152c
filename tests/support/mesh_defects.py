"""Files of a surface with a fault of the kinds that meshes come with."""

import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from identknee.runs.declare import Array, IntArray
from identknee.subject.surface import Surface

Polygons = list[list[int]]


def chosen(n: int, share: float = 0.02) -> IntArray:
    """Which of `n` triangles have the fault."""
    return np.sort(np.random.default_rng(35).choice(n, max(1, round(share * n)), replace=False))


def write_polygons(path: Path, vertices: Array, polygons: Polygons) -> Path:
    """An OBJ, a text PLY or a VTP file, by its ending, with polygons of any number of corners."""
    numbers = [" ".join(repr(x) for x in row) for row in vertices.tolist()]
    if path.suffix == ".obj":
        lines = [f"v {x}" for x in numbers]
        lines += ["f " + " ".join(str(i + 1) for i in x) for x in polygons]
        path.write_text("\n".join(lines) + "\n")
    elif path.suffix == ".ply":
        head = (
            f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty double x\n"
            f"property double y\nproperty double z\nelement face {len(polygons)}\n"
            "property list uchar int vertex_indices\nend_header\n"
        )
        rows = [" ".join(map(str, (len(x), *x))) for x in polygons]
        path.write_text(head + "\n".join([*numbers, *rows]) + "\n")
    else:
        ends = np.cumsum([len(x) for x in polygons])
        path.write_text(
            '<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian"><PolyData>'
            f'<Piece NumberOfPoints="{len(vertices)}" NumberOfPolys="{len(polygons)}">'
            '<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">'
            + "\n".join(numbers)
            + '</DataArray></Points><Polys><DataArray type="Int32" Name="connectivity" '
            'format="ascii">'
            + " ".join(str(i) for x in polygons for i in x)
            + '</DataArray><DataArray type="Int32" Name="offsets" format="ascii">'
            + " ".join(map(str, ends.tolist()))
            + "</DataArray></Polys></Piece></PolyData></VTKFile>"
        )
    return path


def binary_stl(surface: Surface, *, counted: int | None = None, more: bytes = b"") -> bytes:
    """A binary STL file that counts `counted` triangles and has `more` at its end."""
    corners = surface.vertices[surface.faces].astype("<f4")
    n = len(corners) if counted is None else counted
    rows = b"".join(bytes(12) + x.tobytes() + bytes(2) for x in corners)
    return b"solid by another program".ljust(80) + struct.pack("<I", n) + rows + more


def _at(
    places: Sequence[int], change: Callable[[list[int]], list[list[int]]]
) -> Callable[..., Polygons]:
    """Polygons with those at some places changed."""

    def made(faces: Polygons) -> Polygons:
        found = set(places)
        return [y for i, x in enumerate(faces) for y in (change(x) if i in found else [x])]

    return made


def with_defect(name: str, surface: Surface) -> tuple[Array, Polygons]:
    """Vertices and polygons of a surface with a fault of that name in 2 % of its triangles."""
    vertices, faces = surface.vertices.copy(), surface.faces.tolist()
    places = chosen(len(faces)).tolist()
    changes: dict[str, Callable[[list[int]], list[list[int]]]] = {
        "quad-last": lambda x: [[x[0], x[1], x[2], x[2]]],
        "quad-first": lambda x: [[x[0], x[0], x[1], x[2]]],
        "quad-middle": lambda x: [[x[0], x[1], x[1], x[2]]],
        "quad-closed": lambda x: [[x[0], x[1], x[2], x[0]]],
        "two-corners-alike": lambda x: [x, [x[0], x[1], x[1]]],
        "a-point": lambda x: [[x[0], x[0], x[0]], x],
        "twice": lambda x: [x, x],
        "twice-turned": lambda x: [x, x[1:] + x[:1]],
        "both-sides": lambda x: [x, x[::-1]],
        "turned": lambda x: [x[::-1]],
        "turned-at-last": lambda x: [[x[0], x[2], x[1]]],
        "turned-at-first": lambda x: [[x[1], x[0], x[2]]],
    }
    if name in changes:
        return vertices, _at(places, changes[name])(faces)
    if name == "stray":
        stray = np.random.default_rng(1).normal(scale=500.0, size=(40, 3))
        return np.concatenate([stray, vertices]), [[i + 40 for i in x] for x in faces]
    if name == "line":
        # A new vertex in the middle of an edge, of one triangle alone.
        ends = [faces[i][:2] for i in places]
        middle = np.array([vertices[x].mean(axis=0) for x in ends])
        more = [[a, len(vertices) + k, b] for k, (a, b) in enumerate(ends)]
        return np.concatenate([vertices, middle]), more + faces
    if name == "same-place":
        # The triangles have vertices of their own, and some all three at one place.
        soup = vertices[surface.faces].reshape(-1, 3)
        own = np.arange(len(soup)).reshape(-1, 3)
        flat = np.repeat(soup[own[places, 1]], 3, axis=0)
        more = (len(soup) + np.arange(len(flat)).reshape(-1, 3)).tolist()
        return np.concatenate([soup, flat]), own.tolist() + more
    raise ValueError(name)
