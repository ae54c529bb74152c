"""Insertions on the surface of a bone: how well they are known along it and across it."""

import numpy as np
from scipy.spatial import cKDTree

from identknee.runs.arrays import Array
from identknee.runs.errors import ValueRefused
from identknee.subject.knee import BONES, Knee
from identknee.subject.surface import Surface

# The normal of a surface is that of the triangles within this distance, the size of an insertion.
PATCH_MM = 5.0


def surface_normal(surface: Surface, place: Array) -> Array:
    """Unit normal of a surface near a place, shape ``(3,)``.

    The mean over triangles within 5 mm of the nearest one, weighted by their areas.

    Parameters
    ----------
    surface
        The surface of a bone.
    place
        A place near it [mm], shape ``(3,)``.
    """
    middles = surface.vertices[surface.faces].mean(axis=1)
    tree = cKDTree(middles)
    nearest = middles[int(tree.query(place)[1])]
    near = tree.query_ball_point(nearest, PATCH_MM)
    normal = surface.areas[near] @ surface.normals[near]
    return np.asarray(normal / np.linalg.norm(normal))


def insertion_covariance(knee: Knee, ligament: str, bone: str) -> Array:
    """Covariance of an insertion along the axes of its bone [mm^2], shape ``(3, 3)``.

    Where it is better or worse known across the surface of the bone than along it, one principal
    axis is the normal of that surface.

    Raises
    ------
    ValueError
        If that is stated and the knee has no surfaces of the bones.
    """
    stated = knee.uncertainty
    if not stated.insertions_normal_mm:
        return stated.insertion_covariance(ligament, bone)
    if knee.bones is None:
        raise ValueRefused(
            f"insertions across the bone are uncertain by {stated.insertions_normal_mm:g} mm, and "
            f"{knee.name} has no surfaces of the bones",
            "add femur_bone and tibia_bone to [surfaces], or state one size for all directions",
        )
    i = BONES.index(bone)
    frame = (knee.femur_frame, knee.tibia_frame)[i]
    normal = frame.axes @ surface_normal(knee.bones[i], getattr(knee.ligament(ligament), bone))
    across = np.outer(normal, normal)
    along = stated.insertion_covariance(ligament, bone)[0, 0]
    return np.asarray(along * (np.eye(3) - across) + stated.insertions_normal_mm**2 * across)
