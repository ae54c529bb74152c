"""Equilibria of the virtual knee, compiled: its minimum of energy, followed along load paths."""

import numpy as np

from identknee.blind.energy import about_flexion_axis, candidates, energy_of, moved
from identknee.runs.compiling import compiled

FORCE_TOLERANCE = 2e-6
# Tangent step of the differenced Hessian [mm].
DIFFERENCE = 1e-4
ITERATIONS = 80
LARGEST_RADIUS = 1.5
# A tibial point moves by at most this many times the length of a step, and points this close [mm]
# are listed at least.
REACH = 1.8
LISTED = 0.6
# A step of the load path, in radians, N mm and N, and the poses it may move by before it is halved.
FLEXION_STEP = np.radians(5.0)
MOMENT_STEP = 2000.0
FORCE_STEP = 40.0
LONGEST_TURN = np.radians(5.0)
LONGEST_SHIFT = 3.0
SMALLEST_SHARE = 1.0 / 64.0
FOUND, STUCK, SNAPPED = 0, 1, 2


@compiled
def stiffness_of(R, t, flexion, load, knee, touching, gradient):
    """Hessian [N/mm] by differences of the gradient, shape ``(5, 5)``."""
    H = np.empty((5, 5))
    step, other, again = np.zeros(5), np.empty(5), np.empty_like(touching)
    for i in range(5):
        step[:] = 0.0
        step[i] = DIFFERENCE
        new_R, new_t = moved(R, t, step, flexion)
        energy_of(new_R, new_t, load, knee, touching, other, again)
        H[i] = (other - gradient) / DIFFERENCE
    return 0.5 * (H + H.T)


@compiled
def _trust_step(H, gradient, radius):
    """Minimiser of the quadratic model within `radius` [mm], and its smallest eigenvalue."""
    values, vectors = np.linalg.eigh(H)
    inner = vectors.T @ gradient
    shift = max(0.0, 1e-9 - values[0])
    length = np.sqrt(np.sum((inner / (values + shift + 1e-12)) ** 2))
    if shift == 0.0 and length <= radius:
        return -(vectors @ (inner / values)), values[0]
    low, high = shift, shift + np.sqrt(np.sum(inner**2)) / radius + 1e-9
    for _ in range(60):
        middle = 0.5 * (low + high)
        if np.sqrt(np.sum((inner / (values + middle + 1e-12)) ** 2)) > radius:
            low = middle
        else:
            high = middle
    return -(vectors @ (inner / (values + high + 1e-12))), values[0]


@compiled
def minimum(R, t, flexion, load, knee):
    """Whether a minimum was found from a pose, the pose, and the Hessian [N/mm] there."""
    gradient, trial = np.empty(5), np.empty(5)
    n_points = len(knee.surface.points)
    touching, others = np.empty(n_points, np.int64), np.empty(n_points, np.int64)
    H, radius = np.zeros((5, 5)), 0.5 * LARGEST_RADIUS
    R, t = moved(R, t, np.zeros(5), flexion)
    # The points listed at a pose are enough until one of them may have moved by `left`.
    listed, left = candidates(R, t, knee.surface, knee.field, LISTED), LISTED
    energy, n = energy_of(R, t, load, knee, listed, gradient, touching)
    for _ in range(ITERATIONS):
        H = stiffness_of(R, t, flexion, load, knee, touching[:n], gradient)
        largest = np.max(np.abs(gradient))
        step, lowest = _trust_step(H, gradient, radius)
        if largest < FORCE_TOLERANCE and lowest > 0.0:
            return True, R, t, H
        length = REACH * np.sqrt(np.dot(step, step))
        if length > left:
            left = max(LISTED, 1.5 * length)
            listed = candidates(R, t, knee.surface, knee.field, left)
        new_R, new_t = moved(R, t, step, flexion)
        new, n_new = energy_of(new_R, new_t, load, knee, listed, trial, others)
        expected = -(np.dot(gradient, step) + 0.5 * np.dot(step, H @ step))
        gained = energy - new
        # Near the minimum the energy is rounded off and only the force is accurate enough.
        is_close = np.max(np.abs(trial)) < 0.5 * largest and gained > -1e-7
        if gained > 0.05 * expected or is_close:
            if gained > 0.75 * expected or is_close:
                radius = min(LARGEST_RADIUS, 2.0 * radius)
            R, t, energy, n = new_R, new_t, new, n_new
            gradient[:] = trial
            touching[:n] = others[:n]
            left -= length
        else:
            radius = 0.25 * min(radius, length / REACH)
            if radius < 1e-10:
                break
    return False, R, t, H


@compiled
def follow(R, t, flexions, loads, knee):
    """How a path of flexion and load, each from its first to its second, ended; pose and Hessian.

    Steps are halved until the pose moves little in each; one that still leaps has snapped.
    """
    change = loads[1] - loads[0]
    parts = max(
        abs(flexions[1] - flexions[0]) / FLEXION_STEP,
        np.max(np.abs(change[:2])) / MOMENT_STEP,
        np.max(np.abs(change[2:])) / FORCE_STEP,
        1.0,
    )
    full = 1.0 / np.ceil(parts)
    share, done = full, 0.0
    H = np.zeros((5, 5))
    while done < 1.0 - 1e-12:
        goal = min(1.0, done + share)
        turn = (goal - done) * (flexions[1] - flexions[0])
        flexion = flexions[0] + goal * (flexions[1] - flexions[0])
        start_R, start_t = about_flexion_axis(turn) @ R, about_flexion_axis(turn) @ t
        found, new_R, new_t, new_H = minimum(
            start_R, start_t, flexion, loads[0] + goal * change, knee
        )
        cosine = 0.5 * (np.trace(start_R.T @ new_R) - 1.0)
        shift = new_t - start_t
        leaps = cosine < np.cos(LONGEST_TURN) or np.sum(shift**2) > LONGEST_SHIFT**2
        if not found or leaps:
            share = 0.5 * share
            if share < SMALLEST_SHARE * full:
                return (SNAPPED if found else STUCK), R, t, H
            continue
        R, t, H, done = new_R, new_t, new_H, goal
        share = min(full, 1.5 * share)
    return FOUND, R, t, H
