"""Equilibria as they are copied, kept and read again."""

from identknee.mechanics.compiled import compiled


@compiled
def copy_point(point, to):
    """Copy a pose with all that belongs to it."""
    for i in range(5):
        to.pose[i], to.gradient[i] = point.pose[i], point.gradient[i]
        to.gradient_by_flexion[i], to.tangent[i] = point.gradient_by_flexion[i], point.tangent[i]
        for j in range(5):
            to.hessian[i, j] = point.hessian[i, j]


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
