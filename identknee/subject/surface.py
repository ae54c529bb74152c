"""Triangulated surfaces: their geometry, and the files they come from."""

import io
import logging
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.arrays import (
    CHECK_UNITS,
    Array,
    IntArray,
    frozen,
    frozen_integers,
    implausible_coordinates,
    short_repr,
)
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, check_readable, write_atomically

FORMATS = (".stl", ".ply", ".obj")
# A null handler keeps the parser's log off the terminal; its errors become our own.
logging.getLogger("trimesh").addHandler(logging.NullHandler())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """A triangulated surface, usually the open articular side of a cartilage.

    Attributes
    ----------
    vertices
        Positions [mm], shape ``(n, 3)``.
    faces
        Vertex numbers of each triangle, counter-clockwise seen from outside the bone, ``(m, 3)``.
    normals
        Unit outward normal of each triangle, shape ``(m, 3)``; zero where it has no area.
    areas
        Area of each triangle [mm2], shape ``(m,)``.
    vertex_areas
        A third of the area of the triangles around each vertex [mm2], shape ``(n,)``.
    """

    vertices: Array
    faces: IntArray
    normals: Array = field(init=False, repr=False)
    areas: Array = field(init=False, repr=False)
    vertex_areas: Array = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        vertices = frozen(self.vertices, None, 3, name="vertices")
        faces = frozen_integers(self.faces)
        _check(vertices, faces)
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        doubled = np.cross(b - a, c - a)
        length = np.linalg.norm(doubled, axis=1)
        normals = doubled / np.where(length > 0.0, length, 1.0)[:, None]
        corners = np.bincount(
            faces.ravel(), weights=np.repeat(length / 6.0, 3), minlength=len(vertices)
        )
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        object.__setattr__(self, "normals", frozen(normals, None, 3, name="normals"))
        object.__setattr__(self, "areas", frozen(length / 2.0, None, name="areas"))
        object.__setattr__(self, "vertex_areas", frozen(corners, None, name="vertex areas"))

    @property
    def boundary_edges(self) -> IntArray:
        """Vertex numbers of the edges that only one triangle has, shape ``(k, 2)``."""
        edges, n = np.sort(self.edges, axis=1), len(self.vertices)
        # Whole numbers sort ten times as fast as pairs of them.
        named, count = np.unique(edges[:, 0] * n + edges[:, 1], return_counts=True)
        once = named[count == 1]
        return frozen_integers(np.stack([once // n, once % n], axis=1))

    @property
    def edges(self) -> IntArray:
        """The three directed edges of every triangle, shape ``(3 m, 2)``."""
        return frozen_integers(self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))

    @property
    def is_closed(self) -> bool:
        """Whether it has no rim."""
        return len(self.boundary_edges) == 0

    @property
    def centroid(self) -> Array:
        """Centre of its area [mm], shape ``(3,)``."""
        centres = self.vertices[self.faces].mean(axis=1)
        mean: Array = self.areas @ centres / self.areas.sum()
        return mean

    def moved(self, rotation: ArrayLike, translation: ArrayLike) -> "Surface":
        """A copy at ``rotation @ vertex + translation``."""
        turned = self.vertices @ np.asarray(rotation, float).T
        return Surface(vertices=turned + np.asarray(translation, float), faces=self.faces)

    def scaled(self, factor: float) -> "Surface":
        """A copy `factor` (> 0) times as large, about the origin."""
        return Surface(vertices=self.vertices * factor, faces=self.faces)

    def mirrored(self) -> "Surface":
        """A copy seen in the mirror z = 0; its normals still point outward."""
        return Surface(vertices=self.vertices * [1.0, 1.0, -1.0], faces=self.faces[:, ::-1])


def joined(*surfaces: Surface) -> Surface:
    """One surface that holds all of them, none of them connected with another."""
    starts = np.cumsum([0, *(len(x.vertices) for x in surfaces[:-1])])
    return Surface(
        vertices=np.concatenate([x.vertices for x in surfaces]),
        faces=np.concatenate([x.faces + i for x, i in zip(surfaces, starts, strict=True)]),
    )


def read_surface(path: PathLike) -> Surface:
    """The surface in an STL (text or binary), PLY or OBJ file, lengths as they stand there.

    Vertices at exactly the same place become one, in the order they first appear; vertices of no
    triangle are dropped.

    Raises
    ------
    InputError
        If the file is missing, is none of these formats, cannot be parsed or holds no triangle or
        a vertex that is not a number.
    """
    file = check_readable(path)
    if file.suffix.lower() not in FORMATS:
        raise InputError(
            file,
            "",
            f"surfaces of type {file.suffix or 'without ending'} are not read",
            "Export the surface as STL, PLY or OBJ.",
        )
    vertices, faces = _parsed(file)
    if len(faces) == 0:
        raise InputError(
            file, "", "there is no triangle in it", "Export the surface, not points or an outline."
        )
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad) > 0:
        raise InputError(
            file,
            f"vertex {bad[0] + 1}",
            f"{len(bad)} vertices hold a value that is not a finite number",
            "Repair the mesh and export it again.",
        )
    try:
        return _merged(vertices, faces)
    except ValueError as error:
        raise InputError(file, "", str(error), "Repair the mesh and export it again.") from error


def write_surface(surface: Surface, path: PathLike) -> Path:
    """Path of the file that now holds the surface: PLY, STL or OBJ by its ending.

    PLY and OBJ keep every number, PLY in single precision where that loses nothing; STL has single
    precision and no shared vertices.

    Raises
    ------
    InputError
        If the file cannot be written or has another ending.
    """
    target = Path(path)
    kind = target.suffix.lower()
    if kind not in FORMATS:
        raise InputError(
            target, "", f"surfaces are not written as {kind!r}", "Use .ply, .stl or .obj."
        )
    if kind == ".ply":
        return write_atomically(target, _ply(surface))
    if kind == ".obj":
        return write_atomically(target, _obj(surface))
    # Loaded where a file asks for it: a start without one is shorter by a tenth.
    from trimesh import Trimesh
    from trimesh.exchange.stl import export_stl

    binary: bytes = export_stl(Trimesh(surface.vertices, surface.faces, process=False))
    return write_atomically(target, binary)


def _check(vertices: Array, faces: IntArray) -> None:
    if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0:
        raise ValueError(f"faces must have shape (m, 3) with m > 0, got {faces.shape}")
    if not np.isfinite(vertices).all():
        raise ValueError("vertices must be finite numbers in mm")
    if far := implausible_coordinates(vertices):
        raise ValueError(f"a vertex lies {far}; {CHECK_UNITS}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"faces must number the {len(vertices)} vertices from 0, "
            f"got {faces.min()} to {faces.max()}"
        )


def _parsed(file: Path) -> tuple[Array, IntArray]:
    """Vertices and faces of a file as the parser gives them."""
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mesh: Any = trimesh.load_mesh(
                io.BytesIO(file.read_bytes()),
                file_type=file.suffix[1:].lower(),
                process=False,
                **({"skip_materials": True} if file.suffix.lower() == ".obj" else {}),
            )
            if isinstance(mesh, trimesh.Scene):
                mesh = trimesh.util.concatenate(tuple(mesh.geometry.values()))
            vertices = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), float)
            faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), np.int64)
    except Exception as error:
        # The parser raises errors of many types, some of its own.
        raise InputError(
            file,
            "",
            f"this is no {file.suffix[1:].upper()} file that can be read "
            f"({type(error).__name__}: {' '.join(str(error).split())[:120]})",
            "Export the surface again.",
        ) from error
    return vertices, faces


def _merged(vertices: Array, faces: IntArray) -> Surface:
    """The surface of the vertices that triangles use, each place once, in order of appearance."""
    _check(vertices, faces)
    is_used = np.zeros(len(vertices), bool)
    is_used[faces] = True
    # Adding zero turns -0.0 into 0.0.
    places = vertices[is_used] + 0.0
    order = np.lexsort(places.T)
    is_new = np.r_[True, (places[order[1:]] != places[order[:-1]]).any(axis=1)]
    # Of vertices at one place the first comes first, as the sort is stable.
    first = order[is_new]
    rank = np.empty(len(first), np.int64)
    appearing = np.argsort(first)
    rank[appearing] = np.arange(len(first))
    number = np.empty(len(vertices), np.int64)
    number[np.flatnonzero(is_used)[order]] = rank[np.cumsum(is_new) - 1]
    return Surface(vertices=places[first[appearing]], faces=number[faces])


def _ply(surface: Surface) -> bytes:
    single = surface.vertices.astype("<f4")
    is_exact = np.array_equal(single, surface.vertices)
    vertices, kind = (single, "float") if is_exact else (surface.vertices.astype("<f8"), "double")
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment lengths in mm\n"
        f"element vertex {len(surface.vertices)}\n"
        f"property {kind} x\nproperty {kind} y\nproperty {kind} z\n"
        f"element face {len(surface.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(surface.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, surface.faces
    return header.encode() + vertices.tobytes() + rows.tobytes()


def _obj(surface: Surface) -> str:
    lines = ["# lengths in mm"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in surface.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (surface.faces + 1).tolist()]
    return "\n".join(lines) + "\n"
