"""Equilibria of trials whose load path ends, looked for where the knee was when they were made."""

from typing import Any

import numpy as np

from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.equilibria import ContactPoints, solve
from identknee.mechanics.load_paths import LoadPaths, loaded_at_once
from identknee.mechanics.memory import CONVERGED, Equilibria, LigamentArrays
from identknee.runs.arrays import Array


def solve_past_folds(
    paths: LoadPaths,
    start: Array,
    knee: tuple[ContactPoints, DistanceField, LigamentArrays],
    fallback_poses: Array | None,
    **how: Any,
) -> Equilibria:
    """The equilibria at the nodes of `paths`, those of trials without one from a pose of their own.

    The path to a trial may end, or its unloaded knee lie loose, for a small error of the geometry
    where the knee that was measured had a pose. Its whole load is then put on the knee there.

    Parameters
    ----------
    paths, start, knee, how
        As for `identknee.mechanics.equilibria.solve`.
    fallback_poses
        Pose of each trial, shape ``(n, 5)``, NaN where none is known; None for none at all.
    """
    found = solve(paths, start, *knee, **how)
    if fallback_poses is None:
        return found
    nodes = paths.trial_node
    is_lost = (found.codes[nodes] != CONVERGED) & np.isfinite(fallback_poses).all(axis=1)
    if not is_lost.any():
        return found
    lost = nodes[is_lost]
    at_once = loaded_at_once(paths.flexion[lost], paths.loads[lost])
    again = solve(at_once, fallback_poses[is_lost], *knee, **{**how, "guesses": None})
    is_found = again.codes == CONVERGED
    for values, others in zip(found, again, strict=True):
        values[lost[is_found]] = others[is_found]
    return found
