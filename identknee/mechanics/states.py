"""Equilibria as they are copied, kept and read again, and the memory of one thread."""

import numpy as np

from identknee.mechanics.compiled import compiled, compiled_in_place
from identknee.mechanics.memory import (
    N_LISTED,
    EvaluationMemory,
    PathMemory,
    Point,
    SolverMemory,
    State,
    Workspace,
)

MOST_HALVINGS = 10  # of the way from one node of the load path to the next


@compiled_in_place
def copy_state(state, to):
    """Copy an equilibrium."""
    for i in range(5):
        to.pose[i], to.tangent[i] = state.pose[i], state.tangent[i]
        to.gradient_by_flexion[i] = state.gradient_by_flexion[i]
        for j in range(5):
            to.hessian[i, j] = state.hessian[i, j]


@compiled_in_place
def keep_state(state, states, n):
    """Make an equilibrium the n-th of several."""
    for i in range(5):
        states.pose[n, i], states.tangent[n, i] = state.pose[i], state.tangent[i]
        states.gradient_by_flexion[n, i] = state.gradient_by_flexion[i]
        for j in range(5):
            states.hessian[n, i, j] = state.hessian[i, j]


@compiled_in_place
def take_state(states, n, state):
    """Make the n-th of several equilibria the state."""
    for i in range(5):
        state.pose[i], state.tangent[i] = states.pose[n, i], states.tangent[n, i]
        state.gradient_by_flexion[i] = states.gradient_by_flexion[n, i]
        for j in range(5):
            state.hessian[i, j] = states.hessian[n, i, j]


@compiled
def row_of(states, n):
    """State n of several, to be read and written."""
    return State(
        states.pose[n], states.hessian[n], states.gradient_by_flexion[n], states.tangent[n]
    )


@compiled
def empty_states(n):
    """States to be written to."""
    return State(np.zeros((n, 5)), np.zeros((n, 5, 5)), np.zeros((n, 5)), np.zeros((n, 5)))


@compiled
def workspace(n_points):
    """Memory for one thread's work, allocated once a simulation."""
    n = n_points + 1
    counts = np.zeros(5, np.int64)
    counts[N_LISTED] = -1
    solver = SolverMemory(
        factor=np.zeros((5, 5)),
        right=np.zeros(5),
        step=np.zeros(5),
        trial=Point(np.zeros(5), np.zeros(5), np.zeros((5, 5)), np.zeros(5)),
        candidate=Point(np.zeros(5), np.zeros(5), np.zeros((5, 5)), np.zeros(5)),
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
        expansion=np.zeros((17, n)),
        listed=np.zeros((4, n)),
        counts=counts,
        listed_pose=np.zeros(12),
        cells=np.zeros(n, np.int64),
        eighths=np.zeros(n, np.int64),
        pose=np.full(5, np.inf),
        expanded=np.full(5, np.inf),
        rotation=np.zeros(9),
        translation=np.zeros(3),
        field_rotation=np.zeros(9),
        field_translation=np.zeros(3),
        sums=np.zeros(39),
        axes=np.zeros((9, 3)),
        touching=np.zeros(n, np.int64),
        which=np.zeros(n, np.int64),
        moved=np.zeros((3, n)),
        weights=np.zeros(24),
        line=np.zeros(10),
    )
    return Workspace(evaluation=evaluation, solver=solver, path=path)


@compiled_in_place
def read_state(results, n, state):
    """Make the state that of node n, but for its tangent."""
    for i in range(5):
        state.pose[i] = results.poses[n, i]
        state.gradient_by_flexion[i] = results.gradient_by_flexion[n, i]
        for j in range(5):
            state.hessian[i, j] = results.hessians[n, i, j]


@compiled_in_place
def write_state(state, results, n):
    """Keep the state as that of node n."""
    for i in range(5):
        results.poses[n, i] = state.pose[i]
        results.gradient_by_flexion[n, i] = state.gradient_by_flexion[i]
        for j in range(5):
            results.hessians[n, i, j] = state.hessian[i, j]
