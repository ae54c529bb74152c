"""Energy and wrench of the virtual knee, compiled.

Written from the equations, apart from the model it tests: the pose is a rotation matrix and a
position, turned by rotation vectors; coordinates come from cross products of the axes; contact is
a power law on a finer surface; ligaments stretch by a smooth law.
"""

from typing import NamedTuple

import numpy as np

from identknee.runs.compiling import compiled
from identknee.runs.declare import Array

# A rotation counts as much as this displacement [mm/rad].
LEVER = 40.0
# Depth at which the power law has the stated modulus [mm].
REFERENCE_DEPTH = 0.3
# Width of the rounded ends of the toe, over its strain.
TOE_WIDTH = 0.05
# Error that an estimated distance may have [mm].
SAFE_GAP = 0.4
# Points closer than this may touch within a difference of poses [mm].
NEARLY = 1e-3


class TibialSurface(NamedTuple):
    """What may touch the femur: points (n, 3) [mm], areas (n,) [mm2], modulus and exponent (2,)."""

    points: Array
    areas: Array
    law: Array


class FemurGrid(NamedTuple):
    """Distances to the femur [mm] at the nodes of a grid, its first node and its spacing [mm]."""

    values: Array
    origin: Array
    spacing: float


class VirtualKnee(NamedTuple):
    """The knee as compiled functions take it; the rows of its arrays are those of `Experiment`."""

    surface: TibialSurface
    field: FemurGrid
    lines: Array
    weights: Array
    springs: Array
    torsion: Array
    pads: Array
    wide: FemurGrid


@compiled
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def turned(w):
    """Rotation matrix of a rotation vector [rad]."""
    angle = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    if angle < 1e-6:
        a, b = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    return np.eye(3) + a * K + b * (K @ K)


@compiled
def joint_axes(R):
    """Floating (anterior) and tibial (superior) axis in the femur, shape ``(2, 3)``."""
    axes = np.empty((2, 3))
    length = np.hypot(R[0, 1], R[1, 1])
    axes[0, 0], axes[0, 1], axes[0, 2] = R[1, 1] / length, -R[0, 1] / length, 0.0
    axes[1] = R[:, 1]
    return axes


@compiled
def grood_suntay(R, t):
    """Lateral shift, drawer, distraction [mm], varus, internal rotation and flexion [rad]."""
    axes = joint_axes(R)
    e2, e3 = axes[0], axes[1]
    e1 = np.array([0.0, 0.0, 1.0])
    across = np.cross(e1, e2)
    behind = np.cross(e2, e3)
    result = np.empty(6)
    result[0] = _dot(t, behind) / _dot(e1, behind)
    result[1] = _dot(t, e2)
    result[2] = -_dot(t, across) / _dot(e3, across)
    result[3] = np.arcsin(e3[2])
    result[4] = np.arctan2(e2[0] * R[0, 2] + e2[1] * R[1, 2], e2[0] * R[0, 0] + e2[1] * R[1, 0])
    result[5] = np.arctan2(-e2[1], e2[0])
    return result


@compiled
def about_flexion_axis(angle):
    """Rotation matrix of a flexion by `angle` [rad]."""
    return turned(np.array([0.0, 0.0, -angle]))


@compiled
def moved(R, t, u, flexion):
    """Pose after a tangent step `u` [mm], its flexion put back exactly."""
    axes = joint_axes(R)
    new = turned((u[0] * axes[0] + u[1] * axes[1]) / LEVER) @ R
    new = about_flexion_axis(flexion - grood_suntay(new, t)[5]) @ new
    return new, t + u[2:5]


@compiled
def _ramp(x, width):
    """First, second and third integral of a smooth step of a width, from below."""
    root, arc = np.sqrt(x * x + width * width), np.arcsinh(x / width)
    first = 0.5 * (x + root)
    second = 0.25 * (x * x + x * root + width * width * arc)
    third = x**3 / 12.0 + root**3 / 12.0 + 0.25 * width * width * (x * arc - root)
    return first, second, third


@compiled
def smooth_tension(strain, toe):
    """Force over stiffness, its slope by strain, and its integral.

    The slope of the printed law rises in a straight line from strain 0 to twice the toe strain;
    here both ends of the rise are rounded.
    """
    width = TOE_WIDTH * toe
    low, high = _ramp(strain, width), _ramp(strain - 2.0 * toe, width)
    scale = 0.5 / toe
    return scale * (low[1] - high[1]), scale * (low[0] - high[0]), scale * (low[2] - high[2])


@compiled
def _weights(f, value, slope):
    """Catmull-Rom weights of four nodes at the fraction `f`, and their slopes."""
    value[0] = 0.5 * f * (-1.0 + f * (2.0 - f))
    value[1] = 0.5 * (2.0 + f * f * (-5.0 + 3.0 * f))
    value[2] = 0.5 * f * (1.0 + f * (4.0 - 3.0 * f))
    value[3] = 0.5 * f * f * (f - 1.0)
    slope[0] = 0.5 * (-1.0 + f * (4.0 - 3.0 * f))
    slope[1] = 0.5 * f * (-10.0 + 9.0 * f)
    slope[2] = 0.5 * (1.0 + f * (8.0 - 9.0 * f))
    slope[3] = 0.5 * f * (3.0 * f - 2.0)


@compiled
def _near(field, x, y, z, reach):
    """Whether the femur may be within `reach` [mm] of a point, by slopes at its nearest node."""
    values, origin, spacing = field
    a, b, c = (x - origin[0]) / spacing, (y - origin[1]) / spacing, (z - origin[2]) / spacing
    i, j, k = int(a + 0.5), int(b + 0.5), int(c + 0.5)
    n = values.shape
    if not (1 < a < n[0] - 3 and 1 < b < n[1] - 3 and 1 < c < n[2] - 3):
        return False
    if values[i, j, k] > reach + spacing:
        return False
    change = (a - i) * (values[i + 1, j, k] - values[i - 1, j, k])
    change += (b - j) * (values[i, j + 1, k] - values[i, j - 1, k])
    change += (c - k) * (values[i, j, k + 1] - values[i, j, k - 1])
    return values[i, j, k] + 0.5 * change < reach + SAFE_GAP


@compiled
def _distance(field, x, y, z, memory, gradient):
    """Signed distance to the femur [mm] of a point on the grid, and its gradient."""
    values, origin, spacing = field
    a, b, c = (x - origin[0]) / spacing, (y - origin[1]) / spacing, (z - origin[2]) / spacing
    i, j, k = int(a), int(b), int(c)
    _weights(a - i, memory[0], memory[1])
    _weights(b - j, memory[2], memory[3])
    _weights(c - k, memory[4], memory[5])
    total, dx, dy, dz = 0.0, 0.0, 0.0, 0.0
    for p in range(4):
        plane, plane_y, plane_z = 0.0, 0.0, 0.0
        for q in range(4):
            row, row_z = 0.0, 0.0
            for r in range(4):
                node = values[i - 1 + p, j - 1 + q, k - 1 + r]
                row += memory[4, r] * node
                row_z += memory[5, r] * node
            plane += memory[2, q] * row
            plane_y += memory[3, q] * row
            plane_z += memory[2, q] * row_z
        total += memory[0, p] * plane
        dx += memory[1, p] * plane
        dy += memory[0, p] * plane_y
        dz += memory[0, p] * plane_z
    gradient[0], gradient[1], gradient[2] = dx / spacing, dy / spacing, dz / spacing
    return total


@compiled
def candidates(R, t, surface, field, reach):
    """Numbers of the tibial points that may come within `reach` [mm] of the femur."""
    points = surface.points
    chosen = np.empty(len(points), np.int64)
    n = 0
    for i in range(len(points)):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        x = R[0, 0] * a + R[0, 1] * b + R[0, 2] * c + t[0]
        y = R[1, 0] * a + R[1, 1] * b + R[1, 2] * c + t[1]
        z = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c + t[2]
        if _near(field, x, y, z, reach):
            chosen[n] = i
            n += 1
    return chosen[:n]


@compiled
def _push(wrench, arm, x, y, z):
    """Add the gradient (x, y, z) of an energy at a tibial point at `arm` from the tibial origin."""
    wrench[0] += arm[1] * z - arm[2] * y
    wrench[1] += arm[2] * x - arm[0] * z
    wrench[2] += arm[0] * y - arm[1] * x
    wrench[3] += x
    wrench[4] += y
    wrench[5] += z


@compiled
def _contact_energy(R, t, surface, field, listed, wrench, touching):
    """Energy of contact, and how many numbers of points that touch were put into `touching`."""
    points, areas, law = surface
    modulus, exponent = law[0] / REFERENCE_DEPTH ** (law[1] - 1.0), law[1]
    memory, gradient, arm = np.empty((6, 4)), np.empty(3), np.empty(3)
    energy, n = 0.0, 0
    for i in listed:
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        for m in range(3):
            arm[m] = R[m, 0] * a + R[m, 1] * b + R[m, 2] * c
        x, y, z = arm[0] + t[0], arm[1] + t[1], arm[2] + t[2]
        if not _near(field, x, y, z, 0.0):
            continue
        depth = -_distance(field, x, y, z, memory, gradient)
        if depth > -NEARLY:
            touching[n] = i
            n += 1
        if depth <= 0.0:
            continue
        force = areas[i] * modulus * depth**exponent
        energy += force * depth / (exponent + 1.0)
        _push(wrench, arm, -force * gradient[0], -force * gradient[1], -force * gradient[2])
    return energy, n


@compiled
def _pad_energy(R, t, pads, field, wrench):
    """Energy of elastic pads on the tibia, each of which the femur presses below its height."""
    memory, gradient, arm = np.empty((6, 4)), np.empty(3), np.empty(3)
    energy = 0.0
    for pad in pads:
        for m in range(3):
            arm[m] = R[m, 0] * pad[0] + R[m, 1] * pad[1] + R[m, 2] * pad[2]
        x, y, z = arm[0] + t[0], arm[1] + t[1], arm[2] + t[2]
        if not _near(field, x, y, z, pad[4]):
            continue
        depth = pad[4] - _distance(field, x, y, z, memory, gradient)
        if depth > 0.0:
            force = pad[3] * depth
            energy += 0.5 * force * depth
            _push(wrench, arm, -force * gradient[0], -force * gradient[1], -force * gradient[2])
    return energy


@compiled
def line_path(R, t, line):
    """Length of a line, where it acts on the tibia and its slope with that place's motion.

    The place is given from the tibial origin, along the femoral axes. A lifted line bends at a
    share of its way down, where something pushes it aside along the tibial z axis.
    """
    if line[10] == 0.0:
        arm = R @ line[3:6].copy()
        way = arm + t - line[0:3]
        length = np.sqrt(_dot(way, way))
        return length, arm, way / length
    top = R.T @ (line[0:3] - t)
    share = line[11]
    bend = top + share * (line[3:6] - top)
    bend[2] += line[10]
    above, below = top - bend, bend - line[3:6]
    upper, lower = np.sqrt(_dot(above, above)), np.sqrt(_dot(below, below))
    slope = share * above / upper + (1.0 - share) * below / lower
    return upper + lower, line[0:3] - t, -(R @ slope)


@compiled
def _line_energy(R, t, lines, wrench):
    energy = 0.0
    for line in lines:
        length, arm, slope = line_path(R, t, line)
        slack = line[6] / (1.0 + line[8])
        force, _, area = smooth_tension(length / slack - 1.0, line[9])
        energy += line[7] * slack * area
        pull = line[7] * force * slope
        _push(wrench, arm, pull[0], pull[1], pull[2])
    return energy


@compiled
def _other_energy(R, t, weights, springs, wrench):
    """Dead weights on the tibia, and springs across the plateau that hold places of the femur."""
    energy = 0.0
    for weight in weights:
        arm = R @ weight[3:6].copy()
        energy -= weight[0] * (arm[0] + t[0]) + weight[1] * (arm[1] + t[1])
        energy -= weight[2] * (arm[2] + t[2])
        _push(wrench, arm, -weight[0], -weight[1], -weight[2])
    for spring in springs:
        arm = spring[0:3] - t
        stretch = R.T @ arm - spring[3:6]
        stretch[1] = 0.0
        energy += 0.5 * spring[6] * _dot(stretch, stretch)
        pull = -spring[6] * (R @ stretch)
        _push(wrench, arm, pull[0], pull[1], pull[2])
    return energy


@compiled
def energy_of(R, t, load, knee, listed, gradient, touching):
    """Energy [N mm], and how many points touch, whose numbers are put into `touching`.

    `gradient` by the tangent step, [N] throughout, shape ``(5,)``, is filled.

    `load` is varus and internal moment [N mm], anterior, distraction and lateral force [N].
    """
    surface, field, lines, weights, springs, torsion, pads, wide = knee
    wrench = np.zeros(6)
    energy, n = _contact_energy(R, t, surface, field, listed, wrench, touching)
    energy += _line_energy(R, t, lines, wrench)
    energy += _other_energy(R, t, weights, springs, wrench)
    energy += _pad_energy(R, t, pads, wide, wrench)
    axes = joint_axes(R)
    e2, e3 = axes[0], axes[1]
    place = grood_suntay(R, t)
    twist = place[4] - torsion[1]
    energy += 0.5 * torsion[0] * twist * twist - load[0] * place[3] - load[1] * place[4]
    down = np.array([-np.sin(place[5]), -np.cos(place[5]), 0.0])
    force = load[2] * e2 + load[3] * down
    force[2] += load[4]
    energy -= _dot(force, t)
    gradient[0] = (_dot(wrench, e2) - load[0]) / LEVER
    gradient[1] = (_dot(wrench, e3) + torsion[0] * twist - load[1]) / LEVER
    gradient[2:5] = wrench[3:6] - force
    return energy, n
