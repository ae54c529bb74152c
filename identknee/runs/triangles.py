"""Geometry of many triangles at once, in blocks of rows: normals, areas and sides."""

from collections.abc import Iterator

import numpy as np

from identknee.runs.declare import Array, IntArray

# Rows per block, so that temporary arrays stay small and their memory is used again. For millions
# of rows at once, allocating them takes longer than the arithmetic.
AT_ONCE = 65_536


def blocks(n: int) -> Iterator[slice]:
    """Slices that divide n rows into blocks."""
    return (slice(first, min(first + AT_ONCE, n)) for first in range(0, n, AT_ONCE))


def unit(vectors: Array) -> Array:
    """The vectors (n, 3) normalised to length 1; zero vectors stay zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


def side_names(faces: IntArray, n: int) -> IntArray:
    """A number for each side of triangles (m, 3), equal for sides of equal ends, ``(m, 3)``.

    It is the lower vertex number times `n`, the number of vertices, plus the higher one. Whole
    numbers sort ten times as fast as pairs of them.
    """
    named = np.empty(faces.shape, np.int64)
    for k in range(3):
        one, other = faces[:, k], faces[:, (k + 1) % 3]
        named[:, k] = np.minimum(one, other) * n + np.maximum(one, other)
    return named


def longest_sides(vertices: Array, faces: IntArray) -> Array:
    """Length of the longest side of each triangle, shape ``(m,)``."""
    longest = np.empty(len(faces))
    for part in blocks(len(faces)):
        a, b, c = (vertices[x] for x in faces[part].T)
        sides = [np.linalg.norm(x, axis=1) for x in (a - c, b - a, c - b)]
        longest[part] = np.max(sides, axis=0)
    return longest


def doubled_areas(vertices: Array, faces: IntArray) -> Array:
    """Outward normals of triangles, each as long as twice its area, shape ``(m, 3)``."""
    found = np.empty((len(faces), 3))
    for part in blocks(len(faces)):
        a, b, c = (vertices[x] for x in faces[part].T)
        found[part] = np.cross(b - a, c - a)
    return found


def lengths(vectors: Array) -> Array:
    """Length of each of the vectors (n, 3), shape ``(n,)``."""
    found = np.empty(len(vectors))
    for part in blocks(len(vectors)):
        found[part] = np.linalg.norm(vectors[part], axis=1)
    return found
