"""How far a place on an open sheet is from the sheet's rim."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from identknee.runs.arrays import Array, IntArray, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RimDistance:
    """Distance from the rim of a sheet, known at its vertices.

    Attributes
    ----------
    vertices
        Vertices of the sheet [mm], shape ``(n, 3)``.
    distances
        Straight distance of each to the nearest vertex of the rim [mm], shape ``(n,)``; infinite
        where the surface is closed.
    """

    vertices: Array
    distances: Array
    _tree: cKDTree = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices, None, 3, name="vertices"))
        n = len(self.vertices)
        object.__setattr__(self, "distances", frozen(self.distances, n, name="distances"))
        object.__setattr__(self, "_tree", cKDTree(self.vertices))

    def at(self, places: Array) -> Array:
        """Distance from the rim [mm] of the vertex nearest each of `places` (n, 3) [mm]."""
        found: Array = self.distances[self._tree.query(places)[1]]
        return found


def rim_distance(vertices: Array, faces: IntArray) -> RimDistance:
    """Distance from the rim of a triangle mesh: vertices ``(n, 3)`` [mm], faces ``(m, 3)``."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = vertices[np.unique(unique[count == 1])]
    return RimDistance(vertices=vertices, distances=cKDTree(rim).query(vertices)[0])
