"""Triangulated surfaces: their geometry, and the files they come from."""

from dataclasses import dataclass, field, replace
from pathlib import Path

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
from identknee.subject.mesh_files import PARSERS, read_mesh
from identknee.subject.mesh_repair import NOTHING, Repairs, repaired

WRITTEN = (".stl", ".ply", ".obj")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """A triangulated surface, usually the open articular side of a cartilage.

    Attributes
    ----------
    vertices
        Positions [mm], shape ``(n, 3)``.
    faces
        Vertex numbers of each triangle, counter-clockwise seen from outside the bone, ``(m, 3)``.
    repairs
        What was mended when it was read.
    normals
        Unit outward normal of each triangle, shape ``(m, 3)``; zero where it has no area.
    areas
        Area of each triangle [mm2], shape ``(m,)``.
    vertex_areas
        A third of the area of the triangles around each vertex [mm2], shape ``(n,)``.
    """

    vertices: Array
    faces: IntArray
    repairs: Repairs = field(default=NOTHING, repr=False)
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
        return replace(self, vertices=turned + np.asarray(translation, float))

    def scaled(self, factor: float) -> "Surface":
        """A copy `factor` (> 0) times as large, about the origin."""
        return replace(self, vertices=self.vertices * factor)

    def mirrored(self) -> "Surface":
        """A copy seen in the mirror z = 0; its normals still point outward."""
        mirror = self.vertices * [1.0, 1.0, -1.0]
        return replace(self, vertices=mirror, faces=self.faces[:, ::-1])


def joined(*surfaces: Surface) -> Surface:
    """One surface that holds all of them, none of them connected with another."""
    starts = np.cumsum([0, *(len(x.vertices) for x in surfaces[:-1])])
    return Surface(
        vertices=np.concatenate([x.vertices for x in surfaces]),
        faces=np.concatenate([x.faces + i for x, i in zip(surfaces, starts, strict=True)]),
        repairs=sum((x.repairs for x in surfaces), NOTHING),
    )


def read_surface(path: PathLike) -> Surface:
    """The surface in an STL, PLY, OBJ or VTP file (text or binary), lengths as they stand there.

    Vertices at exactly the same place become one, in the order they first appear. What is left out
    or turned round stands in its `repairs`: triangles without area or given twice, triangles wound
    otherwise than most of their surface, vertices of no triangle, and what of the file is not read.

    Raises
    ------
    InputError
        If the file is missing, is none of these formats, cannot be parsed, is cut off or holds no
        triangle or a vertex that is not a number.
    """
    file = check_readable(path)
    if file.suffix.lower() not in PARSERS:
        raise InputError(
            file,
            "",
            f"surfaces of type {file.suffix or 'without ending'} are not read",
            "Export the surface as STL, PLY, OBJ or VTP.",
        )
    mesh = read_mesh(file)
    if len(mesh.faces) == 0:
        raise InputError(
            file, "", "there is no triangle in it", "Export the surface, not points or an outline."
        )
    bad = np.flatnonzero(~np.isfinite(mesh.vertices).all(axis=1))
    if len(bad) > 0:
        raise InputError(
            file,
            f"vertex {bad[0] + 1}",
            f"{len(bad)} vertices hold a value that is not a finite number",
            "Repair the mesh and export it again.",
        )
    try:
        found = surface_of(mesh.vertices, mesh.faces, is_soup=mesh.is_soup)
    except ValueError as error:
        raise InputError(file, "", str(error), "Repair the mesh and export it again.") from error
    return replace(found, repairs=found.repairs + Repairs(remarks=mesh.remarks))


def surface_of(vertices: Array, faces: IntArray, *, is_soup: bool = False) -> Surface:
    """A surface of vertices ``(n, 3)`` [mm] and triangles ``(m, 3)``, mended as files are.

    Parameters
    ----------
    vertices, faces
        Places, and the numbers of the vertices of each triangle from 0.
    is_soup
        Whether every triangle has vertices of its own.

    Raises
    ------
    ValueError
        If shapes or numbers are not those of a surface.
    """
    whole, triangles = frozen(vertices, None, 3, name="vertices"), frozen_integers(faces)
    _check(whole, triangles)
    places, numbered, found = repaired(whole, triangles, is_soup=is_soup)
    return Surface(vertices=places, faces=numbered, repairs=found)


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
    if kind not in WRITTEN:
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
