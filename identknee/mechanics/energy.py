"""Energy of a pose at fixed flexion, with its gradient, its Hessian and what flexion does to it.

Poses are q = (varus, internal [rad], x, y, z [mm]) of the tibia in the femur, the translation in
axes that turn with flexion: ``x_femur = R x_tibia + Rz(-flexion) (x, y, z)`` with
``R = Rz(-flexion) Rx(varus) Ry(internal)``. Forces are in N, moments in N mm, energies in N mm.

``contact``, ``field``, ``ligaments`` and ``work`` are the named groups of arrays of
`identknee.mechanics.memory`.
"""

import math

import numpy as np

from identknee.mechanics.compiled import compiled
from identknee.mechanics.contact_elements import (
    expand_contact,
    list_candidates,
    list_is_valid,
    place_expansion,
    sum_contact,
    turn_expansion,
)
from identknee.mechanics.elements import line_force, line_shape, sum_ligaments, write_sums
from identknee.mechanics.memory import (
    N_EVALUATIONS,
    N_EXPANDED,
    N_PUSHING,
    N_TOUCHING,
    ROTATION_SCALE,
)
from identknee.mechanics.meniscus_elements import add_menisci, expand_menisci
from identknee.mechanics.obstacles import wrapped_element


@compiled
def scale_of(i):
    """Millimetres that one unit of coordinate i is worth."""
    return ROTATION_SCALE if i < 2 else 1.0


@compiled
def copy(values, to):
    """Copy the five values of a pose or of its loads."""
    for i in range(5):
        to[i] = values[i]


@compiled
def factorise(H, shift, L):
    """Write the Cholesky factor of H + shift scale^2 into L; whether that is positive definite."""
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


SAME_CONTACT = 1e-5  # mm; as near as that a pose is evaluated once for contact forces


@compiled
def place_tibia(flexion, q, R, t):
    """Write rotation and origin of the tibia in femoral axes into R (9) and t (3)."""
    ca, sa = math.cos(flexion), math.sin(flexion)
    cv, sv = math.cos(q[0]), math.sin(q[0])
    ci, si = math.cos(q[1]), math.sin(q[1])
    m10, m11, m12 = sv * si, cv, -sv * ci
    R[0], R[1], R[2] = ca * ci + sa * m10, sa * m11, ca * si + sa * m12
    R[3], R[4], R[5] = -sa * ci + ca * m10, ca * m11, -sa * si + ca * m12
    R[6], R[7], R[8] = -cv * si, sv, cv * ci
    t[0], t[1], t[2] = ca * q[2] + sa * q[3], -sa * q[2] + ca * q[3], q[4]


@compiled
def place_in_field(grid, placed):
    """Write rotation and origin of the tibia in the frame of the distance field."""
    R, t, turn, shift = placed.rotation, placed.translation, grid.turn, grid.shift
    R_field, t_field = placed.field_rotation, placed.field_translation
    for i in range(3):
        a, b, c = turn[3 * i], turn[3 * i + 1], turn[3 * i + 2]
        for j in range(3):
            x = a * R[j] + b * R[3 + j] + c * R[6 + j]
            R_field[3 * i + j] = x if grid.is_apart else R[3 * i + j]
        x = a * t[0] + b * t[1] + c * t[2] + shift[i]
        t_field[i] = x if grid.is_apart else t[i]


@compiled
def motion_axes(flexion, R, t, axes):
    """Write how the coordinates move the tibia, in femoral axes.

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
def generalised(sums, axes, g, H, h):
    """Turn the sums over elements into gradient g, Hessian H and d g / d flexion."""
    # Where the matrices begin in the sums, and rows of the axes. Plain constants would have the
    # compiler make another version of `bilinear` for each.
    moment, stiffness, turning, swinging = np.int64(3), np.int64(12), np.int64(21), np.int64(30)
    flexed, carried = np.int64(5), np.int64(6)
    axes[7, 0], axes[7, 1], axes[7, 2] = sums[0], sums[1], sums[2]
    axes[8, 0], axes[8, 1], axes[8, 2] = sums[10] - sums[8], sums[5] - sums[9], sums[6] - sums[4]
    trace = sums[3] + sums[7] + sums[11]
    for i in range(2):
        g[i] = dot(axes, i, axes, 8)
        for j in range(i, 2):
            # d2 p / d a d b = a x (b x p), with a the outer of the two axes.
            H[i, j] = (
                bilinear(axes, i, sums, swinging, axes, j)
                + bilinear(axes, j, sums, moment, axes, i)
                - trace * dot(axes, i, axes, j)
            )
            H[j, i] = H[i, j]
        for j in range(2, 5):
            H[j, i] = bilinear(axes, j, sums, turning, axes, i)
            H[i, j] = H[j, i]
        h[i] = (
            bilinear(axes, i, sums, swinging, axes, flexed)
            + bilinear(axes, carried, sums, turning, axes, i)
            + bilinear(axes, i, sums, moment, axes, flexed)
            - trace * dot(axes, i, axes, flexed)
        )
    for i in range(2, 5):
        g[i] = dot(axes, i, axes, 7)
        for j in range(i, 5):
            H[i, j] = bilinear(axes, i, sums, stiffness, axes, j)
            H[j, i] = H[i, j]
        h[i] = bilinear(axes, i, sums, turning, axes, flexed) + bilinear(
            axes, i, sums, stiffness, axes, carried
        )
    h[2] += sums[0] * axes[2, 1] - sums[1] * axes[2, 0]
    h[3] += sums[0] * axes[3, 1] - sums[1] * axes[3, 0]


@compiled
def place_joint(flexion, q, grid, placed):
    """Write where the pose puts the tibia, in the axes of poses and of the field."""
    place_tibia(flexion, q, placed.rotation, placed.translation)
    motion_axes(flexion, placed.rotation, placed.translation, placed.axes)
    place_in_field(grid, placed)
    copy(q, placed.pose)


@compiled
def sum_up(load, law, ligaments, placed, expansion, at):
    """Energy of the pose placed last, from the expansion; derivatives are written to `at`."""
    total, energy = sum_contact(law, placed, expansion)
    total, pulled = sum_ligaments(total, ligaments, placed)
    energy += pulled
    write_sums(total, placed.sums)
    if placed.counts[N_PUSHING] > placed.counts[N_TOUCHING]:
        energy += add_menisci(placed, expansion, placed.sums)
    generalised(placed.sums, placed.axes, at.gradient, at.hessian, at.gradient_by_flexion)
    for i in range(5):
        energy -= load[i] * placed.pose[i]
        at.gradient[i] -= load[i]
    if placed.hold > 0.0:
        for i in range(5):
            stiffness = placed.hold * scale_of(i) ** 2
            away = placed.pose[i] - placed.held_at[i]
            energy += 0.5 * stiffness * away * away
            at.gradient[i] += stiffness * away
            at.hessian[i, i] += stiffness
    return energy


@compiled
def evaluate(flexion, load, contact, field, ligaments, work, at):
    """Energy of the pose of a point, whose derivatives are written; contact is expanded there."""
    placed, grid = work.placed, field.grid
    place_joint(flexion, at.pose, grid, placed)
    if not list_is_valid(contact.radius, grid.spacing, placed):
        list_candidates(contact, field, work)
    expand_contact(contact.law, field, work)
    expand_menisci(contact.menisci, work)
    n = placed.counts[N_PUSHING]
    place_expansion(n, placed, work.expansion)
    if grid.is_apart:
        turn_expansion(n, grid.turn, work.expansion)
    placed.counts[N_EVALUATIONS] += 1
    copy(at.pose, placed.expanded)
    return sum_up(load, contact.law, ligaments, placed, work.expansion, at)


@compiled
def evaluate_near(flexion, load, law, grid, ligaments, placed, expansion, at):
    """The same from the contact as expanded last, at a fifth of the cost.

    Exact but for the third derivatives of the distance to the femur, and for points that came near
    it since.
    """
    place_joint(flexion, at.pose, grid, placed)
    placed.counts[N_EXPANDED] += 1
    return sum_up(load, law, ligaments, placed, expansion, at)


@compiled
def evaluate_if_moved(flexion, q, load, contact, field, ligaments, work):
    """Make the elements those of a pose, unless the pose evaluated last is about the same."""
    at, last, far = work.solver.trial, work.evaluation.placed.pose, 0.0
    for i in range(5):
        far = max(far, abs(q[i] - last[i]) * scale_of(i))
    if far > SAME_CONTACT:
        copy(q, at.pose)
        evaluate(flexion, load, contact, field, ligaments, work.evaluation, at)


@compiled
def parameter_columns(placed, ligaments, columns):
    """Write d gradient / d (stiffness [N], reference strain) of every ligament into `columns`."""
    R, t, axes = placed.rotation, placed.translation, placed.axes
    course = placed.course
    shape = course.shape
    m = len(ligaments)
    for i in range(m):
        line = ligaments[i]
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
        strain = shape[0] * (1.0 + line.reference_strain) / line.reference_length - 1.0
        force, slope, _ = line_force(strain, 1.0, line.transition)
        by_strain = line.stiffness * slope * shape[0] / line.reference_length
        e0, e1, e2 = shape[1], shape[2], shape[3]
        m0, m1, m2 = p1 * e2 - p2 * e1, p2 * e0 - p0 * e2, p0 * e1 - p1 * e0
        for a in range(5):
            if a < 2:
                along = axes[a, 0] * m0 + axes[a, 1] * m1 + axes[a, 2] * m2
            else:
                along = axes[a, 0] * e0 + axes[a, 1] * e1 + axes[a, 2] * e2
            columns[a, i] = force * along
            columns[a, m + i] = by_strain * along
