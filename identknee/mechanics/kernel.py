"""The compiled kernel: energy of a pose, its derivatives, and the equilibria along a load path.

Every function takes arrays only. Poses are q = (varus, internal [rad], x, y, z [mm]) of the tibia in
the femur at a fixed flexion, the translation in axes that turn with flexion:
``x_femur = R x_tibia + Rz(-flexion) (x, y, z)`` with ``R = Rz(-flexion) Rx(varus) Ry(internal)``.
Forces are in N, moments in N mm, energies in N mm.

Everything that pulls or pushes on the tibia (contact points, ligaments) is an *element*: a point p
relative to the tibial origin, the gradient f of its energy with respect to the point's position and
the second derivative D, all in femur axes. An element's energy depends on the position of its point
alone, so one set of sums over elements gives gradient and Hessian of the whole.

All functions live in this one module so that editing one recompiles every caller. Groups of arrays
travel as tuples, laid out in `identknee.mechanics.equilibria`:

* ``contact``: points (3, n), their distance from the tibial origin at most (1,), stiffness (n,),
  the compartment each belongs to (n,);
* ``field``: coefficients (flat), reach (flat), origin (3,), spacing (1,), shape (3,);
* ``ligaments``: femoral (m, 3) and tibial (m, 3) insertions, properties (m, 4): stiffness [N],
  reference strain, reference length [mm], transition strain.
"""

import math

import numpy as np

from identknee.mechanics.compiled import compiled
from identknee.mechanics.spline_lanes import spline_at

# One radian of rotation weighs as much as this many millimetres, wherever the two are compared.
ROTATION_SCALE = 40.0
# N; a solve this close takes one Newton step more, unmeasured, which squares the error: far below
# what a difference between two ways of solving may be (1e-9 mm).
RESIDUAL_TOLERANCE = 3e-6
SMALLEST_STEP = 1.0 / 1024.0  # of the way from one node of the load path to the next
LARGEST_MOVE = 6.0  # mm; a corrector that goes farther from its prediction has left the branch
BRANCH_ABSOLUTE = 0.1  # mm; disagreement of a step with its end tangents that is always allowed
BRANCH_RELATIVE = 0.25  # the same, as a share of the step's length
FLOOR_MARGIN = 1e-3  # N/mm; below this stiffness a pose is not unique
SLACK_RESIDUAL = 1e-3  # N; with less than this and no stiffness, the search would creep on for ever
MOST_ITERATIONS = 200
# Bits 0-7 of the `reach` of a cell of the distance field: each eighth that may hold contact. Bit 8:
# the cell is near one that does.
IS_NEAR = 256
NEAR_CELLS = 1  # a cell is near when a cell this many away, along any axis, may hold contact

CONVERGED, FOLD, NO_EQUILIBRIUM, UNCONSTRAINED = 0, 1, 2, 3


@compiled
def rotation(flexion, q, R):
    """Write the rotation of the tibia in the femur into `R` (9)."""
    ca, sa = math.cos(flexion), math.sin(flexion)
    cv, sv = math.cos(q[0]), math.sin(q[0])
    ci, si = math.cos(q[1]), math.sin(q[1])
    m10, m11, m12 = sv * si, cv, -sv * ci
    R[0] = ca * ci + sa * m10
    R[1] = sa * m11
    R[2] = ca * si + sa * m12
    R[3] = -sa * ci + ca * m10
    R[4] = ca * m11
    R[5] = -sa * si + ca * m12
    R[6] = -cv * si
    R[7] = sv
    R[8] = cv * ci


@compiled
def place_points(n, points, R, t, field, moved):
    """Turn n points (columns of `points`) by R; write them (rows 0-2) and their grid places (3-5)."""
    origin, inverse = field[2], 1.0 / field[3][0]
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
    points, stiffness = contact[0], contact[2]
    reach, shape = field[1], field[4]
    listed, which, counts, listed_pose, moved = work[2], work[13], work[3], work[4], work[14]
    nx, ny, nz = shape[0], shape[1], shape[2]
    place_points(points.shape[1], points, R, t, field, moved)
    last_x, last_y, last_z = nx - 1.0, ny - 1.0, nz - 1.0
    n = 0
    # Without branches: whether a point is near cannot be predicted. Cells at the grid's faces are
    # not, so that points beyond them may be looked up there.
    for i in range(points.shape[1]):
        ix = int(min(max(moved[3, i], 0.0), last_x))
        iy = int(min(max(moved[4, i], 0.0), last_y))
        iz = int(min(max(moved[5, i], 0.0), last_z))
        listed[0, n], listed[1, n], listed[2, n] = points[0, i], points[1, i], points[2, i]
        listed[3, n] = stiffness[i]
        which[n] = i
        n += reach[(ix * ny + iy) * nz + iz] >= IS_NEAR
    counts[0] = n
    counts[3] += 1
    for j in range(9):
        listed_pose[j] = R[j]
    for j in range(3):
        listed_pose[9 + j] = t[j]


@compiled
def list_is_valid(R, t, radius, spacing, work):
    """Whether no point has moved farther than the list of candidates allows for."""
    counts, listed_pose = work[3], work[4]
    if counts[0] < 0:
        return False
    turn = 0.0
    for j in range(9):
        turn += (R[j] - listed_pose[j]) ** 2
    move = 0.0
    for j in range(3):
        move += (t[j] - listed_pose[9 + j]) ** 2
    return math.sqrt(turn) * radius + math.sqrt(move) < NEAR_CELLS * spacing


@compiled
def contact_elements(R, t, field, work):
    """Write an element for every point that may touch the femur; return their number and energy."""
    coefficients, reach, shape = field[0], field[1], field[4]
    elements, fractions, listed, counts, cells = work[0], work[1], work[2], work[3], work[5]
    touching, which, moved = work[12], work[13], work[14]
    ny, nz = shape[1], shape[2]
    stride_x, stride_y = ny * nz, nz
    place_points(counts[0], listed, R, t, field, moved)
    n = 0
    for j in range(counts[0]):
        # Listed points stay inside the grid: cells near its faces hold no contact and are not near.
        ix, iy, iz = int(moved[3, j]), int(moved[4, j]), int(moved[5, j])
        cell = ix * stride_x + iy * stride_y + iz
        u0, u1, u2 = moved[3, j] - ix, moved[4, j] - iy, moved[5, j] - iz
        eighth = 4 * int(u0 + u0) + 2 * int(u1 + u1) + int(u2 + u2)
        cells[n] = cell - stride_x - stride_y - 1
        fractions[0, n], fractions[1, n], fractions[2, n] = u0, u1, u2
        fractions[3, n] = listed[3, j]
        elements[0, n], elements[1, n], elements[2, n] = moved[0, j], moved[1, j], moved[2, j]
        touching[n] = which[j]
        n += (reach[cell] >> eighth) & 1
    inverse = 1.0 / field[3][0]
    return n, spline_elements(n, coefficients, stride_x, stride_y, inverse, work)


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
def spline_elements(n, coefficients, stride_x, stride_y, inverse, work):
    """Write f and D of n contact points from the distance spline; return their energy."""
    elements, fractions, cells, weights = work[0], work[1], work[5], work[15]
    for i in range(n):
        spline_weights(fractions[0, i], weights, i, 0)
        spline_weights(fractions[1, i], weights, i, 12)
        spline_weights(fractions[2, i], weights, i, 24)
    energy = 0.0
    for i in range(n):
        d, gx, gy, gz, hxx, hyy, hzz, hxy, hxz, hyz = spline_at(
            coefficients, cells[i], stride_x, stride_y, weights, i
        )
        spring = fractions[3, i] if d < 0.0 else 0.0
        energy += 0.5 * spring * d * d
        k1 = spring * d * inverse
        k2 = spring * inverse * inverse
        elements[3, i], elements[4, i], elements[5, i] = k1 * gx, k1 * gy, k1 * gz
        elements[6, i] = k2 * (gx * gx + d * hxx)
        elements[7, i] = k2 * (gy * gy + d * hyy)
        elements[8, i] = k2 * (gz * gz + d * hzz)
        elements[9, i] = k2 * (gx * gy + d * hxy)
        elements[10, i] = k2 * (gx * gz + d * hxz)
        elements[11, i] = k2 * (gy * gz + d * hyz)
    return energy


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


@compiled
def ligament_elements(R, t, ligaments, n, elements):
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
        length = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        slack_length = properties[i, 2] / (1.0 + properties[i, 1])
        force, slope, work = tension(
            length / slack_length - 1.0, properties[i, 0], properties[i, 3]
        )
        energy += slack_length * work
        a = force / length
        b = slope / slack_length - a
        e0, e1, e2 = e0 / length, e1 / length, e2 / length
        elements[0, n], elements[1, n], elements[2, n] = p0, p1, p2
        elements[3, n], elements[4, n], elements[5, n] = force * e0, force * e1, force * e2
        elements[6, n], elements[7, n], elements[8, n] = a + b * e0 * e0, a + b * e1 * e1, a + b * e2 * e2
        elements[9, n], elements[10, n], elements[11, n] = b * e0 * e1, b * e0 * e2, b * e1 * e2
        n += 1
    return n, energy


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
def bilinear(a, i, M, k, b, j):
    """Row i of `a` times the 3 x 3 matrix at M[k:] times row j of `b`."""
    return (
        a[i, 0] * (M[k] * b[j, 0] + M[k + 1] * b[j, 1] + M[k + 2] * b[j, 2])
        + a[i, 1] * (M[k + 3] * b[j, 0] + M[k + 4] * b[j, 1] + M[k + 5] * b[j, 2])
        + a[i, 2] * (M[k + 6] * b[j, 0] + M[k + 7] * b[j, 1] + M[k + 8] * b[j, 2])
    )


@compiled
def dot(a, i, b, j):
    """Product of row i of `a` with row j of `b`."""
    return a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@compiled
def generalised(flexion, R, t, sums, axes, g, H, h):
    """Turn the sums over elements into gradient g, Hessian H and d g / d flexion.

    Rows of `axes`: 0, 1 the rotation axes of varus and internal rotation, 2-4 the translations,
    5 the axis of flexion, 6 how flexion moves the tibial origin.
    """
    ca, sa = math.cos(flexion), math.sin(flexion)
    axes[0, 0], axes[0, 1], axes[0, 2] = ca, -sa, 0.0
    axes[1, 0], axes[1, 1], axes[1, 2] = R[1], R[4], R[7]
    axes[2, 0], axes[2, 1], axes[2, 2] = ca, -sa, 0.0
    axes[3, 0], axes[3, 1], axes[3, 2] = sa, ca, 0.0
    axes[4, 0], axes[4, 1], axes[4, 2] = 0.0, 0.0, 1.0
    axes[5, 0], axes[5, 1], axes[5, 2] = 0.0, 0.0, -1.0
    axes[6, 0], axes[6, 1], axes[6, 2] = t[1], -t[0], 0.0
    axes[7, 0], axes[7, 1], axes[7, 2] = sums[0], sums[1], sums[2]
    axes[8, 0], axes[8, 1], axes[8, 2] = sums[10] - sums[8], sums[5] - sums[9], sums[6] - sums[4]
    trace = sums[3] + sums[7] + sums[11]
    for i in range(2):
        g[i] = dot(axes, i, axes, 8)
        for j in range(i, 2):
            # d2 p / d a d b = a x (b x p), with a the outer of the two axes.
            H[i, j] = (
                bilinear(axes, i, sums, 30, axes, j)
                + bilinear(axes, j, sums, 3, axes, i)
                - trace * dot(axes, i, axes, j)
            )
            H[j, i] = H[i, j]
        for j in range(2, 5):
            H[j, i] = bilinear(axes, j, sums, 21, axes, i)
            H[i, j] = H[j, i]
        h[i] = (
            bilinear(axes, i, sums, 30, axes, 5)
            + bilinear(axes, 6, sums, 21, axes, i)
            + bilinear(axes, i, sums, 3, axes, 5)
            - trace * dot(axes, i, axes, 5)
        )
    for i in range(2, 5):
        g[i] = dot(axes, i, axes, 7)
        for j in range(i, 5):
            H[i, j] = bilinear(axes, i, sums, 12, axes, j)
            H[j, i] = H[i, j]
        h[i] = bilinear(axes, i, sums, 21, axes, 5) + bilinear(axes, i, sums, 12, axes, 6)
    h[2] += sums[0] * axes[2, 1] - sums[1] * axes[2, 0]
    h[3] += sums[0] * axes[3, 1] - sums[1] * axes[3, 0]


@compiled
def evaluate(flexion, q, load, contact, field, ligaments, work, g, H, h):
    """Energy of a pose; its gradient, Hessian and d gradient / d flexion are written to g, H, h."""
    elements, R, t, sums, axes = work[0], work[6], work[7], work[8], work[9]
    rotation(flexion, q, R)
    ca, sa = math.cos(flexion), math.sin(flexion)
    t[0] = ca * q[2] + sa * q[3]
    t[1] = -sa * q[2] + ca * q[3]
    t[2] = q[4]
    if not list_is_valid(R, t, contact[1][0], field[3][0], work):
        list_candidates(R, t, contact, field, work)
    n_contact, energy = contact_elements(R, t, field, work)
    work[3][1] = n_contact
    work[3][2] += 1
    n, pulled = ligament_elements(R, t, ligaments, n_contact, elements)
    energy += pulled
    sum_elements(n, elements, sums)
    generalised(flexion, R, t, sums, axes, g, H, h)
    for i in range(5):
        energy -= load[i] * q[i]
        g[i] -= load[i]
    return energy


@compiled
def scale_of(i):
    """Millimetres that one unit of coordinate i is worth."""
    return ROTATION_SCALE if i < 2 else 1.0


@compiled
def factorise(H, shift, L):
    """Write the Cholesky factor of H + shift * scale^2 into L; whether that is positive definite."""
    for i in range(5):
        for j in range(i + 1):
            x = H[i, j]
            if i == j:
                x += shift * scale_of(i) ** 2
            for k in range(j):
                x -= L[i, k] * L[j, k]
            if i == j:
                if x <= 1e-12 * scale_of(i) ** 2:
                    return False
                L[i, i] = math.sqrt(x)
            else:
                L[i, j] = x / L[j, j]
    return True


@compiled
def substitute(L, b, x):
    """Solve L L^T x = b."""
    for i in range(5):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(4, -1, -1):
        s = x[i]
        for k in range(i + 1, 5):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]


@compiled
def scaled_norm(x):
    """Length of a pose change in mm."""
    s = 0.0
    for i in range(5):
        s += (x[i] * scale_of(i)) ** 2
    return math.sqrt(s)


@compiled
def residual_norm(g):
    """Size of a generalised force in N, moments divided by the rotation scale."""
    s = 0.0
    for i in range(5):
        s += (g[i] / scale_of(i)) ** 2
    return math.sqrt(s)


@compiled
def trust_region_step(g, H, radius, L, minus_g, step):
    """Write the step that minimises the quadratic model within `radius`; return its shift."""
    for i in range(5):
        minus_g[i] = -g[i]
    shift = 0.0
    lowest = 0.0  # The shift is at least this.
    for _ in range(60):
        if not factorise(H, shift, L):
            lowest = shift
            shift = max(4.0 * shift, 0.05)
            continue
        substitute(L, minus_g, step)
        length = scaled_norm(step)
        if length <= radius * 1.1 and (length >= 0.7 * radius or shift <= lowest * 1.5 + 1e-9):
            return shift
        if length <= radius and shift == 0.0:
            return shift
        # Newton's iteration on 1/length(shift) = 1/radius: d length / d shift from one more solve.
        slope = 0.0
        for i in range(5):
            s = step[i] * scale_of(i) ** 2
            for k in range(i):
                s -= L[i, k] * minus_g[k]
            minus_g[i] = s / L[i, i]
            slope += minus_g[i] ** 2
        for i in range(5):
            minus_g[i] = -g[i]
        new = shift + (length * length / slope) * (length - radius) / radius
        shift = new if new > lowest else 0.5 * (shift + lowest)
    return shift


@compiled
def find_minimum(flexion, q, load, farthest, contact, field, ligaments, work, g, H, h):
    """Move q to a minimum of the energy; return (outcome, residual).

    A Newton step inside a trust region on the energy. `farthest` [mm] ends the search when q moves
    farther than that from where it began.
    """
    L, minus_g, step, trial, g_new, H_new, h_new, start = work[10]
    for i in range(5):
        start[i] = q[i]
    energy = evaluate(flexion, q, load, contact, field, ligaments, work, g, H, h)
    residual = residual_norm(g)
    radius = 3.0
    for _ in range(MOST_ITERATIONS):
        if residual < RESIDUAL_TOLERANCE:
            break
        if residual < SLACK_RESIDUAL and not factorise(H, -FLOOR_MARGIN, L):
            break
        trust_region_step(g, H, radius, L, minus_g, step)
        length = scaled_norm(step)
        predicted = 0.0
        for i in range(5):
            trial[i] = q[i] + step[i]
            s = 0.0
            for j in range(5):
                s += H[i, j] * step[j]
            predicted -= step[i] * (g[i] + 0.5 * s)
        energy_new = evaluate(flexion, trial, load, contact, field, ligaments, work, g_new, H_new, h_new)
        residual_new = residual_norm(g_new)
        rounding = 1e-13 * (abs(energy) + 1e4)
        gained = energy - energy_new
        if gained > 0.1 * predicted - rounding and (predicted > rounding or residual_new < residual):
            if gained > 0.75 * predicted and length > 0.6 * radius:
                radius = min(2.0 * radius, 10.0)
            energy, residual = energy_new, residual_new
            moved = 0.0
            for i in range(5):
                q[i] = trial[i]
                g[i] = g_new[i]
                h[i] = h_new[i]
                moved += ((q[i] - start[i]) * scale_of(i)) ** 2
                for j in range(5):
                    H[i, j] = H_new[i, j]
            if moved > farthest * farthest:
                return NO_EQUILIBRIUM, residual
        else:
            if predicted <= rounding:  # Rounding hides any further gain.
                break
            radius = 0.25 * min(length, radius)
            if radius < 1e-12:
                break
    if residual < SLACK_RESIDUAL and not factorise(H, -FLOOR_MARGIN, L):
        return UNCONSTRAINED, residual
    if residual >= RESIDUAL_TOLERANCE:
        return NO_EQUILIBRIUM, residual
    factorise(H, 0.0, L)
    substitute(L, g, step)
    for i in range(5):
        q[i] -= step[i]
    return CONVERGED, residual


@compiled
def tangent(H, h, load_change, flexion_change, L, right, step):
    """Write how the equilibrium moves when load and flexion change: -H^-1 d(gradient)."""
    for i in range(5):
        right[i] = load_change[i] - h[i] * flexion_change
    if factorise(H, 0.0, L):
        substitute(L, right, step)
    else:
        for i in range(5):
            step[i] = 0.0


@compiled
def off_branch(before, after, tangent_before, tangent_after, share):
    """Whether a step disagrees with the tangents at its ends more than a smooth branch would.

    The disagreement is weighed against the way the tangents explain, of which a jump is no part.
    """
    off, length, explained = 0.0, 0.0, 0.0
    for i in range(5):
        change = after[i] - before[i]
        mean = 0.5 * share * (tangent_before[i] + tangent_after[i])
        off += ((change - mean) * scale_of(i)) ** 2
        length += (change * scale_of(i)) ** 2
        explained += (mean * scale_of(i)) ** 2
    allowed = BRANCH_ABSOLUTE + BRANCH_RELATIVE * math.sqrt(min(length, explained))
    return math.sqrt(off) > allowed


@compiled
def copy_state(q, H, h, slope, q_to, H_to, h_to, slope_to):
    """Copy an equilibrium: pose, Hessian, d gradient / d flexion and tangent."""
    for i in range(5):
        q_to[i], h_to[i], slope_to[i] = q[i], h[i], slope[i]
        for j in range(5):
            H_to[i, j] = H[i, j]


@compiled
def follow(path, q, H, h, guess, guessed, contact, field, ligaments, work, g):
    """Follow the branch of equilibria from one end of a straight load path to the other.

    `path` holds flexion (2), load before (5), load after (5). q, H and h are those of the state
    before and become those of the state after, or of the last stable state reached. A step is
    accepted when it agrees with the tangents at both of its ends, else it is halved: on a smooth
    branch the disagreement vanishes with the step, across a jump it stays. A state found too far
    away for one step is kept and looked at again from closer by. `guess` is a pose to try first at
    the path's end, if `guessed`.

    Returns (outcome, share of the path reached, residual, number of solves).
    """
    L, minus_g = work[10][0], work[10][1]
    q_new, H_new, h_new, after, q_far, H_far, h_far, after_far, load, change, before = work[11]
    flexion_change = path[1] - path[0]
    for i in range(5):
        change[i] = path[7 + i] - path[2 + i]
    reached, share, far, residual, solves = 0.0, 1.0, -1.0, 0.0, 0
    tangent(H, h, change, flexion_change, L, minus_g, before)
    while reached < 1.0:
        share = min(share, 1.0 - reached)
        goal = reached + share
        outcome = CONVERGED
        if goal == far:
            copy_state(q_far, H_far, h_far, after_far, q_new, H_new, h_new, after)
        else:
            for i in range(5):
                q_new[i] = guess[i] if guessed else q[i] + share * before[i]
                load[i] = path[2 + i] + goal * change[i]
            angle = path[0] + goal * flexion_change
            outcome, residual = find_minimum(
                angle, q_new, load, LARGEST_MOVE, contact, field, ligaments, work, g, H_new, h_new
            )
            solves += 1
            tangent(H_new, h_new, change, flexion_change, L, minus_g, after)
        if outcome == CONVERGED and not off_branch(q, q_new, before, after, share):
            copy_state(q_new, H_new, h_new, after, q, H, h, before)
            reached = goal
            share *= 2.0
        elif guessed:
            guessed = False
        else:
            if outcome == CONVERGED and goal != far:
                copy_state(q_new, H_new, h_new, after, q_far, H_far, h_far, after_far)
                far = goal
            share *= 0.5
            if share < SMALLEST_STEP:
                free = not factorise(H, -10.0 * FLOOR_MARGIN, L)
                return UNCONSTRAINED if free else FOLD, reached, residual, solves
    return CONVERGED, 1.0, residual, solves


@compiled
def parameter_columns(R, t, ligaments, axes, columns):
    """Write d gradient / d (stiffness [N], reference strain) of every ligament into `columns`."""
    femoral, tibial, properties = ligaments
    m = femoral.shape[0]
    for i in range(m):
        y0, y1, y2 = tibial[i, 0], tibial[i, 1], tibial[i, 2]
        p0 = R[0] * y0 + R[1] * y1 + R[2] * y2
        p1 = R[3] * y0 + R[4] * y1 + R[5] * y2
        p2 = R[6] * y0 + R[7] * y1 + R[8] * y2
        e0 = p0 + t[0] - femoral[i, 0]
        e1 = p1 + t[1] - femoral[i, 1]
        e2 = p2 + t[2] - femoral[i, 2]
        length = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        strain = length * (1.0 + properties[i, 1]) / properties[i, 2] - 1.0
        force, slope, _ = tension(strain, 1.0, properties[i, 3])
        by_strain = properties[i, 0] * slope / properties[i, 2]
        force /= length
        m0, m1, m2 = p1 * e2 - p2 * e1, p2 * e0 - p0 * e2, p0 * e1 - p1 * e0
        for a in range(5):
            if a < 2:
                along = axes[a, 0] * m0 + axes[a, 1] * m1 + axes[a, 2] * m2
            else:
                along = axes[a, 0] * e0 + axes[a, 1] * e1 + axes[a, 2] * e2
            columns[a, i] = force * along
            columns[a, m + i] = by_strain * along


@compiled
def sensitivities(flexion, q, H, ligaments, work, columns, S):
    """Write dq / d(stiffness, reference strain) = -H^-1 d gradient / d parameter into S (5, 2m)."""
    R, t, axes = work[6], work[7], work[9]
    L, right, step = work[10][0], work[10][1], work[10][2]
    rotation(flexion, q, R)
    ca, sa = math.cos(flexion), math.sin(flexion)
    t[0] = ca * q[2] + sa * q[3]
    t[1] = -sa * q[2] + ca * q[3]
    t[2] = q[4]
    axes[0, 0], axes[0, 1], axes[0, 2] = ca, -sa, 0.0
    axes[1, 0], axes[1, 1], axes[1, 2] = R[1], R[4], R[7]
    axes[2, 0], axes[2, 1], axes[2, 2] = ca, -sa, 0.0
    axes[3, 0], axes[3, 1], axes[3, 2] = sa, ca, 0.0
    axes[4, 0], axes[4, 1], axes[4, 2] = 0.0, 0.0, 1.0
    parameter_columns(R, t, ligaments, axes, columns)
    factorise(H, 0.0, L)
    for j in range(columns.shape[1]):
        for i in range(5):
            right[i] = -columns[i, j]
        substitute(L, right, step)
        for i in range(5):
            S[i, j] = step[i]


@compiled
def contact_centres(contact, work, centres):
    """Write force [N] and centre of force in tibial and femoral axes (7) of every compartment.

    The contact elements are those of the pose evaluated last.
    """
    points, compartment = contact[0], contact[3]
    elements, counts, t, touching = work[0], work[3], work[7], work[12]
    for c in range(centres.shape[0]):
        for k in range(7):
            centres[c, k] = 0.0
    for n in range(counts[1]):
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


@compiled
def workspace(n_points, n_ligaments):
    """Memory for one thread's work, allocated once a simulation."""
    n = n_points + n_ligaments + 1
    counts = np.zeros(4, np.int64)
    counts[0] = -1
    solver = (
        np.zeros((5, 5)),
        np.zeros(5),
        np.zeros(5),
        np.zeros(5),
        np.zeros(5),
        np.zeros((5, 5)),
        np.zeros(5),
        np.zeros(5),
    )
    path = (
        np.zeros(5),
        np.zeros((5, 5)),
        np.zeros(5),
        np.zeros(5),
        np.zeros(5),
        np.zeros((5, 5)),
        np.zeros(5),
        np.zeros(5),
        np.zeros(5),
        np.zeros(5),
        np.zeros(5),
    )
    return (
        np.zeros((12, n)),  # 0 elements
        np.zeros((4, n)),  # 1 place in the cell, stiffness
        np.zeros((4, n)),  # 2 listed points, stiffness
        counts,  # 3 listed points, contact elements, evaluations, listings
        np.zeros(12),  # 4 pose of the list
        np.zeros(n, np.int64),  # 5 first coefficient of the cell
        np.zeros(9),  # 6 rotation
        np.zeros(3),  # 7 translation
        np.zeros(39),  # 8 sums over elements
        np.zeros((9, 3)),  # 9 axes
        solver,  # 10
        path,  # 11
        np.zeros(n, np.int64),  # 12 point of each contact element
        np.zeros(n, np.int64),  # 13 point of each listed one
        np.zeros((6, n)),  # 14 listed points, turned; their place in the grid
        np.zeros((n, 36)),  # 15 spline weights
    )


@compiled
def simulate_path(nodes, start, guesses, has_guess, contact, field, ligaments, derivatives, results):
    """Solve every node of a tree of load paths, each from its parent's state.

    `nodes`: flexion (n), load (n, 5), parent (n); a parent of -1 starts the search at `start`.
    `results`: poses (n, 5), Hessians (n, 5, 5), sensitivities (n, 5, 2m), outcomes (n), residuals
    (n), share of the path from the parent that was reached (n), d gradient / d flexion (n, 5),
    solves (n), contact force and centres (n, compartments, 7).
    """
    flexion, loads, parent = nodes
    poses, hessians, slopes, outcomes, residuals, reached, flexed, solves, centres = results
    work = workspace(contact[0].shape[1], ligaments[0].shape[0])
    g, q, H, h = np.zeros(5), np.zeros(5), np.zeros((5, 5)), np.zeros(5)
    path = np.zeros(12)
    columns = np.zeros((5, 2 * ligaments[0].shape[0]))
    for n in range(flexion.shape[0]):
        before = parent[n]
        if before < 0:
            for i in range(5):
                q[i] = start[i]
            outcome, residuals[n] = find_minimum(
                flexion[n], q, loads[n], 1e9, contact, field, ligaments, work, g, H, h
            )
            reached[n] = 1.0
            solves[n] = 1
        else:
            for i in range(5):
                q[i] = poses[before, i]
                h[i] = flexed[before, i]
                path[2 + i] = loads[before, i]
                path[7 + i] = loads[n, i]
                for j in range(5):
                    H[i, j] = hessians[before, i, j]
            path[0], path[1] = flexion[before], flexion[n]
            outcome = outcomes[before]
            reached[n] = 0.0
            if outcome == CONVERGED:
                outcome, reached[n], residuals[n], solves[n] = follow(
                    path, q, H, h, guesses[n], has_guess, contact, field, ligaments, work, g
                )
        outcomes[n] = outcome
        for i in range(5):
            poses[n, i] = q[i]
            flexed[n, i] = h[i]
            for j in range(5):
                hessians[n, i, j] = H[i, j]
        contact_centres(contact, work, centres[n])
        if derivatives and outcome == CONVERGED:
            sensitivities(flexion[n], q, H, ligaments, work, columns, slopes[n])
