"""The closest point of a triangle mesh, found in its tree of boxes."""

import numpy as np

from identknee.mechanics.compiled import compiled


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


# How much larger [mm] discs are made, so that rounding leaves nothing outside.
ROUNDED = 1e-9


@compiled
def write_discs(triangles, faces, spans, discs):
    """Write the flat cylinder that holds the triangles of every node: `faces` has their normals.

    Eight numbers: its centre, its axis, half its height, its radius. Those of a node of the tree
    face about the same way, so that it is far thinner than a box with the axes of the knee.
    """
    for node in range(spans.shape[0]):
        first, last = spans[node, 0], spans[node, 1]
        c0, c1, c2, n0, n1, n2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(first, last):
            n0, n1, n2 = n0 + faces[k, 0], n1 + faces[k, 1], n2 + faces[k, 2]
            for j in range(3):
                c0, c1, c2 = (
                    c0 + triangles[k, j, 0],
                    c1 + triangles[k, j, 1],
                    c2 + triangles[k, j, 2],
                )
        share = 1.0 / (3 * (last - first))
        c0, c1, c2 = share * c0, share * c1, share * c2
        length = max(np.sqrt(n0 * n0 + n1 * n1 + n2 * n2), 1e-300)
        n0, n1, n2 = n0 / length, n1 / length, n2 / length
        height, radius = 0.0, 0.0
        for k in range(first, last):
            for j in range(3):
                q0, q1, q2 = (
                    triangles[k, j, 0] - c0,
                    triangles[k, j, 1] - c1,
                    triangles[k, j, 2] - c2,
                )
                along = q0 * n0 + q1 * n1 + q2 * n2
                q0, q1, q2 = q0 - along * n0, q1 - along * n1, q2 - along * n2
                height, radius = max(height, abs(along)), max(radius, q0 * q0 + q1 * q1 + q2 * q2)
        disc = discs[node]
        disc[0], disc[1], disc[2], disc[3], disc[4], disc[5] = c0, c1, c2, n0, n1, n2
        disc[6], disc[7] = height + ROUNDED, np.sqrt(radius) + ROUNDED


@compiled
def disc_distance(p0, p1, p2, disc):
    """Squared distance of a point to a flat cylinder."""
    q0, q1, q2 = p0 - disc[0], p1 - disc[1], p2 - disc[2]
    along = q0 * disc[3] + q1 * disc[4] + q2 * disc[5]
    q0, q1, q2 = q0 - along * disc[3], q1 - along * disc[4], q2 - along * disc[5]
    across = max(np.sqrt(q0 * q0 + q1 * q1 + q2 * q2) - disc[7], 0.0)
    above = max(abs(along) - disc[6], 0.0)
    return above * above + across * across


@compiled
def signed_distances(points, triangles, tree, features, work, result):
    """Write the signed distance of every point to the mesh into `result`.

    Boxes decide which child is looked at first, discs whether a node is looked at.
    """
    boxes, discs, spans = tree
    numbers, normals, on_rim = features
    stack, distances, closest, best_point = work
    best_triangle = 0
    for i in range(points.shape[0]):
        p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
        # The last point's triangle is a good first bound where points come along grid lines.
        best_feature = closest_on_triangle(p0, p1, p2, triangles[best_triangle], best_point)
        best = (p0 - best_point[0]) ** 2 + (p1 - best_point[1]) ** 2 + (p2 - best_point[2]) ** 2
        stack[0], distances[0] = 0, 0.0
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if distances[depth] >= best or disc_distance(p0, p1, p2, discs[node]) >= best:
                continue
            far = spans[node, 2]
            if far >= 0:
                near = node + 1
                to_near, to_far = (
                    box_distance(p0, p1, p2, boxes[near]),
                    box_distance(p0, p1, p2, boxes[far]),
                )
                if to_near >= to_far:
                    near, far, to_near, to_far = far, near, to_far, to_near
                if to_far < best:
                    stack[depth], distances[depth] = far, to_far
                    depth += 1
                if to_near < best:
                    stack[depth], distances[depth] = near, to_near
                    depth += 1
                continue
            for k in range(spans[node, 0], spans[node, 1]):
                feature = closest_on_triangle(p0, p1, p2, triangles[k], closest)
                squared = (p0 - closest[0]) ** 2 + (p1 - closest[1]) ** 2 + (p2 - closest[2]) ** 2
                if squared < best:
                    best, best_feature, best_triangle = squared, feature, k
                    best_point[0], best_point[1], best_point[2] = closest[0], closest[1], closest[2]
        closest_feature = numbers[best_triangle, best_feature]
        height = (
            (p0 - best_point[0]) * normals[closest_feature, 0]
            + (p1 - best_point[1]) * normals[closest_feature, 1]
            + (p2 - best_point[2]) * normals[closest_feature, 2]
        )
        if on_rim[closest_feature]:
            result[i] = height + np.sqrt(max(best - height * height, 0.0))
        else:
            result[i] = np.sqrt(best) if height >= 0.0 else -np.sqrt(best)
