"""What pulls or pushes on the tibia: contact points and ligaments, as elements of one kind.

An element is a point p relative to the tibial origin, the gradient f of its energy with respect to
the point's position and the second derivative D, all in femoral axes. Its energy depends on the
position of its point alone, so one set of sums gives gradient and Hessian of the whole. A row of
the element buffer (12 rows) holds one of p (3), f (3) and D as xx yy zz xy xz yz.
"""

import math

import numpy as np

from identknee.mechanics.compiled import compiled
from identknee.mechanics.contact_law import REFERENCE_DEPTH
from identknee.mechanics.ligament_law import tension
from identknee.mechanics.memory import N_LISTED, N_LISTINGS, N_TOUCHING
from identknee.mechanics.spline_lanes import spline_at

# Bits 0-7 of the `reach` of a cell of the distance field: each eighth that may hold contact. Bit 8:
# the cell is near one that does.
IS_NEAR = 256
NEAR_CELLS = 1  # a cell is near when a cell this many away, along any axis, may hold contact


@compiled
def place_points(n, points, R, t, field, moved):
    """Turn n points (columns) by R; write them (rows 0-2) and their places in the grid (3-5)."""
    origin, inverse = field.origin, 1.0 / field.spacing[0]
    o0, o1, o2 = t[0] - origin[0], t[1] - origin[1], t[2] - origin[2]
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = R[0], R[1], R[2], R[3], R[4], R[5], R[6], R[7], R[8]
    for j in range(n):
        y0, y1, y2 = points[0, j], points[1, j], points[2, j]
        p0 = r0 * y0 + r1 * y1 + r2 * y2
        p1 = r3 * y0 + r4 * y1 + r5 * y2
        p2 = r6 * y0 + r7 * y1 + r8 * y2
        moved[0, j], moved[1, j], moved[2, j] = p0, p1, p2
        moved[3, j] = (p0 + o0) * inverse
        moved[4, j] = (p1 + o1) * inverse
        moved[5, j] = (p2 + o2) * inverse


@compiled
def list_candidates(R, t, contact, field, work):
    """Copy the points that may touch the femur at this pose or within a cell's width of it."""
    points, stiffness, reach = contact.points, contact.stiffness, field.reach
    listed, which, listed_pose = work.listed, work.which, work.listed_pose
    moved, cells = work.moved, work.cells
    nx, ny, nz = field.shape[0], field.shape[1], field.shape[2]
    place_points(points.shape[1], points, R, t, field, moved)
    last_x, last_y, last_z = nx - 1.0, ny - 1.0, nz - 1.0
    # Cells at the grid's faces are not near, so that points beyond them may be looked up there.
    for i in range(points.shape[1]):
        ix = np.int32(min(max(moved[3, i], 0.0), last_x))
        iy = np.int32(min(max(moved[4, i], 0.0), last_y))
        iz = np.int32(min(max(moved[5, i], 0.0), last_z))
        cells[i] = (ix * ny + iy) * nz + iz
    n = 0
    # Without branches: whether a point is near cannot be predicted.
    for i in range(points.shape[1]):
        which[n] = i
        n += reach[cells[i]] >= IS_NEAR
    for j in range(n):
        i = which[j]
        listed[0, j], listed[1, j], listed[2, j] = points[0, i], points[1, i], points[2, i]
        listed[3, j] = stiffness[i]
    work.counts[N_LISTED] = n
    work.counts[N_LISTINGS] += 1
    for j in range(9):
        listed_pose[j] = R[j]
    for j in range(3):
        listed_pose[9 + j] = t[j]


@compiled
def list_is_valid(R, t, radius, spacing, work):
    """Whether no point has moved farther than the list of candidates allows for."""
    listed_pose = work.listed_pose
    if work.counts[N_LISTED] < 0:
        return False
    turn = 0.0
    for j in range(9):
        turn += (R[j] - listed_pose[j]) ** 2
    move = 0.0
    for j in range(3):
        move += (t[j] - listed_pose[9 + j]) ** 2
    # A turn moves a point by at most its radius times the norm of R - R', sqrt(turn / 2).
    return math.sqrt(0.5 * turn) * radius + math.sqrt(move) < NEAR_CELLS * spacing


@compiled
def contact_elements(R, t, law, field, work):
    """Write an element for every point that may touch the femur; return their number and energy."""
    reach, listed, moved, which = field.reach, work.listed, work.moved, work.which
    elements, fractions, touching = work.elements, work.fractions, work.touching
    cells, eighths = work.cells, work.eighths
    ny, nz = field.shape[1], field.shape[2]
    stride_x, stride_y = ny * nz, nz
    n_listed = work.counts[N_LISTED]
    place_points(n_listed, listed, R, t, field, moved)
    for j in range(n_listed):
        # Listed points stay inside the grid: cells near its faces hold no contact and are not near.
        x, y, z = moved[3, j], moved[4, j], moved[5, j]
        ix, iy, iz = np.int32(x), np.int32(y), np.int32(z)
        cells[j] = ix * stride_x + iy * stride_y + iz
        x, y, z = 2.0 * (x - ix), 2.0 * (y - iy), 2.0 * (z - iz)
        eighths[j] = 4 * np.int32(x) + 2 * np.int32(y) + np.int32(z)
    n = 0
    # Without branches: whether a point may touch cannot be predicted.
    for j in range(n_listed):
        touching[n] = j
        n += (reach[cells[j]] >> eighths[j]) & 1
    for i in range(n):
        j = touching[i]
        x, y, z = moved[3, j], moved[4, j], moved[5, j]
        fractions[0, i], fractions[1, i] = x - np.int32(x), y - np.int32(y)
        fractions[2, i], fractions[3, i] = z - np.int32(z), listed[3, j]
        elements[0, i], elements[1, i], elements[2, i] = moved[0, j], moved[1, j], moved[2, j]
        cells[i] = cells[j] - stride_x - stride_y - 1
        touching[i] = which[j]
    inverse = 1.0 / field.spacing[0]
    energy = spline_elements(n, field.coefficients, stride_x, stride_y, inverse, law, work)
    return n, energy


@compiled
def felt_depth(depth, exponent, rounding):
    """Depth as the pressure feels it, its derivative, and the integral of its power over depth.

    The integral is given for ``felt^exponent``, divided by ``felt^(exponent - 1)``, by which the
    caller multiplies the spring.
    """
    if depth >= rounding and depth > 0.0:
        if rounding == 0.0:
            return depth, 1.0, depth * depth / (exponent + 1.0)
        # What the rounded part holds more than the law would up to the same depth.
        more = (rounding / depth) ** (exponent - 1.0) * rounding * rounding
        more /= (exponent + 1.0) * (2.0 * exponent + 1.0)
        return depth, 1.0, depth * depth / (exponent + 1.0) + more
    reach = depth + rounding
    if reach <= 0.0:
        return 0.0, 0.0, 0.0
    felt = reach * reach / (4.0 * rounding)
    return felt, reach / (2.0 * rounding), felt * reach / (2.0 * exponent + 1.0)


@compiled
def spline_weights(u, weights, i, first):
    """Write the cubic B-spline weights at the place u in a cell, and their two derivatives."""
    a = 1.0 - u
    w0, w3 = a * a * a / 6.0, u * u * u / 6.0
    w1 = (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0
    weights[i, first], weights[i, first + 1] = w0, w1
    weights[i, first + 2], weights[i, first + 3] = 1.0 - w0 - w1 - w3, w3
    d0, d3 = -a * a / 2.0, u * u / 2.0
    d1 = (3.0 * u * u - 4.0 * u) / 2.0
    weights[i, first + 4], weights[i, first + 5] = d0, d1
    weights[i, first + 6], weights[i, first + 7] = -d0 - d1 - d3, d3
    weights[i, first + 8], weights[i, first + 9] = a, 3.0 * u - 2.0
    weights[i, first + 10], weights[i, first + 11] = 1.0 - 3.0 * u, u


@compiled
def spline_elements(n, coefficients, stride_x, stride_y, inverse, law, work):
    """Write f and D of n contact points from the distance spline; return their energy.

    `law` is the exponent and the rounding of the contact law: the force of a point is its stiffness
    times ``felt (felt / REFERENCE_DEPTH)^(exponent - 1)``, with the depth as the law feels it.
    """
    exponent, rounding = law
    elements, fractions, cells, weights = work.elements, work.fractions, work.cells, work.weights
    for i in range(n):
        spline_weights(fractions[0, i], weights, i, 0)
        spline_weights(fractions[1, i], weights, i, 12)
        spline_weights(fractions[2, i], weights, i, 24)
    energy = 0.0
    for i in range(n):
        d, gx, gy, gz, hxx, hyy, hzz, hxy, hxz, hyz = spline_at(
            coefficients, cells[i], stride_x, stride_y, weights, i
        )
        felt, steepness, work_done = felt_depth(-d, exponent, rounding)
        spring = fractions[3, i]
        if exponent != 1.0 and felt > 0.0:
            spring *= (felt / REFERENCE_DEPTH) ** (exponent - 1.0)
        energy += spring * work_done
        k1 = -spring * felt * inverse
        k2 = spring * inverse * inverse
        bend = exponent * steepness
        elements[3, i], elements[4, i], elements[5, i] = k1 * gx, k1 * gy, k1 * gz
        elements[6, i] = k2 * (bend * gx * gx - felt * hxx)
        elements[7, i] = k2 * (bend * gy * gy - felt * hyy)
        elements[8, i] = k2 * (bend * gz * gz - felt * hzz)
        elements[9, i] = k2 * (bend * gx * gy - felt * hxy)
        elements[10, i] = k2 * (bend * gx * gz - felt * hxz)
        elements[11, i] = k2 * (bend * gy * gz - felt * hyz)
        elements[12, i] = felt
    return energy


@compiled
def line_shape(e0, e1, e2, wrap_offset, place, shape):
    """Write length (1), gradient (3) and Hessian (xx yy zz xy xz yz) of a line into `shape`.

    The line runs to (e0, e1, e2) from the origin; at the share `place` of the way back it is pushed
    aside by `wrap_offset` along z.
    """
    if wrap_offset == 0.0:
        length = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        g0, g1, g2 = e0 / length, e1 / length, e2 / length
        shape[0], shape[1], shape[2], shape[3] = length, g0, g1, g2
        a = 1.0 / length
        shape[4], shape[5], shape[6] = a - a * g0 * g0, a - a * g1 * g1, a - a * g2 * g2
        shape[7], shape[8], shape[9] = -a * g0 * g1, -a * g0 * g2, -a * g1 * g2
        return
    for k in range(10):
        shape[k] = 0.0
    for part in range(2):
        share, aside = (place, -wrap_offset) if part == 0 else (1.0 - place, wrap_offset)
        x, y, z = share * e0, share * e1, share * e2 + aside
        length = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        shape[0] += length
        shape[1] += share * x
        shape[2] += share * y
        shape[3] += share * z
        a = share * share / length
        shape[4] += a - a * x * x
        shape[5] += a - a * y * y
        shape[6] += a - a * z * z
        shape[7] -= a * x * y
        shape[8] -= a * x * z
        shape[9] -= a * y * z


@compiled
def line_force(strain, stiffness, transition):
    """Force of a line, its slope with strain and its integral over strain.

    A ligament's, or that of a spring which also pushes where `transition` is negative.
    """
    if transition < 0.0:
        return stiffness * strain, stiffness, 0.5 * stiffness * strain * strain
    return tension(strain, stiffness, transition)


@compiled
def ligament_elements(R, t, ligaments, n, elements, shape):
    """Append an element for every ligament; return the new number of elements and their energy."""
    femoral, tibial, properties = ligaments
    energy = 0.0
    for i in range(femoral.shape[0]):
        y0, y1, y2 = tibial[i, 0], tibial[i, 1], tibial[i, 2]
        p0 = R[0] * y0 + R[1] * y1 + R[2] * y2
        p1 = R[3] * y0 + R[4] * y1 + R[5] * y2
        p2 = R[6] * y0 + R[7] * y1 + R[8] * y2
        e0 = p0 + t[0] - femoral[i, 0]
        e1 = p1 + t[1] - femoral[i, 1]
        e2 = p2 + t[2] - femoral[i, 2]
        line_shape(e0, e1, e2, properties[i, 4], properties[i, 5], shape)
        slack_length = properties[i, 2] / (1.0 + properties[i, 1])
        strain = shape[0] / slack_length - 1.0
        force, slope, work = line_force(strain, properties[i, 0], properties[i, 3])
        energy += slack_length * work
        b = slope / slack_length
        g0, g1, g2 = shape[1], shape[2], shape[3]
        elements[0, n], elements[1, n], elements[2, n] = p0, p1, p2
        elements[3, n], elements[4, n], elements[5, n] = force * g0, force * g1, force * g2
        elements[6, n] = force * shape[4] + b * g0 * g0
        elements[7, n] = force * shape[5] + b * g1 * g1
        elements[8, n] = force * shape[6] + b * g2 * g2
        elements[9, n] = force * shape[7] + b * g0 * g1
        elements[10, n] = force * shape[8] + b * g0 * g2
        elements[11, n] = force * shape[9] + b * g1 * g2
        n += 1
    return n, energy


@compiled
def turn_elements(n, turn, elements):
    """Turn the first n elements from the axes of the field into those of poses, by `turn` (9)."""
    a, b, c = turn[0], turn[1], turn[2]
    d, e, f = turn[3], turn[4], turn[5]
    g, h, i = turn[6], turn[7], turn[8]
    for k in range(n):
        for first in range(0, 6, 3):
            x, y, z = elements[first, k], elements[first + 1, k], elements[first + 2, k]
            elements[first, k] = a * x + d * y + g * z
            elements[first + 1, k] = b * x + e * y + h * z
            elements[first + 2, k] = c * x + f * y + i * z
        xx, yy, zz = elements[6, k], elements[7, k], elements[8, k]
        xy, xz, yz = elements[9, k], elements[10, k], elements[11, k]
        x0, y0, z0 = a * xx + d * xy + g * xz, a * xy + d * yy + g * yz, a * xz + d * yz + g * zz
        x1, y1, z1 = b * xx + e * xy + h * xz, b * xy + e * yy + h * yz, b * xz + e * yz + h * zz
        x2, y2, z2 = c * xx + f * xy + i * xz, c * xy + f * yy + i * yz, c * xz + f * yz + i * zz
        elements[6, k] = x0 * a + y0 * d + z0 * g
        elements[7, k] = x1 * b + y1 * e + z1 * h
        elements[8, k] = x2 * c + y2 * f + z2 * i
        elements[9, k] = x0 * b + y0 * e + z0 * h
        elements[10, k] = x0 * c + y0 * f + z0 * i
        elements[11, k] = x1 * c + y1 * f + z1 * i


@compiled
def sum_elements(n, elements, sums):
    """Write the sums over elements: f (3), f p^T (9), D (6), D [e_k x p] (9), their moment (6)."""
    f0, f1, f2 = 0.0, 0.0, 0.0
    t00, t01, t02, t10, t11, t12, t20, t21, t22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    dxx, dyy, dzz, dxy, dxz, dyz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    b00, b01, b02, b10, b11, b12, b20, b21, b22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    c00, c11, c22, c01, c02, c12 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        p0, p1, p2 = elements[0, i], elements[1, i], elements[2, i]
        a0, a1, a2 = elements[3, i], elements[4, i], elements[5, i]
        xx, yy, zz = elements[6, i], elements[7, i], elements[8, i]
        xy, xz, yz = elements[9, i], elements[10, i], elements[11, i]
        f0 += a0
        f1 += a1
        f2 += a2
        t00 += a0 * p0
        t01 += a0 * p1
        t02 += a0 * p2
        t10 += a1 * p0
        t11 += a1 * p1
        t12 += a1 * p2
        t20 += a2 * p0
        t21 += a2 * p1
        t22 += a2 * p2
        dxx += xx
        dyy += yy
        dzz += zz
        dxy += xy
        dxz += xz
        dyz += yz
        g00, g10, g20 = p1 * xz - p2 * xy, p1 * yz - p2 * yy, p1 * zz - p2 * yz
        g01, g11, g21 = p2 * xx - p0 * xz, p2 * xy - p0 * yz, p2 * xz - p0 * zz
        g02, g12, g22 = p0 * xy - p1 * xx, p0 * yy - p1 * xy, p0 * yz - p1 * xz
        b00 += g00
        b01 += g01
        b02 += g02
        b10 += g10
        b11 += g11
        b12 += g12
        b20 += g20
        b21 += g21
        b22 += g22
        c00 += p1 * g20 - p2 * g10
        c01 += p1 * g21 - p2 * g11
        c02 += p1 * g22 - p2 * g12
        c11 += p2 * g01 - p0 * g21
        c12 += p2 * g02 - p0 * g22
        c22 += p0 * g12 - p1 * g02
    sums[0], sums[1], sums[2] = f0, f1, f2
    sums[3], sums[4], sums[5] = t00, t01, t02
    sums[6], sums[7], sums[8] = t10, t11, t12
    sums[9], sums[10], sums[11] = t20, t21, t22
    sums[12], sums[13], sums[14] = dxx, dxy, dxz
    sums[15], sums[16], sums[17] = dxy, dyy, dyz
    sums[18], sums[19], sums[20] = dxz, dyz, dzz
    sums[21], sums[22], sums[23] = b00, b01, b02
    sums[24], sums[25], sums[26] = b10, b11, b12
    sums[27], sums[28], sums[29] = b20, b21, b22
    sums[30], sums[31], sums[32] = c00, c01, c02
    sums[33], sums[34], sums[35] = c01, c11, c12
    sums[36], sums[37], sums[38] = c02, c12, c22


@compiled
def contact_centres(contact, work, centres):
    """Write force [N] and centre of force in tibial and femoral axes (7) of every compartment.

    The contact elements are those of the pose evaluated last.
    """
    points, compartment = contact.points, contact.compartment
    elements, t, touching = work.elements, work.translation, work.touching
    for c in range(centres.shape[0]):
        for k in range(7):
            centres[c, k] = 0.0
    for n in range(work.counts[N_TOUCHING]):
        i = touching[n]
        c = compartment[i]
        force = math.sqrt(elements[3, n] ** 2 + elements[4, n] ** 2 + elements[5, n] ** 2)
        centres[c, 0] += force
        for k in range(3):
            centres[c, 1 + k] += force * points[k, i]
            centres[c, 4 + k] += force * (elements[k, n] + t[k])
    for c in range(centres.shape[0]):
        if centres[c, 0] > 0.0:
            for k in range(1, 7):
                centres[c, k] /= centres[c, 0]
