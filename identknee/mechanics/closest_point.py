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

from identknee.mechanics.compiled import compiled, compiled_apart
from identknee.runs.arrays import Array, BoolArray, IntArray

LEAF_SIZE = 4


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

    def distance(points: Array) -> Array:
        result = np.empty(len(points))
        signed_distances(
            np.ascontiguousarray(points), triangles, boxes, spans, normals, on_rim, result
        )
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


@compiled
def closest_on_triangle(p0, p1, p2, corner, closest):
    """Write the closest point of a triangle; return which feature it lies on.

    0 the face, 1-3 the edges 01, 12, 20, 4-6 the corners. Barycentric regions as in Ericson,
    Real-Time Collision Detection (2005), section 5.1.5.
    """
    ab0, ab1, ab2 = (
        corner[1, 0] - corner[0, 0],
        corner[1, 1] - corner[0, 1],
        corner[1, 2] - corner[0, 2],
    )
    ac0, ac1, ac2 = (
        corner[2, 0] - corner[0, 0],
        corner[2, 1] - corner[0, 1],
        corner[2, 2] - corner[0, 2],
    )
    ap0, ap1, ap2 = p0 - corner[0, 0], p1 - corner[0, 1], p2 - corner[0, 2]
    aa, bb, cc = ab0 * ab0 + ab1 * ab1 + ab2 * ab2, 0.0, ac0 * ac0 + ac1 * ac1 + ac2 * ac2
    bb = ab0 * ac0 + ab1 * ac1 + ab2 * ac2
    d1 = ab0 * ap0 + ab1 * ap1 + ab2 * ap2
    d2 = ac0 * ap0 + ac1 * ap1 + ac2 * ap2
    d3, d4 = d1 - aa, d2 - bb
    d5, d6 = d1 - bb, d2 - cc
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w, feature = 0.0, 0.0, 4
    elif d3 >= 0.0 and d4 <= d3:
        v, w, feature = 1.0, 0.0, 5
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w, feature = d1 / (d1 - d3), 0.0, 1
    elif d6 >= 0.0 and d5 <= d6:
        v, w, feature = 0.0, 1.0, 6
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w, feature = 0.0, d2 / (d2 - d6), 3
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v, feature = 1.0 - w, 2
    else:
        total = va + vb + vc
        v, w, feature = vb / total, vc / total, 0
    closest[0] = corner[0, 0] + v * ab0 + w * ac0
    closest[1] = corner[0, 1] + v * ab1 + w * ac1
    closest[2] = corner[0, 2] + v * ab2 + w * ac2
    return feature


@compiled
def box_distance(p0, p1, p2, box):
    """Squared distance of a point to a box."""
    x = max(box[0, 0] - p0, 0.0, p0 - box[1, 0])
    y = max(box[0, 1] - p1, 0.0, p1 - box[1, 1])
    z = max(box[0, 2] - p2, 0.0, p2 - box[1, 2])
    return x * x + y * y + z * z


@compiled_apart
def signed_distances(points, triangles, boxes, spans, normals, on_rim, result):
    """Write the signed distance of every point to the mesh into `result`."""
    stack = np.zeros(128, np.int64)
    closest, best_point = np.zeros(3), np.zeros(3)
    best_triangle = 0
    for i in range(points.shape[0]):
        p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
        # The last point's triangle is a good first bound where points come along grid lines.
        best_feature = closest_on_triangle(p0, p1, p2, triangles[best_triangle], best_point)
        best = (p0 - best_point[0]) ** 2 + (p1 - best_point[1]) ** 2 + (p2 - best_point[2]) ** 2
        stack[0] = 0
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if box_distance(p0, p1, p2, boxes[node]) >= best:
                continue
            right = spans[node, 2]
            if right >= 0:
                if box_distance(p0, p1, p2, boxes[node + 1]) < box_distance(
                    p0, p1, p2, boxes[right]
                ):
                    stack[depth], stack[depth + 1] = right, node + 1
                else:
                    stack[depth], stack[depth + 1] = node + 1, right
                depth += 2
                continue
            for k in range(spans[node, 0], spans[node, 1]):
                feature = closest_on_triangle(p0, p1, p2, triangles[k], closest)
                squared = (p0 - closest[0]) ** 2 + (p1 - closest[1]) ** 2 + (p2 - closest[2]) ** 2
                if squared < best:
                    best, best_feature, best_triangle = squared, feature, k
                    best_point[0], best_point[1], best_point[2] = closest[0], closest[1], closest[2]
        height = (
            (p0 - best_point[0]) * normals[best_triangle, best_feature, 0]
            + (p1 - best_point[1]) * normals[best_triangle, best_feature, 1]
            + (p2 - best_point[2]) * normals[best_triangle, best_feature, 2]
        )
        if on_rim[best_triangle, best_feature]:
            result[i] = height + np.sqrt(max(best - height * height, 0.0))
        else:
            result[i] = np.sqrt(best) if height >= 0.0 else -np.sqrt(best)
