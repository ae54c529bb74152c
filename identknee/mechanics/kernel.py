"""The equilibria along a tree of load paths: minima of the energy, followed branch by branch."""

import math

import numpy as np

from identknee.mechanics.compiled import compiled, compiled_apart
from identknee.mechanics.elements import contact_centres
from identknee.mechanics.energy import (
    contact_columns,
    evaluate,
    motion_axes,
    parameter_columns,
    place_tibia,
)
from identknee.mechanics.small_matrices import (
    factorise,
    residual_norm,
    scale_of,
    scaled_norm,
    substitute,
    trust_region_step,
)

# N; a solve this close takes one Newton step more, unmeasured, which squares the error: far below
# what a difference between two ways of solving may be (1e-9 mm).
RESIDUAL_TOLERANCE = 3e-6
SMALLEST_STEP = 1.0 / 1024.0  # of the way from one node of the load path to the next
LARGEST_MOVE = 6.0  # mm; a corrector that goes farther from its prediction has left the branch
BRANCH_ABSOLUTE = 0.1  # mm; disagreement of a step with its end tangents that is always allowed
BRANCH_RELATIVE = 0.25  # the same, as a share of the step's length
# A guess must agree so much better with its neighbour that a search without one ends there too.
GUESS_TOLERANCE = 0.25
FLOOR_MARGIN = 1e-3  # N/mm; below this stiffness a pose is not unique
SLACK_RESIDUAL = 1e-3  # N; with less than this and no stiffness, the search would creep on for ever
MOST_ITERATIONS = 200

CONVERGED, FOLD, NO_EQUILIBRIUM, UNCONSTRAINED = 0, 1, 2, 3


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
        energy_new = evaluate(
            flexion, trial, load, contact, field, ligaments, work, g_new, H_new, h_new
        )
        residual_new = residual_norm(g_new)
        rounding = 1e-13 * (abs(energy) + 1e4)
        gained = energy - energy_new
        if gained > 0.1 * predicted - rounding and (
            predicted > rounding or residual_new < residual
        ):
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
def off_branch(before, after, tangent_before, tangent_after, share, tolerance):
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
    return math.sqrt(off) > tolerance * allowed


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
        tolerance = GUESS_TOLERANCE if guessed else 1.0
        if outcome == CONVERGED and not off_branch(q, q_new, before, after, share, tolerance):
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
def sensitivities(flexion, q, load, H, contact, field, ligaments, work, columns, S):
    """Write dq / dp = -H^-1 d gradient / dp into S (5, 2m), or (5, 2m + 2) with contact.

    The parameters are stiffness and reference strain of m ligaments, then the logarithm of the
    contact modulus and the exponent of the contact law.
    """
    R, t, axes, m = work[6], work[7], work[9], ligaments[0].shape[0]
    L, right, step = work[10][0], work[10][1], work[10][2]
    if S.shape[1] > 2 * m:
        g, h, H_again = work[10][3], work[10][4], work[10][5]
        evaluate(flexion, q, load, contact, field, ligaments, work, g, H_again, h)
        contact_columns(work[3][1], work[0], axes, columns, 2 * m)
    place_tibia(flexion, q, R, t)
    motion_axes(flexion, R, t, axes)
    parameter_columns(R, t, ligaments, axes, work[16], columns)
    factorise(H, 0.0, L)
    for j in range(S.shape[1]):
        for i in range(5):
            right[i] = -columns[i, j]
        substitute(L, right, step)
        for i in range(5):
            S[i, j] = step[i]


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
        np.zeros((13, n)),  # 0 elements
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
        np.zeros(10),  # 16 length, gradient and Hessian of a line
    )


@compiled_apart
def simulate_path(
    nodes, start, guesses, has_guess, contact, field, ligaments, derivatives, results
):
    """Solve every node of a tree of load paths, each from its parent's state.

    `nodes`: flexion (n), load (n, 5), parent (n); a parent of -1 starts the search at `start`.
    `results`: poses (n, 5), Hessians (n, 5, 5), sensitivities (n, 5, 2m or 2m + 2), outcomes (n),
    residuals (n), share of the path from the parent that was reached (n), d gradient / d flexion
    (n, 5), solves (n), contact force and centres (n, compartments, 7).
    """
    flexion, loads, parent = nodes
    poses, hessians, slopes, outcomes, residuals, reached, flexed, solves, centres = results
    work = workspace(contact[0].shape[1], ligaments[0].shape[0])
    g, q, H, h = np.zeros(5), np.zeros(5), np.zeros((5, 5)), np.zeros(5)
    path = np.zeros(12)
    columns = np.zeros((5, slopes.shape[2]))
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
            sensitivities(
                flexion[n], q, loads[n], H, contact, field, ligaments, work, columns, slopes[n]
            )
