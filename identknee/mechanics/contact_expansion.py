"""The contact points that may touch, with their distance to the femur expanded around a pose."""

import math

import numpy as np

from identknee.mechanics.compiled import compiled, compiled_into_callers
from identknee.mechanics.memory import FIRST_ROUNDED, N_LISTED, N_LISTINGS, N_TOUCHING, NEAR_CELLS
from identknee.mechanics.spline import spline_at

KEPT_GAP = 0.1  # mm; points farther from contact are no part of an expansion


@compiled
def list_is_valid(radius, spacing, placed):
    """Whether no point has moved farther than the list of candidates allows for."""
    R, t, listed_pose = placed.field_rotation, placed.field_translation, placed.listed_pose
    if placed.counts[N_LISTED] < 0:
        return False
    turn = 0.0
    for j in range(9):
        turn += (R[j] - listed_pose[j]) ** 2
    move = 0.0
    for j in range(3):
        move += (t[j] - listed_pose[9 + j]) ** 2
    # A turn moves a point by at most its radius times the norm of R - R', sqrt(turn / 2).
    return math.sqrt(0.5 * turn) * radius + math.sqrt(move) < NEAR_CELLS * spacing


@compiled_into_callers
def bit(bits, k):
    """Bit k of `bits`, 0 or 1."""
    return np.uint64((bits >> k) & np.uint32(1))


@compiled
def list_candidates(contact, field, work):
    """Copy the points that may touch the femur at this pose or within a cell's width of it."""
    placed, shape = work.placed, field.grid.shape
    R, t, listed_pose = placed.field_rotation, placed.field_translation, placed.listed_pose
    points, stiffness, near = contact.points, contact.stiffness, field.near
    listed, which, cells = work.listed, work.which, work.cells
    ny, padded = shape[1], 8 * ((shape[2] + 7) // 8)
    last_x, last_y, last_z = shape[0] - 1.0, shape[1] - 1.0, shape[2] - 1.0
    origin, inverse = field.grid.origin, 1.0 / field.grid.spacing
    o0, o1, o2 = t[0] - origin[0], t[1] - origin[1], t[2] - origin[2]
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = R[0], R[1], R[2], R[3], R[4], R[5], R[6], R[7], R[8]
    # Cells at the grid's faces are not near, so that points beyond them may be looked up there.
    for i in range(points.shape[1]):
        y0, y1, y2 = points[0, i], points[1, i], points[2, i]
        x = (r0 * y0 + r1 * y1 + r2 * y2 + o0) * inverse
        y = (r3 * y0 + r4 * y1 + r5 * y2 + o1) * inverse
        z = (r6 * y0 + r7 * y1 + r8 * y2 + o2) * inverse
        ix = np.int32(min(max(x, 0.0), last_x))
        iy = np.int32(min(max(y, 0.0), last_y))
        iz = np.int32(min(max(z, 0.0), last_z))
        cells[i] = (ix * ny + iy) * padded + iz
    n = np.uint64(0)
    # Without branches: whether a point is near cannot be predicted.
    for i in range(points.shape[1]):
        which[n] = i
        n += bit(near[cells[i] >> np.uint32(3)], cells[i] & np.uint32(7))
    for j in range(np.int64(n)):
        i = which[j]
        listed[0, j], listed[1, j], listed[2, j] = points[0, i], points[1, i], points[2, i]
        listed[3, j] = stiffness[i]
    placed.counts[N_LISTED] = n
    placed.counts[N_LISTINGS] += 1
    for j in range(9):
        listed_pose[j] = R[j]
    for j in range(3):
        listed_pose[9 + j] = t[j]


@compiled
def place_points(n, points, R, t, grid, moved):
    """Write where n points (columns) lie in the grid, in its units."""
    origin, inverse = grid.origin, 1.0 / grid.spacing
    o0, o1, o2 = t[0] - origin[0], t[1] - origin[1], t[2] - origin[2]
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = R[0], R[1], R[2], R[3], R[4], R[5], R[6], R[7], R[8]
    for j in range(n):
        y0, y1, y2 = points[0, j], points[1, j], points[2, j]
        moved[0, j] = (r0 * y0 + r1 * y1 + r2 * y2 + o0) * inverse
        moved[1, j] = (r3 * y0 + r4 * y1 + r5 * y2 + o1) * inverse
        moved[2, j] = (r6 * y0 + r7 * y1 + r8 * y2 + o2) * inverse


@compiled
def expand_contact(law, field, work):
    """Expand the distance of every point that may touch the femur, and count them.

    Around the present pose the distance of a point is known from its value, gradient and Hessian
    here, with an error that grows with the cube of how far it moves.
    """
    placed, grid, rounding = work.placed, field.grid, law[1]
    reach, listed, moved, touching = field.reach, work.listed, work.moved, work.touching
    cells, eighths = work.cells, work.eighths
    stride_x, stride_y = grid.shape[1] * grid.shape[2], grid.shape[2]
    n_listed, first = placed.counts[N_LISTED], FIRST_ROUNDED if rounding > 0.0 else 0
    place_points(n_listed, listed, placed.field_rotation, placed.field_translation, grid, moved)
    for j in range(n_listed):
        # Listed points stay inside the grid: cells near its faces hold no contact and are not near.
        x, y, z = moved[0, j], moved[1, j], moved[2, j]
        ix, iy, iz = np.int32(x), np.int32(y), np.int32(z)
        cells[j] = ix * stride_x + iy * stride_y + iz
        x, y, z = x - ix, y - iy, z - iz
        moved[0, j], moved[1, j], moved[2, j] = x, y, z
        x, y, z = 2.0 * x, 2.0 * y, 2.0 * z
        eighths[j] = first + 4 * np.int32(x) + 2 * np.int32(y) + np.int32(z)
    n = np.uint64(0)
    # Without branches: whether a point may touch cannot be predicted.
    for j in range(n_listed):
        touching[n] = j
        n += bit(reach[cells[j]], eighths[j])
    placed.counts[N_TOUCHING] = expand_spline(
        np.int64(n), stride_x, stride_y, rounding + KEPT_GAP, field, work
    )


@compiled
def expand_spline(n, stride_x, stride_y, gap, field, work):
    """Expand the distance of n listed points by the spline; keep those below `gap`, count them."""
    expansion, moved, listed = work.expansion, work.moved, work.listed
    touching, which, cells = work.touching, work.which, work.cells
    coefficients, inverse = field.coefficients, 1.0 / field.grid.spacing
    square = inverse * inverse
    kept = np.uint64(0)
    for i in range(n):
        j = touching[i]
        x, y, z = moved[0, j], moved[1, j], moved[2, j]
        d, gx, gy, gz, hxx, hyy, hzz, hxy, hxz, hyz = spline_at(
            coefficients,
            cells[j] - stride_x - stride_y - 1,
            stride_x,
            stride_y,
            x,
            y,
            z,
        )
        for k in range(3):
            expansion[k, kept] = listed[k, j]
        expansion[6, kept], expansion[7, kept] = listed[3, j], d
        expansion[8, kept], expansion[9, kept] = inverse * gx, inverse * gy
        expansion[10, kept] = inverse * gz
        expansion[11, kept], expansion[12, kept] = square * hxx, square * hyy
        expansion[13, kept], expansion[14, kept] = square * hzz, square * hxy
        expansion[15, kept], expansion[16, kept] = square * hxz, square * hyz
        touching[kept] = which[j]
        kept += np.uint64(d < gap)
    return np.int64(kept)


@compiled
def place_expansion(n, placed, expansion):
    """Write where the points of the expansion are at the present pose."""
    R, t = placed.rotation, placed.translation
    for i in range(n):
        y0, y1, y2 = expansion[0, i], expansion[1, i], expansion[2, i]
        expansion[3, i] = R[0] * y0 + R[1] * y1 + R[2] * y2 + t[0]
        expansion[4, i] = R[3] * y0 + R[4] * y1 + R[5] * y2 + t[1]
        expansion[5, i] = R[6] * y0 + R[7] * y1 + R[8] * y2 + t[2]


@compiled
def turn_expansion(n, turn, expansion):
    """Turn gradients and Hessians of n points from the axes of the field into those of poses."""
    a, b, c = turn[0], turn[1], turn[2]
    d, e, f = turn[3], turn[4], turn[5]
    g, h, i = turn[6], turn[7], turn[8]
    for k in range(n):
        x, y, z = expansion[8, k], expansion[9, k], expansion[10, k]
        expansion[8, k] = a * x + d * y + g * z
        expansion[9, k] = b * x + e * y + h * z
        expansion[10, k] = c * x + f * y + i * z
        xx, yy, zz = expansion[11, k], expansion[12, k], expansion[13, k]
        xy, xz, yz = expansion[14, k], expansion[15, k], expansion[16, k]
        x0, y0, z0 = a * xx + d * xy + g * xz, a * xy + d * yy + g * yz, a * xz + d * yz + g * zz
        x1, y1, z1 = b * xx + e * xy + h * xz, b * xy + e * yy + h * yz, b * xz + e * yz + h * zz
        x2, y2, z2 = c * xx + f * xy + i * xz, c * xy + f * yy + i * yz, c * xz + f * yz + i * zz
        expansion[11, k] = x0 * a + y0 * d + z0 * g
        expansion[12, k] = x1 * b + y1 * e + z1 * h
        expansion[13, k] = x2 * c + y2 * f + z2 * i
        expansion[14, k] = x0 * b + y0 * e + z0 * h
        expansion[15, k] = x0 * c + y0 * f + z0 * i
        expansion[16, k] = x1 * c + y1 * f + z1 * i
