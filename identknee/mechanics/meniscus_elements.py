"""The menisci near a pose: elements that press beside those of contact, and stand after them.

A point i of a meniscus stores ``1/2 k A_i max(0, h_i - phi)^2``, where phi is its distance to the
femur: it is a contact element of exponent 1 whose surface lies h_i higher. All points begin to
touch in the scanned pose, so that the touch is rounded whether or not that of contact is.
"""

import numpy as np

from identknee.mechanics.compiled import compiled
from identknee.mechanics.contact_elements import KEPT_GAP, contact_element, spline_at
from identknee.mechanics.distance_field import MOST_ROUNDING
from identknee.mechanics.elements import NOTHING, added, write_sums
from identknee.mechanics.memory import N_PUSHING, N_TOUCHING


@compiled
def expand_menisci(menisci, work):
    """Expand the distance of every point that may press, after those of contact, and count all.

    A point beyond the field is farther away than any height.
    """
    placed, expansion, touching = work.placed, work.expansion, work.touching
    R, t = placed.field_rotation, placed.field_translation
    coefficients, grid = menisci.coefficients, menisci.grid
    origin, inverse = grid.origin, 1.0 / grid.spacing
    square, gap = inverse * inverse, MOST_ROUNDING + KEPT_GAP
    stride_x, stride_y = grid.shape[1] * grid.shape[2], grid.shape[2]
    kept = np.uint64(placed.counts[N_TOUCHING])
    for i in range(menisci.points.shape[1]):
        y0, y1, y2 = menisci.points[0, i], menisci.points[1, i], menisci.points[2, i]
        x = (R[0] * y0 + R[1] * y1 + R[2] * y2 + t[0] - origin[0]) * inverse
        y = (R[3] * y0 + R[4] * y1 + R[5] * y2 + t[1] - origin[1]) * inverse
        z = (R[6] * y0 + R[7] * y1 + R[8] * y2 + t[2] - origin[2]) * inverse
        ix, iy, iz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        if min(ix, iy, iz) < 1:
            continue
        if ix > grid.shape[0] - 3 or iy > grid.shape[1] - 3 or iz > grid.shape[2] - 3:
            continue
        first = (ix - 1) * stride_x + (iy - 1) * stride_y + iz - 1
        d, gx, gy, gz, hxx, hyy, hzz, hxy, hxz, hyz = spline_at(
            coefficients, first, stride_x, stride_y, x - ix, y - iy, z - iz
        )
        d -= menisci.heights[i]
        expansion[0, kept], expansion[1, kept], expansion[2, kept] = y0, y1, y2
        expansion[6, kept] = menisci.areas[i] * menisci.stiffness[menisci.side[i]]
        expansion[7, kept] = d
        expansion[8, kept], expansion[9, kept] = inverse * gx, inverse * gy
        expansion[10, kept] = inverse * gz
        expansion[11, kept], expansion[12, kept] = square * hxx, square * hyy
        expansion[13, kept], expansion[14, kept] = square * hzz, square * hxy
        expansion[15, kept], expansion[16, kept] = square * hxz, square * hyz
        touching[kept] = i
        kept += np.uint64(d < gap)
    placed.counts[N_PUSHING] = kept


@compiled
def add_menisci(placed, expansion, sums):
    """Add the sums over the menisci at the pose placed last to `sums` (39); their energy."""
    R, t, own, energy, total = placed.rotation, placed.translation, placed.pressed, 0.0, NOTHING
    for i in range(placed.counts[N_TOUCHING], placed.counts[N_PUSHING]):
        first, squares, products, _, stored = contact_element(
            expansion, i, R, t, 1.0, MOST_ROUNDING
        )
        total = added(total, first, squares, products)
        energy += stored
    write_sums(total, own)
    for k in range(39):
        sums[k] += own[k]
    return energy


@compiled
def write_meniscus_forces(work):
    """Write how every point of the menisci is pushed at the pose placed last, after contact's."""
    placed, expansion, pushes = work.placed, work.expansion, work.pushes
    R, t = placed.rotation, placed.translation
    for i in range(placed.counts[N_TOUCHING], placed.counts[N_PUSHING]):
        first, _, _, felt, _ = contact_element(expansion, i, R, t, 1.0, MOST_ROUNDING)
        for k in range(6):
            pushes[k, i] = first[k]
        pushes[6, i] = felt


@compiled
def meniscus_columns(menisci, work, columns, first):
    """Write d gradient / d (medial, lateral stiffness, height) of the menisci into `columns`.

    They begin at `first`, and are those of the pose placed last. A stiffness of zero has slopes
    too, so that the forces of a unit of stiffness are found anew.
    """
    placed, expansion, touching = work.placed, work.expansion, work.touching
    R, t, axes = placed.rotation, placed.translation, placed.axes
    for k in range(3):
        for a in range(5):
            columns[a, first + k] = 0.0
    for i in range(placed.counts[N_TOUCHING], placed.counts[N_PUSHING]):
        j = touching[i]
        side, area, own = menisci.side[j], menisci.areas[j], expansion[6, i]
        expansion[6, i] = area
        unit, _, _, felt, _ = contact_element(expansion, i, R, t, 1.0, MOST_ROUNDING)
        expansion[6, i] = own
        p0, p1, p2, f0, f1, f2 = unit
        # The force grows with the height as the felt depth does, along the same way.
        steepness = min(np.sqrt(felt / MOST_ROUNDING), 1.0)
        by_height = menisci.stiffness[side] * steepness / felt if felt > 0.0 else 0.0
        m0, m1, m2 = p1 * f2 - p2 * f1, p2 * f0 - p0 * f2, p0 * f1 - p1 * f0
        for a in range(5):
            x, y, z = axes[a, 0], axes[a, 1], axes[a, 2]
            along = x * m0 + y * m1 + z * m2 if a < 2 else x * f0 + y * f1 + z * f2
            columns[a, first + side] += along
            columns[a, first + 2] += by_height * along
