"""How far a place on an open sheet is from the sheet's rim."""

from dataclasses import field

import numpy as np
from scipy.spatial import cKDTree

from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared

RIM_MARGIN = 3.0  # mm


@declared
class RimDistance:
    """Distance from the rim of a sheet, known at its vertices."""

    vertices: Array = array("Vertices of the sheet", "vertex", "axis", unit="mm")
    distances: Array = array(
        "Straight distance of each to the nearest vertex of the rim; infinite where the surface is "
        "closed",
        "vertex",
        unit="mm",
    )
    _tree: cKDTree = field(init=False, repr=False)

    def __post_init__(self) -> None:
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


def share_near_rims(centres: Array, femoral: RimDistance, tibial: tuple[RimDistance, ...]) -> Array:
    """Share of each trial's contact force that acts within 3 mm of a rim, shape ``(n,)``.

    Parameters
    ----------
    centres
        For each trial and compartment: force [N], its centre in tibial and in femoral axes [mm],
        shape ``(n, compartments, 7)``.
    femoral, tibial
        The rims, one a tibial surface.
    """
    forces = centres[:, :, 0]
    near = np.zeros(len(centres))
    for c, rim in enumerate(tibial):
        margin = np.minimum(rim.at(centres[:, c, 1:4]), femoral.at(centres[:, c, 4:7]))
        near += forces[:, c] * (margin < RIM_MARGIN)
    total = forces.sum(axis=1)
    share: Array = np.divide(near, total, out=np.zeros(len(centres)), where=total > 0.0)
    return share
