"""What pulls or pushes on the tibia, contact points and ligaments alike: elements and their sums.

An element is a point p relative to the tibial origin, the gradient f of its energy with respect to
the point's position and the second derivative D, all in femoral axes. Its energy depends on the
position of its point alone, so one set of sums gives gradient and Hessian of the whole.
"""

import math

from identknee.mechanics.compiled import compiled, compiled_into_callers
from identknee.mechanics.obstacles import straight_shape, wrapped_element


@compiled
def tension(strain, stiffness, transition):
    """Force of a line ligament, its slope with strain and its integral over strain.

    Equation 3 of the paper: quadratic up to twice the transition strain, linear beyond.
    """
    if strain <= 0.0:
        return 0.0, 0.0, 0.0
    if strain <= 2.0 * transition:
        slope = stiffness * strain / (2.0 * transition)
        return 0.5 * slope * strain, slope, slope * strain * strain / 6.0
    over = strain - transition
    return (
        stiffness * over,
        stiffness,
        stiffness * (0.5 * over * over + transition * transition / 6.0),
    )


NOTHING = (0.0,) * 33  # sums over no element


@compiled_into_callers
def added(sums, first, squares, products):
    """Sums over elements with one more: f (3), f p^T (9), D (6), D [e_k x p] (9), moment (6)."""
    f0, f1, f2, t00, t01, t02, t10, t11, t12, t20, t21, t22 = sums[:12]
    dxx, dyy, dzz, dxy, dxz, dyz, b00, b01, b02, b10, b11, b12, b20, b21, b22 = sums[12:27]
    c00, c11, c22, c01, c02, c12 = sums[27:]
    p0, p1, p2, a0, a1, a2 = first
    xx, yy, zz = squares
    xy, xz, yz = products
    g00, g10, g20 = p1 * xz - p2 * xy, p1 * yz - p2 * yy, p1 * zz - p2 * yz
    g01, g11, g21 = p2 * xx - p0 * xz, p2 * xy - p0 * yz, p2 * xz - p0 * zz
    g02, g12, g22 = p0 * xy - p1 * xx, p0 * yy - p1 * xy, p0 * yz - p1 * xz
    return (
        *(f0 + a0, f1 + a1, f2 + a2),
        *(t00 + a0 * p0, t01 + a0 * p1, t02 + a0 * p2),
        *(t10 + a1 * p0, t11 + a1 * p1, t12 + a1 * p2),
        *(t20 + a2 * p0, t21 + a2 * p1, t22 + a2 * p2),
        *(dxx + xx, dyy + yy, dzz + zz, dxy + xy, dxz + xz, dyz + yz),
        *(b00 + g00, b01 + g01, b02 + g02, b10 + g10, b11 + g11, b12 + g12),
        *(b20 + g20, b21 + g21, b22 + g22),
        *(c00 + p1 * g20 - p2 * g10, c11 + p2 * g01 - p0 * g21, c22 + p0 * g12 - p1 * g02),
        *(c01 + p1 * g21 - p2 * g11, c02 + p1 * g22 - p2 * g12, c12 + p2 * g02 - p0 * g22),
    )


@compiled
def seen_from_tibia(sums, first):
    """Sums with the further terms of an element whose energy is that of a femoral point.

    Seen from the tibia such a point w turns with R^T. So its second derivative by rotations about
    a, then b, is b x (a x w) in place of a x (b x w), and a rotation about b with a shift along k
    adds u . (b x e_k), where u is minus the element's gradient.
    """
    b00, b01, b02, b10, b11, b12, b20, b21, b22 = sums[18:27]
    c00, c11, c22, c01, c02, c12 = sums[27:]
    w0, w1, w2, u0, u1, u2 = first
    twice = 2.0 * (u0 * w0 + u1 * w1 + u2 * w2)
    return (
        *sums[:18],
        *(b00, b01 - u2, b02 + u1, b10 + u2, b11, b12 - u0, b20 - u1, b21 + u0, b22),
        *(c00 + 2.0 * u0 * w0 - twice, c11 + 2.0 * u1 * w1 - twice, c22 + 2.0 * u2 * w2 - twice),
        *(c01 + u0 * w1 + u1 * w0, c02 + u0 * w2 + u2 * w0, c12 + u1 * w2 + u2 * w1),
    )


@compiled
def write_sums(total, sums):
    """Write the sums with every element of their symmetric matrices (39)."""
    for k in range(12):
        sums[k] = total[k]
    dxx, dyy, dzz, dxy, dxz, dyz = total[12:18]
    sums[12], sums[13], sums[14] = dxx, dxy, dxz
    sums[15], sums[16], sums[17] = dxy, dyy, dyz
    sums[18], sums[19], sums[20] = dxz, dyz, dzz
    for k in range(9):
        sums[21 + k] = total[18 + k]
    c00, c11, c22, c01, c02, c12 = total[27:]
    sums[30], sums[31], sums[32] = c00, c01, c02
    sums[33], sums[34], sums[35] = c01, c11, c12
    sums[36], sums[37], sums[38] = c02, c12, c22


@compiled
def line_shape(e0, e1, e2, wrap_offset, place, shape):
    """Write length (1), gradient (3) and Hessian (xx yy zz xy xz yz) of a line into `shape`.

    The line runs to (e0, e1, e2) from the origin; at the share `place` of the way back it is pushed
    aside by `wrap_offset` along z.
    """
    if wrap_offset == 0.0:
        straight_shape(e0, e1, e2, shape)
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
def sum_ligaments(total, ligaments, placed):
    """The sums `total` with every ligament, and the energy of these."""
    R, t, course = placed.rotation, placed.translation, placed.course
    shape = course.shape
    energy = 0.0
    for line in ligaments:
        y0, y1, y2 = line.tibial[0], line.tibial[1], line.tibial[2]
        p0 = R[0] * y0 + R[1] * y1 + R[2] * y2
        p1 = R[3] * y0 + R[4] * y1 + R[5] * y2
        p2 = R[6] * y0 + R[7] * y1 + R[8] * y2
        e0 = p0 + t[0] - line.femoral[0]
        e1 = p1 + t[1] - line.femoral[1]
        e2 = p2 + t[2] - line.femoral[2]
        if line.obstacle_radius > 0.0:
            wrapped_element(line, R, t, course)
            p0, p1, p2 = course.point[0], course.point[1], course.point[2]
        else:
            line_shape(e0, e1, e2, line.wrap_offset, line.wrap_place, shape)
        slack_length = line.reference_length / (1.0 + line.reference_strain)
        strain = shape[0] / slack_length - 1.0
        force, slope, work = line_force(strain, line.stiffness, line.transition)
        energy += slack_length * work
        b = slope / slack_length
        g0, g1, g2 = shape[1], shape[2], shape[3]
        xx, yy, zz = force * shape[4], force * shape[5], force * shape[6]
        xy, xz, yz = force * shape[7], force * shape[8], force * shape[9]
        total = added(
            total,
            (p0, p1, p2, force * g0, force * g1, force * g2),
            (xx + b * g0 * g0, yy + b * g1 * g1, zz + b * g2 * g2),
            (xy + b * g0 * g1, xz + b * g0 * g2, yz + b * g1 * g2),
        )
        if line.obstacle_is_tibial != 0.0:
            total = seen_from_tibia(total, (p0, p1, p2, -force * g0, -force * g1, -force * g2))
    return total, energy
