"""The search for one equilibrium: a minimum of the energy at fixed flexion and load."""

import math

from identknee.mechanics.compiled import compiled
from identknee.mechanics.energy import evaluate, evaluate_near
from identknee.mechanics.memory import CONVERGED, NO_EQUILIBRIUM, UNCONSTRAINED
from identknee.mechanics.small_matrices import (
    factorise,
    residual_norm,
    scale_of,
    scaled_norm,
    trust_region_step,
)
from identknee.mechanics.states import copy_point

# N and mm; a search this close, by either, ends at the minimum of the energy with the contact
# expanded there. What that leaves out is far below what a difference between two ways of solving
# may be (1e-9 mm), and the Hessian is right to 1e-6.
RESIDUAL_TOLERANCE = 3e-6
LAST_STEP = 3e-7
EXPANSION_REACH = 1.0  # mm; farther away contact is not what its expansion says
EXPANSION_ERROR = 0.01  # 1/mm; of a minimum found so far from where the expansion is exact, squared
SETTLED = 1e-8  # mm; a Newton step as short leaves nothing above rounding
MOST_NEAR_STEPS = 12
FLOOR_MARGIN = 1e-3  # N/mm; below this stiffness a pose is not unique
SLACK_RESIDUAL = 1e-3  # N; with less than this and no stiffness, the search would creep on for ever
MOST_ITERATIONS = 200


@compiled
def promise(g, H, step):
    """How much lower the energy is a step away, by gradient and Hessian."""
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

    Returns (how much lower the energy should be, how far away it is, whether it is the minimum).
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
        lower, length = promise(trial.gradient, trial.hessian, step), scaled_norm(step)
        far = distance_between(candidate.pose, point.pose)
        is_settled = shift == 0.0 and length < max(SETTLED, EXPANSION_ERROR * away * away)
        if is_settled or (k == 0 and (not is_expanded or far > EXPANSION_REACH)):
            for i in range(5):
                trial.pose[i] = candidate.pose[i]
            return energy - lowest + lower, far, shift == 0.0 and length < SETTLED
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
def find_minimum(flexion, point, load, farthest, contact, field, ligaments, work):
    """Move a point to a minimum of the energy; return (outcome, residual).

    Each step goes to the minimum of the energy with the contact expanded where the last one ended,
    inside a trust region on the energy itself. `farthest` [mm] ends the search when the pose moves
    farther than that from where it began.
    """
    evaluation, solver = work.evaluation, work.solver
    L, trial, start = solver.factor, solver.trial, solver.start
    for i in range(5):
        start[i] = point.pose[i]
    energy = evaluate(flexion, load, contact, field, ligaments, evaluation, point)
    residual = residual_norm(point.gradient)
    radius = 3.0
    for _ in range(MOST_ITERATIONS):
        if residual < SLACK_RESIDUAL and not factorise(point.hessian, -FLOOR_MARGIN, L):
            return UNCONSTRAINED, residual
        promised, length, is_lowest = descend(
            flexion, point, energy, radius, load, contact, field, ligaments, work
        )
        if residual < RESIDUAL_TOLERANCE or (is_lowest and length < LAST_STEP):
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
