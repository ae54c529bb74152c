"""Equilibria as they are copied, kept and read again."""

from identknee.mechanics.compiled import compiled_in_place


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
