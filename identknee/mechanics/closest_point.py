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

from identknee.runs.declare import Array, BoolArray, IndexArray, IntArray
from identknee.runs.triangles import blocks, side_names, unit

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
    # The compiler takes half a second to load.
    from identknee.mechanics.closest_triangle import signed_distances, write_discs

    corners = vertices[faces]
    order, boxes, spans = _build_tree(corners)
    triangles = corners[order]
    features = _features(vertices, faces, order)
    discs = np.empty((len(spans), 8))
    write_discs(triangles, features[1][: len(faces)], spans, discs)
    tree = boxes, discs, spans

    def distance(points: Array) -> Array:
        result, points = np.empty(len(points)), np.ascontiguousarray(points)
        work = np.zeros(DEEPEST, np.int64), np.zeros(DEEPEST), np.zeros(3), np.zeros(3)
        signed_distances(points, triangles, tree, features, work, result)
        return result

    return distance


def _build_tree(corners: Array) -> tuple[IntArray, Array, IntArray]:
    """A binary tree of bounding boxes: triangle order, boxes (n, 2, 3), spans (n, 3).

    A span holds the first triangle, the end of its triangles and the index of the right child, -1
    for a leaf; the left child follows its parent. The halves of a node differ by one triangle at
    most. So the nodes of a level have two sizes, and all of one size are split in one step.
    """
    # One row for each axis: numpy is many times faster along rows.
    centres, order = np.empty((3, len(corners))), np.arange(len(corners))
    for part in blocks(len(corners)):
        a, b, c = (corners[part, k] for k in range(3))
        centres[:, part] = ((a + b + c) / 3.0).T
    spans = np.full((_n_nodes(len(corners)), 3), -1, np.int64)
    level = {len(corners): np.zeros((1, 2), np.int64)}  # place of each node, and first triangle
    while level:
        below: dict[int, list[IntArray]] = {}
        for size, nodes in level.items():
            here, first = nodes.T
            spans[here, 0], spans[here, 1] = first, first + size
            if size <= LEAF_SIZE:
                continue
            places = first[:, None] + np.arange(size)
            chosen = order[places]
            along = _along_longest([x[chosen] for x in centres])
            half = size // 2
            order[places] = np.take_along_axis(chosen, np.argpartition(along, half, axis=1), axis=1)
            right = here + 1 + _n_nodes(half)
            spans[here, 2] = right
            below.setdefault(half, []).append(np.stack([here + 1, first], axis=1))
            below.setdefault(size - half, []).append(np.stack([right, first + half], axis=1))
        level = {size: np.concatenate(found) for size, found in below.items()}
    return order, _boxes(corners, order, spans), spans


def _along_longest(coordinates: list[Array]) -> Array:
    """Of points (nodes, size) the coordinate along which each node is longest."""
    axis = np.argmax([x.max(axis=1) - x.min(axis=1) for x in coordinates], axis=0)
    along = coordinates[0]
    for k in (1, 2):
        along[axis == k] = coordinates[k][axis == k]
    return along


def _boxes(corners: Array, order: IntArray, spans: IntArray) -> Array:
    """Lowest and highest corner of the box around each node, ``(n, 2, 3)``."""
    a, b, c = (corners[:, k] for k in range(3))
    lowest = np.minimum(np.minimum(a, b), c)[order]
    highest = np.maximum(np.maximum(a, b), c)[order]
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
    return boxes


@lru_cache(maxsize=256)
def _n_nodes(size: int) -> int:
    """Number of nodes of the tree of `size` triangles."""
    if size <= LEAF_SIZE:
        return 1
    return 1 + _n_nodes(size // 2) + _n_nodes(size - size // 2)


def _features(
    vertices: Array, faces: IntArray, order: IntArray
) -> tuple[IndexArray, Array, BoolArray]:
    """Indices of the features of each triangle, their normals, and which are on the rim.

    The indices (m, 7) are of the face, the edges 01, 12, 20 and the corners. Normals and rim have a
    row for each triangle in `order`, then for each edge, then for each vertex.
    """
    m, n = len(faces), len(vertices)
    face, angles = np.empty((m, 3)), np.empty((3, m))
    for part in blocks(m):
        a, b, c = (vertices[x] for x in faces[part].T)
        face[part], angles[:, part] = unit(np.cross(b - a, c - a)), _corner_angles(a, b, c)
    corners = faces.T.ravel()
    at_vertex = [np.bincount(corners, (angles * x).ravel(), n) for x in face.T]
    named = side_names(faces, n).ravel()
    edges, which, count = np.unique(named, return_inverse=True, return_counts=True)
    at_edge = [np.bincount(which, np.repeat(x, 3), len(edges)) for x in face.T]
    once = edges[count == 1]
    is_rim = np.zeros(n, bool)
    is_rim[once // n] = is_rim[once % n] = True
    numbers = np.empty((m, 7), np.uint32)
    numbers[:, 0], numbers[:, 1:4] = np.arange(m), m + which.reshape(-1, 3)[order]
    numbers[:, 4:] = m + len(edges) + faces[order]
    normals = np.empty((m + len(edges) + n, 3))
    normals[:m], normals[m : m + len(edges)] = face[order], np.stack(at_edge, axis=1)
    normals[m + len(edges) :] = np.stack(at_vertex, axis=1)
    for part in blocks(len(normals)):
        normals[part] = unit(normals[part])
    return numbers, normals, np.concatenate([np.zeros(m, bool), count == 1, is_rim])


def _corner_angles(a: Array, b: Array, c: Array) -> Array:
    """The angle of triangles at each of their corners, ``(3, n)``."""
    found = []
    for here, one, other in ((a, b, c), (b, c, a), (c, a, b)):
        first, second = one - here, other - here
        across = np.linalg.norm(np.cross(first, second), axis=1)
        found.append(np.arctan2(across, np.einsum("ij,ij->i", first, second)))
    return np.stack(found)
