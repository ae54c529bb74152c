"""How far a place on an open sheet is from the sheet's rim."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from identknee.runs.arrays import Array, IntArray, frozen

SPACING = 1.0  # mm
PADDING = 4.0  # mm; how far from the sheet a place may lie and still be looked up


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RimMap:
    """Distance to the rim of a sheet [mm] on a grid around it, looked up at the nearest node.

    Attributes
    ----------
    distance
        Shape ``(nx, ny, nz)``; infinite everywhere for a closed surface.
    origin
        Position of the first node [mm], shape ``(3,)``.
    """

    distance: Array
    origin: Array

    def at(self, points: Array) -> Array:
        """Distance from the rim [mm] of the places on the sheet nearest `points` (n, 3) [mm].

        Points farther than 4 mm from the sheet's bounding box have distance 0.
        """
        index = np.rint((points - self.origin) / SPACING).astype(np.int64)
        inside = np.all((index >= 0) & (index < self.distance.shape), axis=-1)
        clipped = np.clip(index, 0, np.array(self.distance.shape) - 1)
        found = self.distance[clipped[..., 0], clipped[..., 1], clipped[..., 2]]
        return np.where(inside, found, 0.0)


def map_rims(vertices: Array, faces: IntArray) -> RimMap:
    """The rim map of a triangle mesh: vertices ``(n, 3)`` [mm], faces ``(m, 3)``."""
    origin = vertices.min(axis=0) - PADDING
    shape = np.ceil((np.ptp(vertices, axis=0) + 2 * PADDING) / SPACING).astype(int) + 1
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    nearest = cKDTree(vertices).query(origin + SPACING * grid)[1]
    return RimMap(
        distance=frozen(rim_distance(vertices, faces)[nearest], None, None, None, name="distance"),
        origin=frozen(origin, 3, name="origin"),
    )


def rim_distance(vertices: Array, faces: IntArray) -> Array:
    """Straight distance of each vertex to the nearest vertex of the rim [mm], shape ``(n,)``."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = np.unique(unique[count == 1])
    if len(rim) == 0:
        return np.full(len(vertices), np.inf)
    distance: Array = cKDTree(vertices[rim]).query(vertices)[0]
    return distance
