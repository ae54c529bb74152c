"""Surfaces of few triangles, for drawing where every kilobyte is sent along."""

import numpy as np
from scipy.spatial import cKDTree

from identknee.runs.arrays import Array, IntArray, frozen_integers
from identknee.runs.declare import array, declared
from identknee.subject.surface import Surface

ROUNDS = 12  # of clustering; the patches hardly change after
DECIMALS = 2  # of a mm


@declared
class Mesh:
    """A triangle mesh."""

    vertices: Array = array("Vertices", "vertex", "axis", unit="mm")
    faces: IntArray = array("Vertex numbers of the triangles", "triangle", "axis", dtype=int)


def few_triangles(surface: Surface, number: int) -> Mesh:
    """The surface with about `number` vertices and twice as many triangles, rounded to 0.01 mm.

    Vertices are clustered into patches of nearly equal area, as in [1]_. Each patch becomes a
    vertex, at its centroid or, where it has a part of the rim, in the middle of that part; each
    triangle whose corners lie in three patches joins them. A surface that has no more vertices than
    asked for is only rounded.

    Parameters
    ----------
    surface
        An open or a closed surface.
    number
        How many vertices are wanted.

    References
    ----------
    .. [1] Valette and Chassery (2004), Comput. Graph. Forum 23(3), 381-389.
           https://doi.org/10.1111/j.1467-8659.2004.00769.x
    """
    vertices, faces = surface.vertices, surface.faces
    if len(vertices) > number:
        patch, vertices = _patches(surface, number)
        faces = _joining(patch[faces])
    return Mesh(vertices=vertices.round(DECIMALS) + 0.0, faces=faces)


def _patches(surface: Surface, number: int) -> tuple[IntArray, Array]:
    """The patch of every vertex, and the place of every patch [mm]."""
    vertices = surface.vertices
    # A vertex of no triangle weighs next to nothing.
    weight = np.maximum(surface.vertex_areas, 1e-9 * surface.areas.sum())
    # Seeds evenly along the surface's area, in an order that keeps neighbours together.
    order = cKDTree(vertices).indices
    passed = np.cumsum(weight[order]) - 0.5 * weight[order]
    seeds = order[np.searchsorted(passed, (np.arange(number) + 0.5) * weight.sum() / number)]
    centroids = vertices[np.unique(seeds)]
    for _ in range(ROUNDS):
        nearest = cKDTree(centroids).query(vertices)[1]
        used, patch = np.unique(nearest, return_inverse=True)
        area = np.bincount(patch, weight)
        moment = [np.bincount(patch, weight * x, len(used)) for x in vertices.T]
        centroids = np.stack(moment, axis=1) / area[:, None]
    # Patches at the rim reach up to it.
    rim = np.unique(surface.boundary_edges)
    count = np.bincount(patch[rim], minlength=len(used))
    sums = [np.bincount(patch[rim], x, len(used)) for x in vertices[rim].T]
    at_rim = count > 0
    centroids[at_rim] = (np.stack(sums, axis=1) / np.maximum(count, 1)[:, None])[at_rim]
    return np.asarray(patch, np.int64), centroids


def _joining(corners: IntArray) -> IntArray:
    """Triangles between three different patches, each once, turned as it was."""
    a, b, c = corners.T
    between = corners[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(between, axis=1), axis=0, return_index=True)
    return frozen_integers(between[np.sort(first)])
