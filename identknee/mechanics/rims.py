"""How far a place on an open sheet is from the sheet's rim."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from identknee.runs.arrays import Array, IntArray, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rim:
    """The rim of a sheet.

    Attributes
    ----------
    vertices
        Its vertices [mm], shape ``(n, 3)``; none where the surface is closed.
    """

    vertices: Array
    _tree: cKDTree = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices, None, 3, name="vertices"))
        object.__setattr__(self, "_tree", cKDTree(self.vertices))

    def distance(self, places: Array) -> Array:
        """Straight distance [mm] of `places` (n, 3) [mm] to the rim; infinite without a rim."""
        return np.asarray(self._tree.query(places)[0], np.float64)


def rim_of(vertices: Array, faces: IntArray) -> Rim:
    """The rim of a triangle mesh: vertices ``(n, 3)`` [mm], faces ``(m, 3)``."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return Rim(vertices=vertices[np.unique(unique[count == 1])])
