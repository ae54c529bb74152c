"""The equilibria along a tree of load paths: minima of the energy, followed branch by branch."""

import math

import numpy as np

from identknee.mechanics.compiled import compiled, compiled_once
from identknee.mechanics.contact_elements import (
    contact_centres,
    contact_columns,
    force_centres,
    sum_contact,
    write_contact_forces,
)
from identknee.mechanics.elements import write_sums
from identknee.mechanics.energy import (
    copy,
    evaluate,
    evaluate_if_moved,
    evaluate_near,
    factorise,
    motion_axes,
    parameter_columns,
    place_tibia,
    residual_norm,
    scale_of,
    scaled_norm,
    substitute,
    trust_region_step,
)
from identknee.mechanics.memory import (
    BEGINNINGS,
    CONVERGED,
    FOLD,
    HOLDS,
    MOST_HALVINGS,
    N_PUSHING,
    N_TOUCHING,
    NO_EQUILIBRIUM,
    UNCONSTRAINED,
    Segment,
)
from identknee.mechanics.meniscus_elements import (
    add_menisci,
    meniscus_columns,
    write_meniscus_forces,
)


@compiled
def copy_point(point, to):
    """Copy a pose with all that belongs to it."""
    copy(point.pose, to.pose)
    copy(point.gradient, to.gradient)
    copy(point.gradient_by_flexion, to.gradient_by_flexion)
    copy(point.tangent, to.tangent)
    for i in range(5):
        copy(point.hessian[i], to.hessian[i])


@compiled
def read_state(results, n, state):
    """Make the state that of node n, but for its tangent."""
    copy(results.poses[n], state.pose)
    copy(results.gradient_by_flexion[n], state.gradient_by_flexion)
    for i in range(5):
        copy(results.hessians[n, i], state.hessian[i])


@compiled
def write_state(state, results, n):
    """Keep the state as that of node n."""
    copy(state.pose, results.poses[n])
    copy(state.gradient_by_flexion, results.gradient_by_flexion[n])
    for i in range(5):
        copy(state.hessian[i], results.hessians[n, i])


# N and mm; a search this close, by either, ends at the minimum of the energy with the contact
# expanded there. What that leaves out is far below what a difference between two ways of solving
# may be (1e-9 mm), and the Hessian is right to 1e-6.
RESIDUAL_TOLERANCE = 3e-6
LAST_STEP = 3e-7
# mm; of an equilibrium on the way to that of a released knee, which is not kept.
LAST_STEP_ON_THE_WAY = 0.02
EXPANSION_REACH = 1.0  # mm; farther away contact is not what its expansion says
EXPANSION_ERROR = 0.01  # 1/mm; of a minimum found so far from where the expansion is exact, squared
SETTLED = 1e-8  # mm; a Newton step as short leaves nothing above rounding
MOST_NEAR_STEPS = 12
FLOOR_MARGIN = 1e-3  # N/mm; below this stiffness a pose is not unique
SLACK_RESIDUAL = 1e-3  # N; with less than this and no stiffness, the search would not end
MOST_ITERATIONS = 200


@compiled
def predicted_decrease(g, H, step):
    """Decrease of the energy predicted by gradient and Hessian for a step."""
    lower = 0.0
    for i in range(5):
        s = 0.0
        for j in range(5):
            s += H[i, j] * step[j]
        lower -= step[i] * (g[i] + 0.5 * s)
    return lower


@compiled
def distance_between(a, b):
    """Distance of two poses in mm."""
    s = 0.0
    for i in range(5):
        s += ((a[i] - b[i]) * scale_of(i)) ** 2
    return math.sqrt(s)


@compiled
def rounding_of(energy):
    """How much the sums of an energy may be off."""
    return 1e-13 * (abs(energy) + 1e4)


@compiled
def descend(flexion, point, energy, radius, load, contact, field, ligaments, work):
    """Move the trial point to the minimum within `radius` of a point, as seen from there.

    That is of the energy with the contact expanded there, if it was and as far as an expansion
    reaches; else of the quadratic model.

    Returns (how much lower the energy should be, how far away it is, whether the search settled).
    """
    trial, candidate = work.solver.trial, work.solver.candidate
    L, right, step = work.solver.factor, work.solver.right, work.solver.step
    placed, expansion = work.evaluation.placed, work.evaluation.expansion
    is_expanded = distance_between(point.pose, placed.expanded) == 0.0
    copy_point(point, trial)
    lowest, away, within = energy, 0.0, radius
    for k in range(MOST_NEAR_STEPS):
        shift = trust_region_step(trial.gradient, trial.hessian, within, L, right, step)
        for i in range(5):
            candidate.pose[i] = trial.pose[i] + step[i]
        lower, length = predicted_decrease(trial.gradient, trial.hessian, step), scaled_norm(step)
        far = distance_between(candidate.pose, point.pose)
        is_settled = shift == 0.0 and length < max(SETTLED, EXPANSION_ERROR * away * away)
        if is_settled or (k == 0 and (not is_expanded or far > EXPANSION_REACH)):
            copy(candidate.pose, trial.pose)
            return energy - lowest + lower, far, is_settled
        if k > 0 and far > min(radius, EXPANSION_REACH):
            break
        found = evaluate_near(
            flexion, load, contact.law, field.grid, ligaments, placed, expansion, candidate
        )
        rounding = rounding_of(lowest)
        if lowest - found > 0.1 * lower - rounding:
            lowest, away = found, far
            copy_point(candidate, trial)
        else:
            within = 0.25 * min(length, within)
            if lower <= rounding or within < SETTLED:
                break
    return energy - lowest, away, False


@compiled
def find_minimum(flexion, point, load, farthest, last_step, contact, field, ligaments, work):
    """Move a point to a minimum of the energy; return (outcome, residual).

    Each step goes to the minimum of the energy with the contact expanded where the last one ended,
    inside a trust region on the energy itself. `farthest` [mm] ends the search when the pose moves
    farther than that from where it began; it has converged where a step is shorter than `last_step`
    [mm].
    """
    evaluation, solver = work.evaluation, work.solver
    L, trial, start = solver.factor, solver.trial, solver.start
    copy(point.pose, start)
    energy = evaluate(flexion, load, contact, field, ligaments, evaluation, point)
    residual = residual_norm(point.gradient)
    radius = 3.0
    for _ in range(MOST_ITERATIONS):
        if residual < SLACK_RESIDUAL and not factorise(point.hessian, -FLOOR_MARGIN, L):
            return UNCONSTRAINED, residual
        promised, length, is_settled = descend(
            flexion, point, energy, radius, load, contact, field, ligaments, work
        )
        if residual < RESIDUAL_TOLERANCE or (is_settled and length < last_step):
            copy_point(trial, point)
            return CONVERGED, residual
        rounding = rounding_of(energy)
        energy_new = evaluate(flexion, load, contact, field, ligaments, evaluation, trial)
        residual_new = residual_norm(trial.gradient)
        gained = energy - energy_new
        if gained > 0.1 * promised - rounding and (promised > rounding or residual_new < residual):
            if gained > 0.75 * promised and length > 0.6 * radius:
                radius = min(2.0 * radius, 10.0)
            energy, residual = energy_new, residual_new
            copy_point(trial, point)
            if distance_between(point.pose, start) > farthest:
                return NO_EQUILIBRIUM, residual
        else:
            radius = 0.25 * min(length, radius)
            # Rounding hides any further gain, or there is none.
            if promised <= rounding or radius < 1e-12:
                break
    if residual < SLACK_RESIDUAL and not factorise(point.hessian, -FLOOR_MARGIN, L):
        return UNCONSTRAINED, residual
    return NO_EQUILIBRIUM, residual


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
def leaves_branch(before, after, share, tolerance):
    """Whether a step deviates from the tangents at its ends more than a smooth branch would.

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
                angle, there, load, LARGEST_MOVE, LAST_STEP, contact, field, ligaments, work
            )
            solves += 1
            tangent(there, change, flexion_change, L, right)
        tolerance = GUESS_TOLERANCE if guessed else 1.0
        if outcome == CONVERGED and not leaves_branch(here, there, share, tolerance):
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


HALF_RELEASED = 10.0  # N/mm; the stiffness of a spring that has let go of half of the knee
SHORTEST_RELEASE = 0.005
CLEAR = 0.9  # of where the knee gives way: nearer to it the pose moves without bound


@compiled
def release(flexion, load, farthest, contact, field, ligaments, work):
    """Follow the equilibrium of a knee while the spring that holds it lets go.

    The spring holds it at ``work.evaluation.placed.held_at``, with a stiffness of HALF_RELEASED
    (1 / u - 1), where u goes from near 0 to 1. ``work.path.here`` becomes the equilibrium without
    it. Where there is none, it becomes that with the spring at the last of `HOLDS` well before the
    knee gives way, and ``placed.hold`` the stiffness there.

    Returns (outcome, u, residual, number of solves).
    """
    placed, path = work.evaluation.placed, work.path
    here, begun, outcome, residual, solves = path.here, 0.0, NO_EQUILIBRIUM, 0.0, 0
    for k in range(len(BEGINNINGS)):
        begun = BEGINNINGS[k]
        copy(placed.held_at, here.pose)
        placed.hold = HALF_RELEASED * (1.0 / begun - 1.0)
        outcome, residual = find_minimum(
            flexion, here, load, farthest, LAST_STEP_ON_THE_WAY, contact, field, ligaments, work
        )
        solves += 1
        if outcome == CONVERGED:
            break
    if outcome != CONVERGED:
        placed.hold = 0.0
        return outcome, 0.0, residual, solves
    for k in range(len(HOLDS)):
        path.kept_at[k] = begun
        copy(here.pose, path.kept[k])
    outcome, reached, residual, more = follow_release(
        flexion, begun, 1.0, load, contact, field, ligaments, work
    )
    solves += more
    if outcome == CONVERGED:
        if distance_between(here.pose, placed.held_at) > farthest:
            outcome = NO_EQUILIBRIUM
        return outcome, 1.0, residual, solves
    k = 0
    while k < len(HOLDS) - 1 and HOLDS[k] > CLEAR * reached:
        k += 1
    begun = path.kept_at[k]
    copy(path.kept[k], here.pose)
    placed.hold = HALF_RELEASED * (1.0 / begun - 1.0)
    find_minimum(flexion, here, load, LARGEST_MOVE, LAST_STEP, contact, field, ligaments, work)
    _, reached, residual, more = follow_release(
        flexion, begun, max(begun, HOLDS[k]), load, contact, field, ligaments, work
    )
    placed.hold = HALF_RELEASED * (1.0 / reached - 1.0)
    return outcome, reached, residual, solves + more + 1


@compiled
def follow_release(flexion, begun, goal, load, contact, field, ligaments, work):
    """Follow the equilibrium at ``work.path.here`` while the spring lets go from `begun` to `goal`.

    Steps are accepted and halved as in `follow`.

    Returns (outcome, how far it could let go, residual, number of solves).
    """
    placed, path = work.evaluation.placed, work.path
    here, there, far, goals = path.here, path.there, path.far, path.goals
    reached, share, n_far, residual, solves = begun, begun, np.int64(0), 0.0, 0
    release_tangent(here, begun, placed, work.solver)
    while reached < goal:
        share = min(share, goal - reached)
        place = goal if share == goal - reached else reached + share
        outcome = CONVERGED
        is_known = n_far > 0 and place == goals[n_far - 1]
        if is_known:
            copy_point(far[n_far - 1], there)
        else:
            for i in range(5):
                there.pose[i] = here.pose[i] + share * here.tangent[i]
            placed.hold = HALF_RELEASED * (1.0 / place - 1.0)
            last_step = LAST_STEP if place == goal else LAST_STEP_ON_THE_WAY
            outcome, residual = find_minimum(
                flexion, there, load, LARGEST_MOVE, last_step, contact, field, ligaments, work
            )
            solves += 1
            release_tangent(there, place, placed, work.solver)
        if outcome == CONVERGED and not leaves_branch(here, there, share, 1.0):
            copy_point(there, here)
            reached = place
            for k in range(len(HOLDS)):
                if reached <= HOLDS[k]:
                    path.kept_at[k] = reached
                    copy(here.pose, path.kept[k])
            n_far -= is_known
            share = goals[n_far - 1] - reached if n_far > 0 else 2.0 * share
        else:
            if outcome == CONVERGED and not is_known:
                copy_point(there, far[n_far])
                goals[n_far] = place
                n_far += 1
            share *= 0.5
            if share < SHORTEST_RELEASE:
                free = not factorise(here.hessian, -10.0 * FLOOR_MARGIN, work.solver.factor)
                return UNCONSTRAINED if free else FOLD, reached, residual, solves
    return CONVERGED, goal, residual, solves


@compiled
def release_tangent(state, place, placed, solver):
    """Write how the equilibrium moves while the spring lets go: H^-1 times the force it loses."""
    for i in range(5):
        away = state.pose[i] - placed.held_at[i]
        solver.right[i] = HALF_RELEASED / place**2 * scale_of(i) ** 2 * away
    if factorise(state.hessian, 0.0, solver.factor):
        substitute(solver.factor, solver.right, state.tangent)
    else:
        for i in range(5):
            state.tangent[i] = 0.0


@compiled
def sensitivities(flexion, q, H, contact, ligaments, work, columns, S, contact_sums):
    """Write dq / dp = -H^-1 d gradient / dp into S (5, 2m), or more columns with contact.

    The parameters are stiffness and reference strain of m ligaments, then those of the menisci as
    `meniscus_columns` has them, where there are 3 columns more, and last the logarithm of the
    contact modulus and the exponent of the contact law. With contact, that of the pushes last
    written, the sums over its elements and those of menisci are written to `contact_sums`.
    """
    placed, solver, m = work.evaluation.placed, work.solver, len(ligaments)
    R, t, axes = placed.rotation, placed.translation, placed.axes
    L, right, step = solver.factor, solver.right, solver.step
    if S.shape[1] > 2 * m:
        evaluation = work.evaluation
        contact_columns(evaluation, columns, S.shape[1] - 2)
        if S.shape[1] > 2 * m + 2:
            meniscus_columns(contact.menisci, evaluation, columns, 2 * m)
        total, _ = sum_contact(contact.law, placed, evaluation.expansion)
        write_sums(total, contact_sums)
        add_menisci(placed, evaluation.expansion, contact_sums)
    place_tibia(flexion, q, R, t)
    motion_axes(flexion, R, t, axes)
    parameter_columns(placed, ligaments, columns)
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
    placed = work.evaluation.placed
    placed.hold = 0.0
    for n in range(len(nodes.parent)):
        before, angle = nodes.parent[n], nodes.flexion[n]
        copy(nodes.loads[n], load)
        if before < 0 and nodes.is_released:
            copy(starts[n], placed.held_at)
            outcome, results.reached[n], results.residuals[n], results.solves[n] = release(
                angle, load, nodes.farthest, contact, field, ligaments, work
            )
        elif before < 0:
            copy(starts[n], here.pose)
            outcome, results.residuals[n] = find_minimum(
                angle, here, load, nodes.farthest, LAST_STEP, contact, field, ligaments, work
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
        evaluate_if_moved(angle, here.pose, load, contact, field, ligaments, work)
        write_contact_forces(contact.law, work.evaluation)
        contact_centres(contact, work.evaluation, results.centres[n])
        write_meniscus_forces(work.evaluation)
        force_centres(
            contact.menisci.side,
            placed.counts[N_TOUCHING],
            placed.counts[N_PUSHING],
            work.evaluation,
            results.menisci[n],
        )
        if derivatives and (outcome == CONVERGED or placed.hold > 0.0):
            slopes, sums = results.sensitivities[n], results.contact_sums[n]
            sensitivities(
                angle, here.pose, here.hessian, contact, ligaments, work, columns, slopes, sums
            )
        placed.hold = 0.0
