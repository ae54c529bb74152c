"""Meshes as they ought to be: no triangle without area, none twice, all wound alike."""

from collections.abc import Sequence

import numpy as np

from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import declared, entry

# A triangle whose height is less, as a share of its longest edge, is a line; so is one whose height
# is less than single precision resolves so far from the origin.
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
    unused = len(vertices) - len(np.unique(faces))
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
    """Places of the triangles that no earlier one has the same corners as, in their order."""
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
    corners = vertices[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    doubled = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    longest = edges.max(axis=1)
    far = np.abs(corners).max(axis=(1, 2))
    return np.asarray(doubled <= longest * (FLAT * longest + SINGLE * far))


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
    for i in np.flatnonzero(_near_flat(faces, is_flat)).tolist():
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


def _near_flat(faces: IntArray, is_flat: BoolArray) -> BoolArray:
    """Which triangles have two corners in common with a flat one, perhaps."""
    is_corner = np.zeros(int(faces.max()) + 1, bool)
    is_corner[faces[is_flat]] = True
    return np.asarray(is_corner[faces].sum(axis=1) >= 2)


def _longest(vertices: Array, faces: IntArray, chosen: BoolArray) -> dict[int, tuple[int, ...]]:
    """The ends of the longest edge of each triangle chosen, and its third corner."""
    found = {}
    for i in np.flatnonzero(chosen).tolist():
        corners = vertices[faces[i]]
        k = int(np.argmax(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)))
        found[i] = tuple(faces[i][[k, (k + 1) % 3, (k + 2) % 3]].tolist())
    return found


def wound_otherwise(vertices: Array, faces: IntArray) -> BoolArray:
    """Which triangles are wound otherwise than most of the area that is connected with them.

    None is where no way of turning them makes all neighbours agree.
    """
    none = np.zeros(len(faces), bool)
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    n = int(faces.max()) + 1 if len(faces) else 0
    directed, times = np.unique(edges[:, 0] * n + edges[:, 1], return_counts=True)
    if len(directed) == 0 or times.max() == 1:
        return none
    one, other, agrees = _neighbours(faces)
    parts, flips = _signs(len(faces), one // 3, other // 3, agrees)
    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    backward = np.bincount(parts, area * flips) > np.bincount(parts, area * ~flips)
    turned = flips ^ backward[parts]
    agreed = agrees == (turned[one // 3] == turned[other // 3])
    return np.asarray(turned if agreed.all() else none)


# A triangle is turned round by exchanging two of its corners.
EXCHANGES = ((2, 1, 0), (0, 2, 1), (1, 0, 2))


def exchanged_corners(
    vertices: Array, faces: IntArray, turned: BoolArray, *, is_soup: bool
) -> tuple[int, ...]:
    """The exchange of two corners after which the triangles turned are like the others.

    Where a triangle begins says nothing about the surface, but contact points are found by going
    through the triangles from corner to corner. Programs number corners by some pattern: which
    corner has the lowest number, and at which sides neighbours meet. One exchange of the three
    leaves it as it was.
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
    beside: list[list[tuple[int, bool]]] = [[] for _ in range(n)]
    for x, y, alike in zip(one.tolist(), other.tolist(), agrees.tolist(), strict=True):
        beside[x].append((y, alike))
        beside[y].append((x, alike))
    parts, flips = np.full(n, -1), np.zeros(n, bool)
    for first in range(n):
        if parts[first] >= 0:
            continue
        parts[first], waiting = first, [first]
        while waiting:
            here = waiting.pop()
            for there, alike in beside[here]:
                if parts[there] < 0:
                    parts[there], flips[there] = first, flips[here] != (not alike)
                    waiting.append(there)
    return parts, flips
