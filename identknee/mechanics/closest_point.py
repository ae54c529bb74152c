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
from functools import lru_cache

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
    left one follows it); a leaf has -1 there. The halves of a node differ by one triangle at most,
    so that the nodes of a level have two sizes, and those of a size are split in one step.
    """
    centres, order = corners.mean(axis=1), np.arange(len(corners))
    spans = np.full((_n_nodes(len(corners)), 3), -1, np.int64)
    level = {len(corners): np.zeros((1, 2), np.int64)}  # place of each node, and first triangle
    while level:
        below: dict[int, list[IntArray]] = {}
        for size, nodes in level.items():
            here, first = nodes.T
            spans[here, 0], spans[here, 1] = first, first + size
            if size <= LEAF_SIZE:
                continue
            chosen = order[first[:, None] + np.arange(size)]
            points = centres[chosen]
            axis = np.argmax(np.ptp(points, axis=1), axis=1)
            along = np.take_along_axis(points, axis[:, None, None], axis=2)[:, :, 0]
            half = size // 2
            parted = np.take_along_axis(chosen, np.argpartition(along, half, axis=1), axis=1)
            order[first[:, None] + np.arange(size)] = parted
            right = here + 1 + _n_nodes(half)
            spans[here, 2] = right
            below.setdefault(half, []).append(np.stack([here + 1, first], axis=1))
            below.setdefault(size - half, []).append(np.stack([right, first + half], axis=1))
        level = {size: np.concatenate(found) for size, found in below.items()}
    lowest, highest = corners.min(axis=1)[order], corners.max(axis=1)[order]
    boxes = np.empty((len(spans), 2, 3))
    is_leaf = spans[:, 2] < 0
    # Leaves follow one another as their triangles do.
    starts = spans[is_leaf, 0]
    boxes[is_leaf, 0] = np.minimum.reduceat(lowest, starts)
    boxes[is_leaf, 1] = np.maximum.reduceat(highest, starts)
    inner = np.flatnonzero(~is_leaf)
    sizes = spans[inner, 1] - spans[inner, 0]
    for size in np.unique(sizes):
        here = inner[sizes == size]
        children = boxes[here + 1], boxes[spans[here, 2]]
        boxes[here, 0] = np.minimum(children[0][:, 0], children[1][:, 0])
        boxes[here, 1] = np.maximum(children[0][:, 1], children[1][:, 1])
    return order, boxes, spans


@lru_cache(maxsize=256)
def _n_nodes(size: int) -> int:
    """How many nodes the tree of so many triangles has."""
    if size <= LEAF_SIZE:
        return 1
    return 1 + _n_nodes(size // 2) + _n_nodes(size - size // 2)


def _pseudonormals(vertices: Array, faces: IntArray) -> tuple[Array, BoolArray]:
    """Normals (m, 7, 3) of face, edges 01 12 20 and corners of each triangle; which are rim."""
    corner = vertices[faces]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-300)
    normals = np.empty((len(faces), 7, 3))
    normals[:, 0] = face
    on_rim = np.zeros((len(faces), 7), bool)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    # Whole numbers sort ten times as fast as pairs of them.
    named = edges[:, 0] * len(vertices) + edges[:, 1]
    _, which, count = np.unique(named, return_inverse=True, return_counts=True)
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
