"""Measures of a surface's soundness, and of how two surfaces lie to each other."""

from typing import Any

import numpy as np

from identknee.mechanics.closest_point import mesh_distance
from identknee.runs.arrays import Array
from identknee.subject.surface import Surface

# Triangles of the closest tenth tell how two surfaces face each other where they are in contact.
CLOSEST_SHARE = 0.1


def count_turned_edges(surface: Surface) -> int:
    """How many edges two triangles run through in the same direction: one is wound wrongly."""
    _, count = np.unique(surface.edges, axis=0, return_counts=True)
    return int((count > 1).sum())


def count_shared_edges(surface: Surface) -> int:
    """How many edges belong to three triangles or more."""
    _, count = np.unique(np.sort(surface.edges, axis=1), axis=0, return_counts=True)
    return int((count > 2).sum())


def count_near_duplicates(surface: Surface, tolerance: float) -> int:
    """How many pairs of vertices lie within `tolerance` [mm] of each other."""
    # Loaded late: it takes longer than a simulation.
    from scipy.spatial import cKDTree

    return len(cKDTree(surface.vertices).query_pairs(tolerance))


def count_slivers(surface: Surface, thinness: float) -> int:
    """How many triangles have a height less than `thinness` times their longest edge."""
    corners = surface.vertices[surface.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return int((2.0 * surface.areas <= thinness * longest**2).sum())


def extent(surface: Surface) -> float:
    """Diagonal of its bounding box [mm]."""
    return float(np.linalg.norm(np.ptp(surface.vertices, axis=0)))


def facing_normals(surface: Surface, other: Surface) -> Array:
    """Mean normal of `surface` where it is closest to `other`, shape ``(3,)``."""
    from scipy.spatial import cKDTree

    centres = surface.vertices[surface.faces].mean(axis=1)
    distance = cKDTree(other.vertices).query(centres)[0]
    is_close = distance <= np.quantile(distance, CLOSEST_SHARE)
    weights = surface.areas[is_close]
    mean: Array = weights @ surface.normals[is_close] / max(weights.sum(), np.finfo(float).tiny)
    return mean


def gap_between(one: Surface, other: Surface) -> float:
    """Smallest distance of two surfaces [mm], 0 where they touch or cross."""
    import fcl

    bodies = [fcl.CollisionObject(_hierarchy(x)) for x in (one, other)]
    if fcl.collide(*bodies, fcl.CollisionRequest(), fcl.CollisionResult()) > 0:
        return 0.0
    return max(float(fcl.distance(*bodies, fcl.DistanceRequest(), fcl.DistanceResult())), 0.0)


def overlap_of(surface: Surface, other: Surface) -> float:
    """How deep the vertices of `surface` lie within `other` at most [mm], 0 if none does."""
    distance = mesh_distance(other.vertices, other.faces)(surface.vertices)
    return max(float(-distance.min()), 0.0)


def _hierarchy(surface: Surface) -> Any:
    import fcl

    model = fcl.BVHModel()
    model.beginModel(len(surface.faces), len(surface.vertices))
    model.addSubModel(surface.vertices, surface.faces)
    model.endModel()
    return model
