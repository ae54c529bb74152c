"""The equilibria along a tree of load paths: minima of the energy, followed branch by branch."""

import math

import numpy as np

from identknee.mechanics.compiled import compiled, compiled_once
from identknee.mechanics.contact_elements import (
    contact_centres,
    contact_columns,
    sum_contact,
    write_pushes,
)
from identknee.mechanics.elements import write_sums
from identknee.mechanics.energy import (
    evaluate_there,
    motion_axes,
    parameter_columns,
    place_tibia,
)
from identknee.mechanics.memory import (
    CONVERGED,
    FOLD,
    MOST_HALVINGS,
    UNCONSTRAINED,
    Segment,
)
from identknee.mechanics.minimum import FLOOR_MARGIN, find_minimum
from identknee.mechanics.small_matrices import factorise, scale_of, substitute
from identknee.mechanics.states import copy_point, read_state, write_state

SMALLEST_STEP = 0.5**MOST_HALVINGS
LARGEST_MOVE = 6.0  # mm; a corrector that goes farther from its prediction has left the branch
BRANCH_ABSOLUTE = 0.1  # mm; disagreement of a step with its end tangents that is always allowed
BRANCH_RELATIVE = 0.25  # the same, as a share of the step's length
# A guess must agree so much better with its neighbour that a search without one ends there too.
GUESS_TOLERANCE = 0.25


@compiled
def tangent(state, load_change, flexion_change, L, right):
    """Write how an equilibrium moves when load and flexion change: -H^-1 d(gradient)."""
    for i in range(5):
        right[i] = load_change[i] - state.gradient_by_flexion[i] * flexion_change
    if factorise(state.hessian, 0.0, L):
        substitute(L, right, state.tangent)
    else:
        for i in range(5):
            state.tangent[i] = 0.0


@compiled
def off_branch(before, after, share, tolerance):
    """Whether a step disagrees with the tangents at its ends more than a smooth branch would.

    The disagreement is weighed against the way the tangents explain, of which a jump is no part.
    """
    off, length, explained = 0.0, 0.0, 0.0
    for i in range(5):
        change = after.pose[i] - before.pose[i]
        mean = 0.5 * share * (before.tangent[i] + after.tangent[i])
        off += ((change - mean) * scale_of(i)) ** 2
        length += (change * scale_of(i)) ** 2
        explained += (mean * scale_of(i)) ** 2
    allowed = BRANCH_ABSOLUTE + BRANCH_RELATIVE * math.sqrt(min(length, explained))
    return math.sqrt(off) > tolerance * allowed


@compiled
def follow(segment, guess, guessed, contact, field, ligaments, work):
    """Follow the path of equilibria from one end of a segment to the other.

    ``work.path.here`` is the state before and becomes the state after, or the last stable one
    reached. A step is accepted when it agrees with the tangents at both of its ends, else it is
    halved: on a smooth branch the disagreement vanishes with the step, across a jump it stays.
    States found too far away for one step are kept and looked at again from closer by. `guess` is a
    pose to try first at the segment's end, if `guessed`.

    Returns (outcome, share of the segment reached, residual, number of solves).
    """
    L, right, path = work.solver.factor, work.solver.right, work.path
    here, there, far, goals = path.here, path.there, path.far, path.goals
    load, change = path.load, path.change
    flexion_change = segment.flexion_after - segment.flexion_before
    for i in range(5):
        change[i] = segment.load_after[i] - segment.load_before[i]
    reached, share, n_far, residual, solves = 0.0, 1.0, np.int64(0), 0.0, 0
    tangent(here, change, flexion_change, L, right)
    while reached < 1.0:
        share = min(share, 1.0 - reached)
        goal = reached + share
        outcome = CONVERGED
        is_known = n_far > 0 and goal == goals[n_far - 1]
        if is_known:
            copy_point(far[n_far - 1], there)
        else:
            for i in range(5):
                there.pose[i] = guess[i] if guessed else here.pose[i] + share * here.tangent[i]
                load[i] = segment.load_before[i] + goal * change[i]
            angle = segment.flexion_before + goal * flexion_change
            outcome, residual = find_minimum(
                angle, there, load, LARGEST_MOVE, contact, field, ligaments, work
            )
            solves += 1
            tangent(there, change, flexion_change, L, right)
        tolerance = GUESS_TOLERANCE if guessed else 1.0
        if outcome == CONVERGED and not off_branch(here, there, share, tolerance):
            copy_point(there, here)
            reached = goal
            n_far -= is_known
            share = goals[n_far - 1] - reached if n_far > 0 else 2.0 * share
        elif guessed:
            guessed = False
        else:
            if outcome == CONVERGED and not is_known:
                copy_point(there, far[n_far])
                goals[n_far] = goal
                n_far += 1
            share *= 0.5
            if share < SMALLEST_STEP:
                free = not factorise(here.hessian, -10.0 * FLOOR_MARGIN, L)
                return UNCONSTRAINED if free else FOLD, reached, residual, solves
    return CONVERGED, 1.0, residual, solves


@compiled
def sensitivities(flexion, q, H, contact, ligaments, work, columns, S, contact_sums):
    """Write dq / dp = -H^-1 d gradient / dp into S (5, 2m), or (5, 2m + 2) with contact.

    The parameters are stiffness and reference strain of m ligaments, then the logarithm of the
    contact modulus and the exponent of the contact law. With contact, that of the pushes last
    written, the sums over its elements are written to `contact_sums`.
    """
    placed, solver, m = work.evaluation.placed, work.solver, len(ligaments)
    R, t, axes = placed.rotation, placed.translation, placed.axes
    L, right, step = solver.factor, solver.right, solver.step
    if S.shape[1] > 2 * m:
        contact_columns(work.evaluation, columns, 2 * m)
        total, _ = sum_contact(contact.law, placed, work.evaluation.expansion)
        write_sums(total, contact_sums)
    place_tibia(flexion, q, R, t)
    motion_axes(flexion, R, t, axes)
    parameter_columns(R, t, ligaments, axes, placed.line, columns)
    factorise(H, 0.0, L)
    for j in range(S.shape[1]):
        for i in range(5):
            right[i] = -columns[i, j]
        substitute(L, right, step)
        for i in range(5):
            S[i, j] = step[i]


@compiled_once
def simulate_path(
    nodes, starts, guesses, has_guess, contact, field, ligaments, derivatives, work, results
):
    """Solve the nodes of a tree of load paths, each from its parent's state, which comes before.

    A node n without parent starts the search at the pose ``starts[n]``. `results` are the arrays of
    `identknee.mechanics.memory.Equilibria`, to be written to. `work` holds no list and no
    evaluation.
    """
    here, load, columns = work.path.here, work.path.load, work.columns
    for n in range(len(nodes.parent)):
        before, angle = nodes.parent[n], nodes.flexion[n]
        for i in range(5):
            load[i] = nodes.loads[n, i]
        if before < 0:
            for i in range(5):
                here.pose[i] = starts[n, i]
            outcome, results.residuals[n] = find_minimum(
                angle, here, load, nodes.farthest, contact, field, ligaments, work
            )
            results.reached[n] = 1.0
            results.solves[n] = 1
        else:
            read_state(results, before, here)
            outcome = results.codes[before]
            results.reached[n] = 0.0
            if outcome == CONVERGED:
                segment = Segment(nodes.flexion[before], angle, nodes.loads[before], nodes.loads[n])
                outcome, results.reached[n], results.residuals[n], results.solves[n] = follow(
                    segment, guesses[n], has_guess, contact, field, ligaments, work
                )
            if outcome != CONVERGED:
                angle += (1.0 - results.reached[n]) * (nodes.flexion[before] - angle)
        results.codes[n] = outcome
        write_state(here, results, n)
        # The last pose evaluated may be one that was searched on the way, or not kept. Whatever the
        # load, contact is that of the pose.
        evaluate_there(angle, here.pose, load, contact, field, ligaments, work)
        write_pushes(contact.law, work.evaluation)
        contact_centres(contact, work.evaluation, results.centres[n])
        if derivatives and outcome == CONVERGED:
            slopes, sums = results.sensitivities[n], results.contact_sums[n]
            sensitivities(
                angle, here.pose, here.hessian, contact, ligaments, work, columns, slopes, sums
            )
