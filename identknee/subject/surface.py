"""Triangulated surfaces: their geometry, their files, and repairs of faulty meshes.

A sound mesh has no triangle without area, none twice, and all wound alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.declare import (
    CHECK_UNITS,
    Array,
    BoolArray,
    IntArray,
    declared,
    entry,
    frozen,
    frozen_integers,
    implausible_coordinates,
    short_repr,
)
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, check_readable, write_atomically
from identknee.runs.triangles import doubled_areas, lengths, longest_sides, side_names
from identknee.subject.mesh_files import PARSERS, read_mesh

# A triangle is flat if its height is below FLAT times its longest edge, or below SINGLE times its
# distance from the origin, which single precision does not resolve.
FLAT, SINGLE = 1e-5, 3e-7


@declared
class Repairs:
    """What was mended when a surface was read."""

    without_area: int = entry("Triangles without area, left out", unit="1", default=0)
    twice: int = entry("Triangles that were there already, left out", unit="1", default=0)
    turned: int = entry("Triangles wound the other way, turned round", unit="1", default=0)
    unused: int = entry("Vertices of no triangle, left out", unit="1", default=0)
    remarks: tuple[str, ...] = entry("What else was odd about its file, as clauses", default=())

    @property
    def clauses(self) -> tuple[str, ...]:
        """What was done, one thing each; empty where nothing was."""
        counted = (
            (self.without_area, "triangle", "triangles", "without area left out"),
            (self.twice, "triangle", "triangles", "given twice left out"),
            (self.turned, "triangle", "triangles", "wound the other way turned round"),
            (self.unused, "vertex", "vertices", "of no triangle left out"),
        )
        words = [f"{n} {one if n == 1 else many} {x}" for n, one, many, x in counted if n]
        return (*words, *self.remarks)

    def __add__(self, other: "Repairs") -> "Repairs":
        return Repairs(
            without_area=self.without_area + other.without_area,
            twice=self.twice + other.twice,
            turned=self.turned + other.turned,
            unused=self.unused + other.unused,
            remarks=(*self.remarks, *(x for x in other.remarks if x not in self.remarks)),
        )


NOTHING = Repairs()


def repaired(
    vertices: Array, faces: IntArray, *, is_soup: bool = False
) -> tuple[Array, IntArray, Repairs]:
    """Vertices and faces with each place once and each triangle once, and what was mended.

    The triangles that stay keep their order, and vertices the order in which they first appear, so
    that a mesh with faults and the same mesh without give the same numbers.

    Parameters
    ----------
    vertices
        Positions, shape ``(n, 3)``.
    faces
        Vertex numbers of the triangles, ``(m, 3)``, with m > 0.
    is_soup
        Whether every triangle has vertices of its own, so that they appear in the order of the
        triangles.
    """
    places, numbered = merged(vertices, faces)
    is_flat = flat_triangles(places, numbered)
    n_flat = int(is_flat.sum())
    split, n_split = _without_fillers(places, numbered, is_flat)
    kept = np.flatnonzero(~is_flat)
    first = _first_of_each(split)
    n_twice = len(split) - len(first)
    whole = split[first]
    turned = wound_otherwise(places, whole)
    is_used = np.zeros(len(vertices), bool)
    is_used[faces] = True
    unused = int((~is_used).sum())
    found = Repairs(without_area=n_flat, twice=n_twice, turned=int(turned.sum()), unused=unused)
    if len(whole) == 0:
        raise ValueError("none of its triangles has an area")
    if not (n_flat or n_twice or turned.any()):
        return places, numbered, found
    back = exchanged_corners(places, whole, turned, is_soup=is_soup)
    if n_split:
        whole = np.where(turned[:, None], whole[:, back], whole)
        return *merged(places, whole), found
    # From the vertices of the file, so that those of triangles left out have no place among them.
    own = faces[kept[first]]
    own = np.where(turned[:, None], own[:, back], own)
    if is_soup:
        vertices, own = vertices[own].reshape(-1, 3), np.arange(own.size).reshape(-1, 3)
    return *merged(vertices, own), found


def _first_of_each(faces: IntArray) -> IntArray:
    """Indices of the triangles without an earlier one of the same corners, in their order."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    ordered = corners[order]
    is_new = np.ones(len(faces), bool)
    is_new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return np.sort(order[is_new])


def merged(vertices: Array, faces: IntArray) -> tuple[Array, IntArray]:
    """The vertices that triangles use, each place once, in order of appearance; and the faces."""
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
    return places[first[appearing]], number[faces]


def flat_triangles(vertices: Array, faces: IntArray) -> BoolArray:
    """Which triangles are lines or points, shape ``(m,)``."""
    longest = longest_sides(vertices, faces)
    far = np.abs(vertices).max(axis=1)
    farthest = np.maximum(np.maximum(far[faces[:, 0]], far[faces[:, 1]]), far[faces[:, 2]])
    doubled = lengths(doubled_areas(vertices, faces))
    return np.asarray(doubled <= longest * (FLAT * longest + SINGLE * farthest))


def _without_fillers(vertices: Array, faces: IntArray, is_flat: BoolArray) -> tuple[IntArray, int]:
    """Faces without the flat ones, and how many of these closed a gap.

    One that lies between a long edge and two short ones closes a gap of no width: the triangle at
    the long edge is divided at its third corner instead.
    """
    if not is_flat.any():
        return faces, 0
    longest = _longest(vertices, faces, is_flat)
    rows: list[list[tuple[int, ...]]] = [[tuple(x)] for x in faces.tolist()]
    around: dict[tuple[int, int], list[int]] = {}
    is_corner = np.zeros(int(faces.max()) + 1, bool)
    is_corner[faces[is_flat]] = True
    # What has two corners in common with a flat triangle may be beside it.
    for i in np.flatnonzero(is_corner[faces].sum(axis=1) >= 2).tolist():
        for edge in _edges(rows[i][0]):
            around.setdefault(edge, []).append(i)
    n_split = 0
    for i in np.flatnonzero(is_flat).tolist():
        face = rows[i][0]
        if len(set(face)) < 3:
            continue
        beside = {x: [k for k in around[x] if k != i] for x in _edges(face)}
        if any(len(x) != 1 for x in beside.values()):
            continue
        p, q, r = longest[i]
        (k,) = beside[min(p, q), max(p, q)]
        if is_flat[k] or len(rows[k]) > 1:
            continue
        # In the place of the triangle that is divided, in its own direction.
        rows[k] = [tuple(r if x == y else x for x in rows[k][0]) for y in (p, q)]
        n_split += 1
    chosen = [x for i, own in enumerate(rows) if not is_flat[i] for x in own]
    return np.array(chosen, np.int64).reshape(-1, 3), n_split


def _edges(face: Sequence[int]) -> list[tuple[int, int]]:
    pairs = zip(face, (*face[1:], *face[:1]), strict=True)
    return [(min(x), max(x)) for x in pairs]


def _longest(vertices: Array, faces: IntArray, chosen: BoolArray) -> dict[int, tuple[int, ...]]:
    """The ends of the longest edge of each triangle chosen, and its third corner."""
    found = {}
    for i in np.flatnonzero(chosen).tolist():
        corners = vertices[faces[i]]
        k = int(np.argmax(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)))
        found[i] = tuple(faces[i][[k, (k + 1) % 3, (k + 2) % 3]].tolist())
    return found


def wound_otherwise(vertices: Array, faces: IntArray) -> BoolArray:
    """Which triangles are wound unlike most of the area that they are connected with.

    None is if no choice makes all neighbours agree, as on a Moebius strip.
    """
    none = np.zeros(len(faces), bool)
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    n = int(faces.max()) + 1 if len(faces) else 0
    directed, times = np.unique(edges[:, 0] * n + edges[:, 1], return_counts=True)
    if len(directed) == 0 or times.max() == 1:
        return none
    one, other, agrees = _neighbours(faces)
    parts, flips = _signs(len(faces), one // 3, other // 3, agrees)
    area = lengths(doubled_areas(vertices, faces))
    backward = np.bincount(parts, area * flips) > np.bincount(parts, area * ~flips)
    turned = flips ^ backward[parts]
    agreed = agrees == (turned[one // 3] == turned[other // 3])
    return np.asarray(turned if agreed.all() else none)


# A triangle is turned round by exchanging two of its corners.
EXCHANGES = ((2, 1, 0), (0, 2, 1), (1, 0, 2))


def exchanged_corners(
    vertices: Array, faces: IntArray, turned: BoolArray, *, is_soup: bool
) -> tuple[int, ...]:
    """The exchange of two corners that makes the turned triangles most like the others.

    The first corner of a triangle says nothing about the surface, but contact points depend on it,
    since they are found by going through the triangles from corner to corner. Programs number
    corners by a pattern: which corner has the lowest number, and at which sides neighbours meet.
    One of the three exchanges restores it.
    """
    if not turned.any():
        return EXCHANGES[0]

    def likeness(exchange: tuple[int, ...]) -> float:
        own = np.where(turned[:, None], faces[:, exchange], faces)
        if is_soup:
            _, own = merged(vertices[own].reshape(-1, 3), np.arange(own.size).reshape(-1, 3))
        one, other, _ = _neighbours(own)
        ranks, sides = np.argsort(own, axis=1) @ np.array([9, 3, 1]), 3 * (one % 3) + other % 3
        n_turned = turned[one // 3].astype(int) + turned[other // 3]
        return _likelihood(ranks[turned], ranks[~turned]) + _likelihood(
            sides[n_turned == 1], sides[n_turned == 0]
        )

    return max(EXCHANGES, key=likeness)


def _likelihood(values: IntArray, others: IntArray) -> float:
    """Logarithm of how likely values are to come up among others."""
    seen = 1.0 + np.bincount(others, minlength=27)
    return float(np.log(seen / seen.sum())[values].sum())


def _neighbours(faces: IntArray) -> tuple[IntArray, IntArray, BoolArray]:
    """Numbers of the two sides that meet, where two do, and whether they run oppositely.

    The sides of triangle i are 3 i to 3 i + 2.
    """
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    named = ends.min(axis=1) * (int(faces.max()) + 1) + ends.max(axis=1)
    order = np.argsort(named, kind="stable")
    ordered = named[order]
    starts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    pairs = starts[np.diff(np.r_[starts, len(ordered)]) == 2]
    one, other = order[pairs], order[pairs + 1]
    return one, other, ends[one, 0] != ends[other, 0]


def _signs(n: int, one: IntArray, other: IntArray, agrees: BoolArray) -> tuple[IntArray, BoolArray]:
    """The part to which each triangle belongs, and whether it is wound unlike the part's first."""
    # Loaded where triangles are wound unlike each other alone.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Every triangle twice, as it is wound and the other way: those that go together are connected.
    away = np.where(agrees, 0, n)
    rows, columns = np.r_[one, one + n], np.r_[other + away, other + n - away]
    links = coo_array((np.ones(rows.size), (rows, columns)), shape=(2 * n, 2 * n))
    _, sides = connected_components(links, directed=False)
    _, first, parts = np.unique(
        np.minimum(sides[:n], sides[n:]), return_index=True, return_inverse=True
    )
    return parts, sides[:n] != sides[first][parts]


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
        normals = doubled_areas(vertices, faces)
        length = lengths(normals)
        normals /= np.where(length > 0.0, length, 1.0)[:, None]
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
        n = len(self.vertices)
        named, count = np.unique(side_names(self.faces, n), return_counts=True)
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
        have = "vertex has" if len(bad) == 1 else "vertices have"
        raise InputError(
            file,
            f"vertex {bad[0] + 1}",
            f"{len(bad)} {have} a value that is not a finite number",
            "Repair the mesh and export it again.",
        )
    try:
        return surface_of(mesh.vertices, mesh.faces, is_soup=mesh.is_soup, remarks=mesh.remarks)
    except ValueError as error:
        raise InputError(file, "", str(error), "Repair the mesh and export it again.") from error


def surface_of(
    vertices: Array, faces: IntArray, *, is_soup: bool = False, remarks: tuple[str, ...] = ()
) -> Surface:
    """A surface of vertices ``(n, 3)`` [mm] and triangles ``(m, 3)``, mended as files are.

    Parameters
    ----------
    vertices, faces
        Places, and the numbers of the vertices of each triangle from 0.
    is_soup
        Whether every triangle has vertices of its own.
    remarks
        What was odd about where they come from, as clauses.

    Raises
    ------
    ValueError
        If shapes or numbers are not those of a surface.
    """
    whole, triangles = frozen(vertices, None, 3, name="vertices"), frozen_integers(faces)
    _check(whole, triangles)
    places, numbered, found = repaired(whole, triangles, is_soup=is_soup)
    return Surface(vertices=places, faces=numbered, repairs=found + Repairs(remarks=tuple(remarks)))


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
