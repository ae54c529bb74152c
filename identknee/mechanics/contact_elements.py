"""The contact near a pose it was expanded at: elements, their sums, and where the force acts."""

import math

from identknee.mechanics.compiled import compiled, compiled_into_callers
from identknee.mechanics.contact_law import REFERENCE_DEPTH
from identknee.mechanics.elements import NOTHING, added
from identknee.mechanics.memory import N_TOUCHING


@compiled_into_callers
def felt_depth(depth, exponent, rounding):
    """Depth as the pressure feels it, its derivative, and the integral of its power over depth.

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
    felt, steepness, work = felt_depth(-distance, exponent, rounding)
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
def write_pushes(law, work):
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
    t, expansion = work.placed.translation, work.expansion
    touching, pushes = work.touching, work.pushes
    for c in range(centres.shape[0]):
        total, y0, y1, y2, x0, x1, x2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(work.placed.counts[N_TOUCHING]):
            f0, f1, f2 = pushes[3, i], pushes[4, i], pushes[5, i]
            is_here = contact.compartment[touching[i]] == c
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
