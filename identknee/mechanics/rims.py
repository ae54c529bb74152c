"""How far a place on an open sheet is from the sheet's rim."""

import numpy as np

from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared

RIM_MARGIN = 3.0  # mm
FEW = 100  # places that are looked up faster by themselves than scipy is loaded


@declared
class RimDistance:
    """Distance of the vertices of a sheet from its rim."""

    vertices: Array = array("Vertices of the sheet", "vertex", "axis", unit="mm")
    rim: Array = array(
        "Those on the rim; none where the surface is closed", "rim vertex", "axis", unit="mm"
    )

    @property
    def distances(self) -> Array:
        """Straight distance of each vertex to the nearest of the rim [mm]; infinite without one."""
        return self._from_rim(self.vertices)

    def at(self, places: Array) -> Array:
        """Distance from the rim [mm] of the vertex nearest each of `places` (n, 3) [mm]."""
        return self._from_rim(self.vertices[_nearest(self.vertices, places)])

    def _from_rim(self, places: Array) -> Array:
        if not len(self.rim):
            return np.full(len(places), np.inf)
        return np.asarray(np.linalg.norm(places - self.rim[_nearest(self.rim, places)], axis=1))


def _nearest(vertices: Array, places: Array) -> IntArray:
    """Which of the vertices is nearest each place, shape ``(n,)``."""
    if len(places) > FEW:
        # It loads most of scipy.
        from scipy.spatial import cKDTree

        return np.asarray(cKDTree(vertices).query(places)[1])
    middle = vertices.mean(axis=0)
    around = vertices - middle
    halves = 0.5 * np.sum(around**2, axis=1)
    return np.asarray(np.argmin(halves - (places - middle) @ around.T, axis=1))


def rim_distance(vertices: Array, faces: IntArray) -> RimDistance:
    """Distance from the rim of a triangle mesh: vertices ``(n, 3)`` [mm], faces ``(m, 3)``."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    # Whole numbers sort ten times as fast as pairs of them.
    named, count = np.unique(edges[:, 0] * len(vertices) + edges[:, 1], return_counts=True)
    once = named[count == 1]
    is_on_rim = np.zeros(len(vertices), bool)
    is_on_rim[once // len(vertices)] = is_on_rim[once % len(vertices)] = True
    return RimDistance(vertices=vertices, rim=vertices[is_on_rim])


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
