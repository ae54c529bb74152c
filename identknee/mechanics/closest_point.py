"""Signed distance to a triangle mesh: an exact compiled closest-point query and a sign that holds.

The sign comes from the angle-weighted pseudonormal of the closest feature [1]_. A cartilage surface
is an open sheet: where the closest feature lies on its rim, the sheet is continued by its tangent
plane and the distance past the rim is added, so that a point which leaves the sheet sideways loses
contact within its own depth.

References
----------
.. [1] Baerentzen and Aanaes (2005), IEEE Trans. Vis. Comput. Graph. 11(3), 243-253.
       https://doi.org/10.1109/TVCG.2005.49
"""

from collections.abc import Callable

import numpy as np

from identknee.runs.arrays import Array, BoolArray, IntArray

LEAF_SIZE = 4
DEEPEST = 128  # levels of a tree: more than any mesh has


def mesh_distance(vertices: Array, faces: IntArray) -> Callable[[Array], Array]:
    """A function that gives the signed distance [mm] of points to a mesh, negative inside.

    Parameters
    ----------
    vertices
        [mm], shape ``(n, 3)``.
    faces
        Corner indices, outward normals by the right-hand rule, shape ``(m, 3)``.
    """
    corners = np.ascontiguousarray(vertices[faces])
    order, boxes, spans = _build_tree(corners)
    normals, on_rim = _pseudonormals(vertices, faces)
    triangles = np.ascontiguousarray(corners[order])
    normals, on_rim = np.ascontiguousarray(normals[order]), np.ascontiguousarray(on_rim[order])

    # The compiler takes half a second to load.
    from identknee.mechanics.closest_triangle import signed_distances

    def distance(points: Array) -> Array:
        result, points = np.empty(len(points)), np.ascontiguousarray(points)
        work = np.zeros(DEEPEST, np.int64), np.zeros(3), np.zeros(3)
        signed_distances(points, triangles, boxes, spans, normals, on_rim, work, result)
        return result

    return distance


def _build_tree(corners: Array) -> tuple[IntArray, Array, IntArray]:
    """A binary tree of bounding boxes: triangle order, boxes (n, 2, 3), spans (n, 3).

    A span holds first and last triangle and, for an inner node, where its right child stands (the
    left one follows it); a leaf has -1 there.
    """
    centres = corners.mean(axis=1)
    order = np.arange(len(corners))
    boxes: list[Array] = []
    spans: list[list[int]] = []

    def build(first: int, last: int) -> None:
        here = len(spans)
        chosen = order[first:last]
        points = corners[chosen].reshape(-1, 3)
        boxes.append(np.stack([points.min(axis=0), points.max(axis=0)]))
        spans.append([first, last, -1])
        if last - first <= LEAF_SIZE:
            return
        axis = int(np.argmax(np.ptp(centres[chosen], axis=0)))
        middle = (first + last) // 2
        order[first:last] = chosen[np.argpartition(centres[chosen, axis], middle - first)]
        build(first, middle)
        spans[here][2] = len(spans)
        build(middle, last)

    build(0, len(corners))
    return order, np.array(boxes), np.array(spans, np.int64)


def _pseudonormals(vertices: Array, faces: IntArray) -> tuple[Array, BoolArray]:
    """Normals (m, 7, 3) of face, edges 01 12 20 and corners of each triangle; which are rim."""
    corner = vertices[faces]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-300)
    normals = np.empty((len(faces), 7, 3))
    normals[:, 0] = face
    on_rim = np.zeros((len(faces), 7), bool)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, which, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    total = np.zeros((len(count), 3))
    np.add.at(total, which, np.repeat(face, 3, axis=0))
    normals[:, 1:4] = total[which].reshape(-1, 3, 3)
    on_rim[:, 1:4] = (count[which] == 1).reshape(-1, 3)
    at_vertex = np.zeros_like(vertices, dtype=float)
    for k in range(3):
        a = corner[:, (k + 1) % 3] - corner[:, k]
        b = corner[:, (k + 2) % 3] - corner[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
        np.add.at(at_vertex, faces[:, k], face * angle[:, None])
    rim_vertex = np.zeros(len(vertices), bool)
    rim_vertex[edges[count[which] == 1]] = True
    normals[:, 4:7] = at_vertex[faces]
    on_rim[:, 4:7] = rim_vertex[faces]
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    return normals, on_rim
