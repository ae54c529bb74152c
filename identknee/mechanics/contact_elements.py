"""The contact near a pose it was expanded at: elements, their sums, and where the force acts."""

import math

import numpy as np

from identknee.mechanics.compiled import compiled, compiled_into_callers, compiled_once
from identknee.mechanics.distance_field import REFERENCE_DEPTH
from identknee.mechanics.elements import NOTHING, added
from identknee.mechanics.memory import FIRST_ROUNDED, N_LISTED, N_LISTINGS, N_TOUCHING, NEAR_CELLS


@compiled_into_callers
def effective_depth(depth, exponent, rounding):
    """Effective depth of contact, its derivative, and the integral of its power over depth.

    The integral is given for ``felt^exponent``, divided by ``felt^(exponent - 1)``, by which the
    caller multiplies the spring.
    """
    reach = max(depth + rounding, 0.0)
    is_rounded = depth < rounding
    steepness = reach / (2.0 * rounding) if rounding > 0.0 else 0.0
    felt = 0.5 * reach * steepness if is_rounded else max(depth, 0.0)
    # What the rounded part holds more than the law would up to the same depth.
    more = rounding * rounding / ((exponent + 1.0) * (2.0 * exponent + 1.0))
    if exponent != 1.0 and rounding > 0.0 and depth > 0.0:
        more *= (rounding / depth) ** (exponent - 1.0)
    whole = felt * felt / (exponent + 1.0) + more
    work = felt * reach / (2.0 * exponent + 1.0) if is_rounded else whole
    return felt, steepness if is_rounded else 1.0, work


@compiled_into_callers
def contact_element(expansion, i, R, t, exponent, rounding):
    """Point (3), gradient (3) and D (6) of an expanded point at a pose near by; depth, energy.

    The force of a point is its stiffness times ``felt (felt / REFERENCE_DEPTH)^(exponent - 1)``,
    with the depth as the law feels it.
    """
    y0, y1, y2 = expansion[0, i], expansion[1, i], expansion[2, i]
    x0, x1, x2 = expansion[3, i], expansion[4, i], expansion[5, i]
    spring, distance = expansion[6, i], expansion[7, i]
    gx, gy, gz = expansion[8, i], expansion[9, i], expansion[10, i]
    xx, yy, zz = expansion[11, i], expansion[12, i], expansion[13, i]
    xy, xz, yz = expansion[14, i], expansion[15, i], expansion[16, i]
    p0 = R[0] * y0 + R[1] * y1 + R[2] * y2
    p1 = R[3] * y0 + R[4] * y1 + R[5] * y2
    p2 = R[6] * y0 + R[7] * y1 + R[8] * y2
    x, y, z = p0 + t[0] - x0, p1 + t[1] - x1, p2 + t[2] - x2
    bx, by, bz = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
    distance += x * (gx + 0.5 * bx) + y * (gy + 0.5 * by) + z * (gz + 0.5 * bz)
    gx, gy, gz = gx + bx, gy + by, gz + bz
    felt, steepness, work = effective_depth(-distance, exponent, rounding)
    if exponent != 1.0 and felt > 0.0:
        spring *= (felt / REFERENCE_DEPTH) ** (exponent - 1.0)
    k1, k2 = -spring * felt, spring * exponent * steepness
    return (
        (p0, p1, p2, k1 * gx, k1 * gy, k1 * gz),
        (k2 * gx * gx + k1 * xx, k2 * gy * gy + k1 * yy, k2 * gz * gz + k1 * zz),
        (k2 * gx * gy + k1 * xy, k2 * gx * gz + k1 * xz, k2 * gy * gz + k1 * yz),
        felt,
        spring * work,
    )


@compiled
def sum_contact(law, placed, expansion):
    """Sums over the expanded points at the pose placed last, and their energy."""
    n, R, t = placed.counts[N_TOUCHING], placed.rotation, placed.translation
    exponent, rounding = law
    total, energy = NOTHING, 0.0
    # Written twice, as the compiler keeps a power out of the loop only where there is none.
    if exponent == 1.0:
        for i in range(n):
            first, squares, products, _, stored = contact_element(expansion, i, R, t, 1.0, rounding)
            total = added(total, first, squares, products)
            energy += stored
    else:
        for i in range(n):
            first, squares, products, _, stored = contact_element(
                expansion, i, R, t, exponent, rounding
            )
            total = added(total, first, squares, products)
            energy += stored
    return total, energy


@compiled
def write_contact_forces(law, work):
    """Write how every expanded point is pushed at the pose placed last into `work.pushes`."""
    placed, expansion, pushes = work.placed, work.expansion, work.pushes
    R, t = placed.rotation, placed.translation
    exponent, rounding = law
    for i in range(placed.counts[N_TOUCHING]):
        first, _, _, felt, _ = contact_element(expansion, i, R, t, exponent, rounding)
        for k in range(6):
            pushes[k, i] = first[k]
        pushes[6, i] = felt


@compiled
def contact_centres(contact, work, centres):
    """Write force [N] and centre of force in tibial and femoral axes (7) of every compartment.

    It is that of the pushes last written.
    """
    force_centres(contact.compartment, 0, work.placed.counts[N_TOUCHING], work, centres)


@compiled
def force_centres(owner, begin, end, work, centres):
    """Write the same of the elements from `begin` to `end`, whose points have an owner each."""
    t, expansion = work.placed.translation, work.expansion
    touching, pushes = work.touching, work.pushes
    for c in range(centres.shape[0]):
        total, y0, y1, y2, x0, x1, x2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(begin, end):
            f0, f1, f2 = pushes[3, i], pushes[4, i], pushes[5, i]
            is_here = owner[touching[i]] == c
            force = math.sqrt(f0 * f0 + f1 * f1 + f2 * f2) if is_here else 0.0
            total += force
            y0 += force * expansion[0, i]
            y1 += force * expansion[1, i]
            y2 += force * expansion[2, i]
            x0 += force * pushes[0, i]
            x1 += force * pushes[1, i]
            x2 += force * pushes[2, i]
        share = 1.0 / total if total > 0.0 else 0.0
        centres[c, 0] = total
        centres[c, 1], centres[c, 2], centres[c, 3] = share * y0, share * y1, share * y2
        for k in range(3):
            centres[c, 4 + k] = t[k] if total > 0.0 else 0.0
        centres[c, 4] += share * x0
        centres[c, 5] += share * x1
        centres[c, 6] += share * x2


@compiled
def contact_columns(work, columns, first):
    """Write d gradient / d (ln modulus, exponent) of the contact into `columns`, from `first` on.

    It is that of the pushes last written.
    """
    axes, pushes = work.placed.axes, work.pushes
    for k in range(2):
        f0, f1, f2, m0, m1, m2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(work.placed.counts[N_TOUCHING]):
            felt, w = pushes[6, i], 1.0
            if k == 1:
                w = math.log(felt / REFERENCE_DEPTH) if felt > 0.0 else 0.0
            p0, p1, p2 = pushes[0, i], pushes[1, i], pushes[2, i]
            a0, a1, a2 = w * pushes[3, i], w * pushes[4, i], w * pushes[5, i]
            f0 += a0
            f1 += a1
            f2 += a2
            m0 += p1 * a2 - p2 * a1
            m1 += p2 * a0 - p0 * a2
            m2 += p0 * a1 - p1 * a0
        for a in range(5):
            x, y, z = axes[a, 0], axes[a, 1], axes[a, 2]
            along = x * m0 + y * m1 + z * m2 if a < 2 else x * f0 + y * f1 + z * f2
            columns[a, first + k] = along


# The four weights of a cubic B-spline as polynomials of the place in the cell, lowest power first.
WEIGHTS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0


@compiled
def along_axis(before, here, after, last, place):
    """Value, slope and bend of a cubic B-spline at a place in its cell, from 0 to 1.

    Taken from the differences of its four coefficients, which needs fewer products than weights do.
    """
    first, middle = here - before, after - here
    bend = middle - first
    change = last - after - middle - bend
    slope = 0.5 * (after - before)
    half, third = 0.5 * place, (1.0 / 3.0) * place
    value = here + (1.0 / 6.0) * bend + place * (slope + half * (bend + third * change))
    return value, slope + place * (bend + half * change), bend + place * change


@compiled
def spline_at(c, first, stride_x, stride_y, x, y, z):
    """The spline's value and derivatives (10), in units of the grid, at a place in a cell.

    `first` is where the 4 x 4 x 4 coefficients of the cell begin among all of them, `c`; `x`, `y`
    and `z` are the place in the cell, from 0 to 1.
    """
    f, fx, fy, fz, fxx, fyy, fzz, fxy, fxz, fyz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # Indices without sign need not be asked whether they count from the end, so that the compiler
    # takes the four coefficients along z at a time.
    s, r, start = np.uint64(stride_y), np.uint64(stride_x), np.uint64(first)
    two, three = s + s, s + s + s
    for lane in range(4):
        k = np.uint64(lane)
        w = WEIGHTS[0, k] + z * (WEIGHTS[1, k] + z * (WEIGHTS[2, k] + z * WEIGHTS[3, k]))
        wz = WEIGHTS[1, k] + z * (2.0 * WEIGHTS[2, k] + 3.0 * z * WEIGHTS[3, k])
        wzz = 2.0 * WEIGHTS[2, k] + 6.0 * z * WEIGHTS[3, k]
        i = start + k
        a, ay, ayy = along_axis(c[i], c[i + s], c[i + two], c[i + three], y)
        i += r
        b, by, byy = along_axis(c[i], c[i + s], c[i + two], c[i + three], y)
        i += r
        d, dy, dyy = along_axis(c[i], c[i + s], c[i + two], c[i + three], y)
        i += r
        e, ey, eyy = along_axis(c[i], c[i + s], c[i + two], c[i + three], y)
        v, vx, vxx = along_axis(a, b, d, e, x)
        vy, vxy, _ = along_axis(ay, by, dy, ey, x)
        vyy, _, _ = along_axis(ayy, byy, dyy, eyy, x)
        f += w * v
        fx += w * vx
        fy += w * vy
        fz += wz * v
        fxx += w * vxx
        fyy += w * vyy
        fzz += wzz * v
        fxy += w * vxy
        fxz += wz * vx
        fyz += wz * vy
    return f, fx, fy, fz, fxx, fyy, fzz, fxy, fxz, fyz


@compiled_once
def expand_at(places, coefficients, shape, expansions):
    """Write the spline's value and derivatives, in units of the grid, at places (n, 3) in it."""
    stride_x, stride_y = shape[1] * shape[2], shape[2]
    for i in range(len(places)):
        x, y, z = places[i, 0], places[i, 1], places[i, 2]
        ix, iy, iz = np.int64(x), np.int64(y), np.int64(z)
        first = (ix - 1) * stride_x + (iy - 1) * stride_y + iz - 1
        found = spline_at(coefficients, first, stride_x, stride_y, x - ix, y - iy, z - iz)
        for k in range(10):
            expansions[i, k] = found[k]


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
