"""The signed distance to a femur, shared by the contact and the check of one knee."""

from collections.abc import Callable
from functools import lru_cache

from identknee.mechanics.closest_point import mesh_distance
from identknee.runs.declare import Array
from identknee.subject.knee import Frame
from identknee.subject.surface import Surface


# Sorting the triangles of a fine surface takes seconds and hundreds of MB, so the last is kept.
@lru_cache(maxsize=1)
def distance_to_femur(femur: Surface, frame: Frame) -> Callable[[Array], Array]:
    """A function that gives the signed distance [mm] of points in the axes of `frame`."""
    return mesh_distance(frame.to_local(femur.vertices), femur.faces)
