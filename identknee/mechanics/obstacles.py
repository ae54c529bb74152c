"""Lines that wrap around a cylinder or a sphere: length, direction and stiffness in closed form.

The shortest way around a cylinder is straight once its surface is rolled out, and that around a
sphere lies in one plane. Both follow from the way around a circle: two tangents and an arc.
"""

import math

from identknee.mechanics.compiled import compiled, compiled_once

# The second derivative of the length jumps where a line begins to touch. It is made continuous over
# so small an angle that the length is wrong by LENGTH_ERROR [mm] at most: with tangents a and b the
# arc saves a b / (a + b) angle^2 / 2, of which blending loses the share BLENDED.
LENGTH_ERROR = 0.001
BLENDED = 0.12518  # the maximum of s^2 (1 - blend(s)), s from 0 to 1
MOST_BLENDING = 0.25  # rad
# Rows and columns of a symmetric matrix in the order xx yy zz xy xz yz.
FIRST, SECOND = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
# A surface is no nearer to an end than this share of its radius, where tangents would be none.
NEAREST = 1e-6


@compiled
def straight_shape(e0, e1, e2, shape):
    """Write length (1), gradient (3) and Hessian (xx yy zz xy xz yz) of a straight line."""
    length = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
    g0, g1, g2 = e0 / length, e1 / length, e2 / length
    shape[0], shape[1], shape[2], shape[3] = length, g0, g1, g2
    a = 1.0 / length
    shape[4], shape[5], shape[6] = a - a * g0 * g0, a - a * g1 * g1, a - a * g2 * g2
    shape[7], shape[8], shape[9] = -a * g0 * g1, -a * g0 * g2, -a * g1 * g2


@compiled
def way_around(start, end, angle, radius):
    """Length of the way around a circle, with derivatives by the distance of its end and `angle`.

    Parameters
    ----------
    start, end
        Distances of both ends from the centre, not below `radius`.
    angle
        From the start to the end, on the side of the way [rad].

    Returns
    -------
    touches
        Whether it is no straight line.
    length, by_end, by_angle, by_end_end, by_end_angle, by_angle_angle
        The length and its derivatives.
    """
    before, after = (
        math.sqrt(start * start - radius * radius),
        math.sqrt(end * end - radius * radius),
    )
    arc = angle - math.atan2(before, radius) - math.atan2(after, radius)
    if arc <= 0.0:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    wrapped, w_e = before + after + radius * arc, after / end
    w_ee = radius * radius / (end * end * after)
    blending = min(MOST_BLENDING, math.sqrt(2.0 * LENGTH_ERROR / (BLENDED * before)))
    if arc >= blending:
        return True, wrapped, w_e, radius, w_ee, 0.0, 0.0
    cos, sin = math.cos(angle), math.sin(angle)
    straight = math.sqrt(start * start + end * end - 2.0 * start * end * cos)
    s_e, s_a = (end - start * cos) / straight, start * end * sin / straight
    s_ee = (1.0 - s_e * s_e) / straight
    s_ea = (start * sin - s_e * s_a) / straight
    s_aa = (start * end * cos - s_a * s_a) / straight
    x, x_e, x_a = wrapped - straight, w_e - s_e, radius - s_a
    x_ee, x_ea, x_aa = w_ee - s_ee, -s_ea, -s_aa
    # How the arc changes with the distance of the end; with the angle it changes as much as that.
    c_e = -radius / (end * after)
    c_ee = radius * (after * after + end * end) / (end * end * after * after * after)
    s = arc / blending
    h = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    h_c = 30.0 * s * s * (1.0 - s) * (1.0 - s) / blending
    h_cc = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / (blending * blending)
    return (
        True,
        straight + h * x,
        s_e + h * x_e + x * h_c * c_e,
        s_a + h * x_a + x * h_c,
        s_ee + h * x_ee + 2.0 * h_c * x_e * c_e + x * (h_cc * c_e * c_e + h_c * c_ee),
        s_ea + h * x_ea + h_c * (x_e + x_a * c_e) + x * h_cc * c_e,
        s_aa + h * x_aa + 2.0 * h_c * x_a + x * h_cc,
    )


@compiled
def wrapped_shape(start, point, centre, axis, turn, radius, shape):
    """Write length, gradient and Hessian by `point` of the way there around an obstacle.

    Parameters
    ----------
    start, point
        Where the way begins and ends [mm], three numbers each. An end inside the obstacle counts as
        on its surface.
    centre, axis
        Of the obstacle; the axis is a unit vector, of a sphere (0, 0, 0).
    turn
        1 where the way goes around the axis by the right hand, -1 where against.
    radius
        Of the obstacle [mm].
    shape
        Ten numbers, as `straight_shape` writes them.

    Returns
    -------
    touches
        Whether the line is not straight.
    """
    n0, n1, n2 = start[0] - centre[0], start[1] - centre[1], start[2] - centre[2]
    p0, p1, p2 = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    a0, a1, a2 = axis[0], axis[1], axis[2]
    along, before = a0 * p0 + a1 * p1 + a2 * p2, a0 * n0 + a1 * n1 + a2 * n2
    straight_shape(p0 - n0, p1 - n1, p2 - n2, shape)
    n0, n1, n2 = n0 - before * a0, n1 - before * a1, n2 - before * a2
    p0, p1, p2 = p0 - along * a0, p1 - along * a1, p2 - along * a2
    least = radius * (1.0 + NEAREST)
    far_start = max(math.sqrt(n0 * n0 + n1 * n1 + n2 * n2), least)
    far = math.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
    is_sphere = a0 == 0.0 and a1 == 0.0 and a2 == 0.0
    c0, c1, c2 = n1 * p2 - n2 * p1, n2 * p0 - n0 * p2, n0 * p1 - n1 * p0
    cos = n0 * p0 + n1 * p1 + n2 * p2
    if is_sphere:
        sin = math.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
        angle = math.atan2(sin, cos)
    else:
        angle = turn * math.atan2(a0 * c0 + a1 * c1 + a2 * c2, cos)
        if angle < -0.5 * math.pi:
            angle += 2.0 * math.pi
    touches, way, w_e, w_a, w_ee, w_ea, w_aa = way_around(far_start, max(far, least), angle, radius)
    if not touches:
        return False
    if far < least:
        w_e, w_ee, w_ea = 0.0, 0.0, 0.0
    # Unit vectors: out from the centre, in the plane of the way, and across it.
    a, e = (a0, a1, a2), (p0 / far, p1 / far, p2 / far)
    b = (c0 / sin, c1 / sin, c2 / sin) if is_sphere else (turn * a0, turn * a1, turn * a2)
    t = (b[1] * e[2] - b[2] * e[1], b[2] * e[0] - b[0] * e[2], b[0] * e[1] - b[1] * e[0])
    w_t = w_a / far
    ee, et = w_ee, (w_ea - w_t) / far
    tt = w_aa / (far * far) + w_e / far
    bb = (w_e + w_t * math.cos(angle) / math.sin(angle)) / far if is_sphere else 0.0
    g = (w_e * e[0] + w_t * t[0], w_e * e[1] + w_t * t[1], w_e * e[2] + w_t * t[2])
    # Rolled out, length^2 = way^2 + rise^2.
    rise = 0.0 if is_sphere else along - before
    length = math.sqrt(way * way + rise * rise)
    r, z = way / length, rise / length
    d = (r * g[0] + z * a[0], r * g[1] + z * a[1], r * g[2] + z * a[2])
    bent = 0.0 if is_sphere else 1.0 / length
    shape[0], shape[1], shape[2], shape[3] = length, d[0], d[1], d[2]
    for k in range(6):
        i, j = FIRST[k], SECOND[k]
        curved = ee * e[i] * e[j] + et * (e[i] * t[j] + e[j] * t[i]) + tt * t[i] * t[j]
        curved += bb * b[i] * b[j]
        shape[4 + k] = r * curved + bent * (g[i] * g[j] + a[i] * a[j] - d[i] * d[j])
    return True


@compiled
def wrapped_element(line, R, t, course):
    """Write what a line around an obstacle does to the tibia, as an element in femoral axes.

    A line around an obstacle of the tibia pulls where it leaves the femur: at that point, and not
    at its tibial insertion, is the element's point.

    Parameters
    ----------
    line
        A record of `identknee.mechanics.memory.LINE`.
    R, t
        Rotation (9) and origin (3) of the tibia in femoral axes.
    course
        A record of `identknee.mechanics.memory.COURSE`: to be written are `point`, relative to the
        tibial origin, and `shape`, whose derivatives are those by the position of the point.
    """
    point, end, shape = course.point, course.end, course.shape
    for i in range(3):
        end[i] = t[i]
        for j in range(3):
            end[i] += R[3 * i + j] * line.tibial[j]
    if line.obstacle_is_tibial == 0.0:
        for i in range(3):
            point[i] = end[i] - t[i]
        centre, axis = line.obstacle_centre, line.obstacle_axis
        wrapped_shape(line.femoral, end, centre, axis, 1.0, line.obstacle_radius, shape)
        return
    centre, axis = course.centre, course.axis
    for i in range(3):
        point[i] = line.femoral[i] - t[i]
        centre[i], axis[i] = t[i], 0.0
        for j in range(3):
            centre[i] += R[3 * i + j] * line.obstacle_centre[j]
            axis[i] += R[3 * i + j] * line.obstacle_axis[j]
    wrapped_shape(end, line.femoral, centre, axis, -1.0, line.obstacle_radius, shape)
    # The tibia moves against what moves the femur.
    for i in range(1, 4):
        shape[i] = -shape[i]


@compiled_once
def write_shapes(lines, rotations, origins, course, shapes):
    """Write the shapes of lines around obstacles at poses, in tibial axes.

    Parameters
    ----------
    lines
        k records of `identknee.mechanics.memory.LINE`.
    rotations, origins
        Of the tibia in femoral axes, shape ``(n, 9)`` and ``(n, 3)``.
    course
        Memory, a record of `identknee.mechanics.memory.COURSE`.
    shapes
        Shape ``(n, k, 13)``: the femoral end, then the shape, by the femoral end where the obstacle
        is the tibia's and else by the tibial one.
    """
    end, centre, axis = course.end, course.centre, course.axis
    for n in range(len(rotations)):
        R, t = rotations[n], origins[n]
        for k in range(len(lines)):
            line = lines[k]
            for i in range(3):
                end[i], centre[i], axis[i] = 0.0, 0.0, 0.0
                for j in range(3):
                    end[i] += R[3 * j + i] * (line.femoral[j] - t[j])
                    centre[i] += R[3 * j + i] * (line.obstacle_centre[j] - t[j])
                    axis[i] += R[3 * j + i] * line.obstacle_axis[j]
                shapes[n, k, i] = end[i]
            radius, shape = line.obstacle_radius, shapes[n, k, 3:]
            if line.obstacle_is_tibial != 0.0:
                own = line.obstacle_centre
                wrapped_shape(line.tibial, end, own, line.obstacle_axis, -1.0, radius, shape)
            else:
                wrapped_shape(end, line.tibial, centre, axis, 1.0, radius, shape)
