"""The points at which contact is evaluated: vertices of a surface, few enough to be fast."""

from collections.abc import Sequence

import fast_simplification
import numpy as np

from identknee.mechanics.equilibria import ContactPoints
from identknee.runs.arrays import Array, IntArray

DEFAULT_NUMBER = 1500


def contact_points(
    sheets: Sequence[tuple[Array, IntArray]], number: int | None = DEFAULT_NUMBER
) -> ContactPoints:
    """Vertices of the tibial sheets with their tributary areas, about `number` in all.

    Sheets with more vertices are decimated by quadric edge collapse, never thinned: leaving vertices
    out moved poses five times as much as simplifying the surface they lie on. The areas of a
    decimated sheet are scaled to the area of the whole one.

    Parameters
    ----------
    sheets
        Vertices ``(n, 3)`` [mm] and faces ``(m, 3)`` of each tibial surface.
    number
        How many points are wanted; None for every vertex.
    """
    total = sum(len(vertices) for vertices, _ in sheets)
    points, areas, compartment = [], [], []
    for index, (vertices, faces) in enumerate(sheets):
        area = _triangle_areas(vertices, faces).sum()
        # A few points more than asked for are kept as they are: decimation would gain nothing.
        if number is not None and total > 1.2 * number:
            vertices, faces = _decimated(vertices, faces, round(number * len(vertices) / total))
        tributary = _vertex_areas(vertices, faces)
        points.append(vertices)
        areas.append(tributary * (area / tributary.sum()))
        compartment.append(np.full(len(vertices), index))
    return ContactPoints(
        points=np.concatenate(points),
        areas=np.concatenate(areas),
        compartment=np.concatenate(compartment),
    )


def _decimated(vertices: Array, faces: IntArray, number: int) -> tuple[Array, IntArray]:
    """The sheet with about `number` vertices; an open sheet has about half as many as triangles."""
    share = 1.0 - number / len(vertices)
    # The compiled library works in single precision unless it is given doubles.
    points, triangles = fast_simplification.simplify(
        np.asarray(vertices, np.float64), np.asarray(faces, np.int32), target_reduction=share
    )
    return np.asarray(points, np.float64), np.asarray(triangles, np.int64)


def _triangle_areas(vertices: Array, faces: IntArray) -> Array:
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area: Array = 0.5 * np.linalg.norm(normal, axis=1)
    return area


def _vertex_areas(vertices: Array, faces: IntArray) -> Array:
    area = np.zeros(len(vertices))
    for k in range(3):
        np.add.at(area, faces[:, k], _triangle_areas(vertices, faces) / 3.0)
    return area
