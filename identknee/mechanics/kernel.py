"""The equilibria along a tree of load paths: minima of the energy, followed branch by branch."""

import math

import numpy as np

from identknee.mechanics.compiled import compiled, compiled_apart
from identknee.mechanics.elements import contact_centres, sum_elements
from identknee.mechanics.energy import (
    contact_columns,
    evaluate,
    evaluate_there,
    motion_axes,
    parameter_columns,
    place_tibia,
)
from identknee.mechanics.memory import (
    N_LISTED,
    N_TOUCHING,
    EvaluationMemory,
    PathMemory,
    Segment,
    SolverMemory,
    State,
    Workspace,
)
from identknee.mechanics.small_matrices import (
    factorise,
    residual_norm,
    scale_of,
    scaled_norm,
    substitute,
    trust_region_step,
)

# N and mm; a solve this close, by either, takes one Newton step more, unmeasured, which squares the
# error: far below what a difference between two ways of solving may be (1e-9 mm). The Hessian stays
# that of the pose before, off by as much as stiff contact changes within the step.
RESIDUAL_TOLERANCE = 3e-6
LAST_STEP = 3e-7
MOST_HALVINGS = 10  # of the way from one node of the load path to the next
SMALLEST_STEP = 0.5**MOST_HALVINGS
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
def find_minimum(flexion, state, load, farthest, contact, field, ligaments, work, g):
    """Move the pose of a state to a minimum of the energy; return (outcome, residual).

    A Newton step inside a trust region on the energy. `farthest` [mm] ends the search when the
    pose moves farther than that from where it began. Its derivatives are those of the last pose
    evaluated; `g` becomes the gradient there.
    """
    q, H, h, _ = state
    evaluation = work.evaluation
    L, right, step, trial, g_new, H_new, h_new, start = work.solver
    for i in range(5):
        start[i] = q[i]
    energy = evaluate(flexion, q, load, contact, field, ligaments, evaluation, g, H, h)
    residual = residual_norm(g)
    radius = 3.0
    is_close = False
    for _ in range(MOST_ITERATIONS):
        if residual < RESIDUAL_TOLERANCE:
            is_close = True
            break
        if residual < SLACK_RESIDUAL and not factorise(H, -FLOOR_MARGIN, L):
            break
        shift = trust_region_step(g, H, radius, L, right, step)
        length = scaled_norm(step)
        if shift == 0.0 and length < LAST_STEP:
            is_close = True
            break
        predicted = 0.0
        for i in range(5):
            trial[i] = q[i] + step[i]
            s = 0.0
            for j in range(5):
                s += H[i, j] * step[j]
            predicted -= step[i] * (g[i] + 0.5 * s)
        energy_new = evaluate(
            flexion, trial, load, contact, field, ligaments, evaluation, g_new, H_new, h_new
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
    if not is_close:
        return NO_EQUILIBRIUM, residual
    factorise(H, 0.0, L)
    substitute(L, g, step)
    for i in range(5):
        q[i] -= step[i]
    return CONVERGED, residual


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
def copy_state(state, to):
    """Copy an equilibrium."""
    for i in range(5):
        to.pose[i], to.tangent[i] = state.pose[i], state.tangent[i]
        to.gradient_by_flexion[i] = state.gradient_by_flexion[i]
        for j in range(5):
            to.hessian[i, j] = state.hessian[i, j]


@compiled
def row_of(states, n):
    """State n of several, to be read and written."""
    return State(
        states.pose[n], states.hessian[n], states.gradient_by_flexion[n], states.tangent[n]
    )


@compiled
def follow(segment, guess, guessed, contact, field, ligaments, work, g):
    """Follow the path of equilibria from one end of a segment to the other.

    ``work.path.here`` is the state before and becomes the state after, or the last stable one
    reached. A step is accepted when it agrees with the tangents at both of its ends, else it is
    halved: on a smooth branch the disagreement vanishes with the step, across a jump it stays.
    States found too far away for one step are kept and looked at again from closer by. `guess` is a
    pose to try first at the segment's end, if `guessed`.

    Returns (outcome, share of the segment reached, residual, number of solves).
    """
    L, right = work.solver.factor, work.solver.right
    here, there, far, goals, load, change = work.path
    flexion_change = segment.flexion_after - segment.flexion_before
    for i in range(5):
        change[i] = segment.load_after[i] - segment.load_before[i]
    reached, share, n_far, residual, solves = 0.0, 1.0, 0, 0.0, 0
    tangent(here, change, flexion_change, L, right)
    while reached < 1.0:
        share = min(share, 1.0 - reached)
        goal = reached + share
        outcome = CONVERGED
        is_known = n_far > 0 and goal == goals[n_far - 1]
        if is_known:
            copy_state(row_of(far, n_far - 1), there)
        else:
            for i in range(5):
                there.pose[i] = guess[i] if guessed else here.pose[i] + share * here.tangent[i]
                load[i] = segment.load_before[i] + goal * change[i]
            angle = segment.flexion_before + goal * flexion_change
            outcome, residual = find_minimum(
                angle, there, load, LARGEST_MOVE, contact, field, ligaments, work, g
            )
            solves += 1
            tangent(there, change, flexion_change, L, right)
        tolerance = GUESS_TOLERANCE if guessed else 1.0
        if outcome == CONVERGED and not off_branch(here, there, share, tolerance):
            copy_state(there, here)
            reached = goal
            n_far -= is_known
            share = goals[n_far - 1] - reached if n_far > 0 else 2.0 * share
        elif guessed:
            guessed = False
        else:
            if outcome == CONVERGED and not is_known:
                copy_state(there, row_of(far, n_far))
                goals[n_far] = goal
                n_far += 1
            share *= 0.5
            if share < SMALLEST_STEP:
                free = not factorise(here.hessian, -10.0 * FLOOR_MARGIN, L)
                return UNCONSTRAINED if free else FOLD, reached, residual, solves
    return CONVERGED, 1.0, residual, solves


@compiled
def sensitivities(flexion, q, load, H, contact, field, ligaments, work, columns, S, contact_sums):
    """Write dq / dp = -H^-1 d gradient / dp into S (5, 2m), or (5, 2m + 2) with contact.

    The parameters are stiffness and reference strain of m ligaments, then the logarithm of the
    contact modulus and the exponent of the contact law. With contact, the sums over its elements
    are written to `contact_sums`.
    """
    evaluation, solver, m = work.evaluation, work.solver, ligaments.femoral.shape[0]
    R, t, axes = evaluation.rotation, evaluation.translation, evaluation.axes
    L, right, step = solver.factor, solver.right, solver.step
    if S.shape[1] > 2 * m:
        evaluate_there(flexion, q, load, contact, field, ligaments, work)
        n_touching = evaluation.counts[N_TOUCHING]
        contact_columns(n_touching, evaluation.elements, axes, columns, 2 * m)
        sum_elements(n_touching, evaluation.elements, contact_sums)
    place_tibia(flexion, q, R, t)
    motion_axes(flexion, R, t, axes)
    parameter_columns(R, t, ligaments, axes, evaluation.line, columns)
    factorise(H, 0.0, L)
    for j in range(S.shape[1]):
        for i in range(5):
            right[i] = -columns[i, j]
        substitute(L, right, step)
        for i in range(5):
            S[i, j] = step[i]


@compiled
def empty_states(n):
    """States to be written to."""
    return State(np.zeros((n, 5)), np.zeros((n, 5, 5)), np.zeros((n, 5)), np.zeros((n, 5)))


@compiled
def workspace(n_points, n_ligaments):
    """Memory for one thread's work, allocated once a simulation."""
    n = n_points + n_ligaments + 1
    counts = np.zeros(4, np.int64)
    counts[N_LISTED] = -1
    solver = SolverMemory(
        factor=np.zeros((5, 5)),
        right=np.zeros(5),
        step=np.zeros(5),
        trial=np.zeros(5),
        trial_gradient=np.zeros(5),
        trial_hessian=np.zeros((5, 5)),
        trial_gradient_by_flexion=np.zeros(5),
        start=np.zeros(5),
    )
    path = PathMemory(
        here=row_of(empty_states(1), 0),
        there=row_of(empty_states(1), 0),
        far=empty_states(MOST_HALVINGS + 1),
        goals=np.zeros(MOST_HALVINGS + 1),
        load=np.zeros(5),
        change=np.zeros(5),
    )
    evaluation = EvaluationMemory(
        elements=np.zeros((13, n)),
        fractions=np.zeros((4, n)),
        listed=np.zeros((4, n)),
        counts=counts,
        listed_pose=np.zeros(12),
        cells=np.zeros(n, np.int64),
        eighths=np.zeros(n, np.int64),
        pose=np.full(5, np.inf),
        rotation=np.zeros(9),
        translation=np.zeros(3),
        field_rotation=np.zeros(9),
        field_translation=np.zeros(3),
        sums=np.zeros(39),
        axes=np.zeros((9, 3)),
        touching=np.zeros(n, np.int64),
        which=np.zeros(n, np.int64),
        moved=np.zeros((6, n)),
        weights=np.zeros((n, 36)),
        line=np.zeros(10),
    )
    return Workspace(evaluation=evaluation, solver=solver, path=path)


@compiled
def read_state(results, n, state):
    """Make the state that of node n, but for its tangent."""
    for i in range(5):
        state.pose[i] = results.poses[n, i]
        state.gradient_by_flexion[i] = results.gradient_by_flexion[n, i]
        for j in range(5):
            state.hessian[i, j] = results.hessians[n, i, j]


@compiled
def write_state(state, results, n):
    """Keep the state as that of node n."""
    for i in range(5):
        results.poses[n, i] = state.pose[i]
        results.gradient_by_flexion[n, i] = state.gradient_by_flexion[i]
        for j in range(5):
            results.hessians[n, i, j] = state.hessian[i, j]


@compiled_apart
def simulate_path(
    nodes, chosen, starts, guesses, has_guess, contact, field, ligaments, derivatives, results
):
    """Solve the chosen nodes of a tree of load paths, each from its parent's state.

    Parents come first, or were solved before. A node n without parent starts the search at the
    pose ``starts[n]``. `results` are the arrays of `identknee.mechanics.memory.Equilibria`, to be
    written to.
    """
    work = workspace(contact.points.shape[1], ligaments.femoral.shape[0])
    g, here, far = np.zeros(5), work.path.here, nodes.farthest[0]
    columns = np.zeros((5, results.sensitivities.shape[2]))
    for n in chosen:
        before = nodes.parent[n]
        if before < 0:
            for i in range(5):
                here.pose[i] = starts[n, i]
            outcome, results.residuals[n] = find_minimum(
                nodes.flexion[n], here, nodes.loads[n], far, contact, field, ligaments, work, g
            )
            results.reached[n] = 1.0
            results.solves[n] = 1
        else:
            read_state(results, before, here)
            segment = Segment(
                flexion_before=nodes.flexion[before],
                flexion_after=nodes.flexion[n],
                load_before=nodes.loads[before],
                load_after=nodes.loads[n],
            )
            outcome = results.codes[before]
            results.reached[n] = 0.0
            if outcome == CONVERGED:
                outcome, results.reached[n], results.residuals[n], results.solves[n] = follow(
                    segment, guesses[n], has_guess, contact, field, ligaments, work, g
                )
        results.codes[n] = outcome
        write_state(here, results, n)
        # The last pose evaluated may be one that was searched on the way, or not kept.
        angle = nodes.flexion[n]
        if before >= 0 and outcome != CONVERGED:
            angle += (1.0 - results.reached[n]) * (nodes.flexion[before] - angle)
        evaluate_there(angle, here.pose, nodes.loads[n], contact, field, ligaments, work)
        contact_centres(contact, work.evaluation, results.centres[n])
        if derivatives and outcome == CONVERGED:
            sensitivities(
                nodes.flexion[n],
                here.pose,
                nodes.loads[n],
                here.hessian,
                contact,
                field,
                ligaments,
                work,
                columns,
                results.sensitivities[n],
                results.contact_sums[n],
            )
