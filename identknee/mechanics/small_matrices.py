"""Linear algebra of the five coordinates, without memory of its own."""

import math

from identknee.mechanics.compiled import compiled
from identknee.mechanics.memory import ROTATION_SCALE


@compiled
def scale_of(i):
    """Millimetres that one unit of coordinate i is worth."""
    return ROTATION_SCALE if i < 2 else 1.0


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
