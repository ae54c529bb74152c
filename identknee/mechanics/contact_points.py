"""The points at which contact is evaluated: centroids of equal patches of the tibial surface."""

from collections.abc import Sequence

import numpy as np

from identknee.mechanics.equilibria import ContactPoints
from identknee.runs.arrays import Array, IntArray

DEFAULT_NUMBER = 1500
MOST_PIECES = 20  # a sheet is cut into about this many pieces a patch, or more
ROUNDS = 40


def contact_points(
    sheets: Sequence[tuple[Array, IntArray]], number: int | None = DEFAULT_NUMBER
) -> ContactPoints:
    """Quadrature points of the tibial sheets with their tributary areas, about `number` in all.

    A surface with more vertices than that is clustered into patches of nearly equal size (Lloyd's
    iteration, as in [1]_), each represented by its centroid and its whole area, so that the depth
    of a patch is right to second order. Where there are no more vertices than asked for, or
    `number` is None, the points are the vertices, each with a third of the triangles around it.

    Parameters
    ----------
    sheets
        Vertices ``(n, 3)`` [mm] and faces ``(m, 3)`` of each tibial surface.
    number
        How many points are wanted; None for every vertex.

    References
    ----------
    .. [1] Valette and Chassery (2004), Comput. Graph. Forum 23(3), 381-389.
           https://doi.org/10.1111/j.1467-8659.2004.00769.x
    """
    total = sum(len(vertices) for vertices, _ in sheets)
    whole = sum(triangle_areas(vertices, faces).sum() for vertices, faces in sheets)
    points, areas, compartment = [], [], []
    for index, (vertices, faces) in enumerate(sheets):
        # A few more than asked for are kept as they are: clustering would gain nothing.
        if number is None or total <= 1.2 * number:
            found, area = vertices, _vertex_areas(vertices, faces)
        else:
            share = triangle_areas(vertices, faces).sum() / whole
            found, area = _patches(vertices, faces, max(1, round(number * share)))
        points.append(found)
        areas.append(area)
        compartment.append(np.full(len(found), index))
    return ContactPoints(
        points=np.concatenate(points),
        areas=np.concatenate(areas),
        compartment=np.concatenate(compartment),
    )


def triangle_areas(vertices: Array, faces: IntArray) -> Array:
    """Area of each triangle [mm2], shape ``(m,)``."""
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area: Array = 0.5 * np.linalg.norm(normal, axis=1)
    return area


def _vertex_areas(vertices: Array, faces: IntArray) -> Array:
    area = np.zeros(len(vertices))
    for k in range(3):
        np.add.at(area, faces[:, k], triangle_areas(vertices, faces) / 3.0)
    return area


def _patches(vertices: Array, faces: IntArray, number: int) -> tuple[Array, Array]:
    """Centroids and areas of `number` patches of nearly equal size."""
    # It loads most of scipy, which surfaces of few vertices do without.
    from scipy.spatial import cKDTree

    corner = vertices[faces]
    while len(corner) < MOST_PIECES * number:
        corner = _quartered(corner)
    pieces = corner.mean(axis=1)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    weight = 0.5 * np.linalg.norm(normal, axis=1)
    # Seeds evenly along the surface's area, in an order that keeps neighbours together.
    order = cKDTree(pieces).indices
    passed = np.cumsum(weight[order]) - 0.5 * weight[order]
    seeds = order[np.searchsorted(passed, (np.arange(number) + 0.5) * weight.sum() / number)]
    centroid = pieces[seeds]
    for _ in range(ROUNDS):
        nearest = cKDTree(centroid).query(pieces)[1]
        total, *sums = (
            np.asarray(np.bincount(nearest, values, len(centroid)), np.float64)
            for values in (weight, *(weight * pieces.T))
        )
        moment = np.stack(sums, axis=1)[total > 0.0]
        area = total[total > 0.0]
        centroid = moment / area[:, None]
    return centroid, area


def _quartered(corner: Array) -> Array:
    """Each triangle cut into four by the middles of its edges; shape ``(4 m, 3, 3)``."""
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    return np.concatenate([np.stack(part, axis=1) for part in parts])
