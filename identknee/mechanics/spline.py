"""Value, gradient and Hessian of a cubic spline at one point."""

import numpy as np

from identknee.mechanics.compiled import compiled

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
