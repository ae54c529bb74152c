"""The tree of load paths that a set of trials is solved along.

The path to a trial depends on that trial alone, not on the others of its protocol: from the
scanned pose in steps of flexion, then along a straight line from no load to the full one. Trials
share the nodes their paths have in common.
"""

from functools import lru_cache
from typing import Literal

import numpy as np

from identknee.mechanics.memory import ROTATION_SCALE
from identknee.runs.arrays import Array, IntArray, frozen, frozen_integers
from identknee.runs.declare import declared, entry

Continuation = Literal["continuation", "single-step"]
FLEXION_STEP = np.radians(10.0)
LOAD_STEP = 2000.0 / ROTATION_SCALE  # N, or N mm per rotation scale: 2 N m
NEAR = 30.0  # mm, or 43 deg of rotation: what is farther from a measured pose is another one
_SCALE = np.array([ROTATION_SCALE, ROTATION_SCALE, 1.0, 1.0, 1.0])


@declared
class LoadPaths:
    """Nodes (flexion, load), each with the node it is reached from."""

    flexion: Array = entry("Flexion of each node [rad], shape ``(n_nodes,)``")
    loads: Array = entry(
        "Generalised loads of (varus, internal [N mm], x, y, z [N]), shape ``(n_nodes, 5)``"
    )
    parent: IntArray = entry(
        "Index of the node before, -1 where the path begins, shape ``(n_nodes,)``"
    )
    trial_node: IntArray = entry("The node of each trial, shape ``(n_trials,)``")
    farthest: float = entry(
        "How far from its start the search may end where a path begins, rotations times 40 mm [mm]",
        default=1e9,
    )


def load_paths(
    flexion: Array, loads: Array, start_flexion: float, continuation: Continuation = "continuation"
) -> LoadPaths:
    """The paths to trials at `flexion` [rad] (n,) under `loads` (n, 5), from `start_flexion` [rad].

    With ``"single-step"`` every trial starts at the scanned pose and bears its whole load at once.
    """
    # Models of one protocol with other effects have the same paths, hundreds in a diagnosis.
    plain = np.asarray(flexion, float).tobytes(), np.asarray(loads, float).tobytes()
    return _load_paths(*plain, float(start_flexion), continuation)


@lru_cache(maxsize=32)
def _load_paths(
    flexion: bytes, loads: bytes, start_flexion: float, continuation: Continuation
) -> LoadPaths:
    tree = _Tree()
    trial_node = []
    for angle, load in zip(
        np.frombuffer(flexion), np.frombuffer(loads).reshape(-1, 5), strict=True
    ):
        if continuation == "single-step":
            trial_node.append(tree.node(-1, float(angle), load))
        else:
            node, goal = tree.node(-1, start_flexion, np.zeros(5)), float(angle)
            for turned in _steps(goal - start_flexion, FLEXION_STEP):
                node = tree.node(node, start_flexion + turned, np.zeros(5))
            size = float(np.linalg.norm(load / _SCALE))
            for reached in _steps(size, LOAD_STEP):
                node = tree.node(node, goal, load * (reached / size))
            trial_node.append(node)
    return LoadPaths(
        flexion=frozen(tree.flexion, None, name="flexion"),
        loads=frozen(np.reshape(tree.loads, (-1, 5)), None, 5, name="loads"),
        parent=frozen_integers(tree.parent),
        trial_node=frozen_integers(trial_node),
    )


def paths_of_single_step(flexion: Array, loads: Array) -> LoadPaths:
    """Paths of one node each: trials at `flexion` [rad] (n,) bear their whole `loads` (n, 5).

    An equilibrium counts within `NEAR` of where its search begins.
    """
    n = len(flexion)
    return LoadPaths(
        flexion=frozen(flexion, n, name="flexion"),
        loads=frozen(loads, n, 5, name="loads"),
        parent=frozen_integers(np.full(n, -1)),
        trial_node=frozen_integers(np.arange(n)),
        farthest=NEAR,
    )


class _Tree:
    """Nodes so far, found again by what they are and where they come from."""

    def __init__(self) -> None:
        self.flexion: list[float] = []
        self.loads: list[Array] = []
        self.parent: list[int] = []
        self._known: dict[tuple[int, float, tuple[float, ...]], int] = {}

    def node(self, parent: int, flexion: float, load: Array) -> int:
        key = (parent, round(flexion, 12), tuple(np.round(load, 9)))
        if key not in self._known:
            self._known[key] = len(self.flexion)
            self.flexion.append(flexion)
            self.loads.append(np.asarray(load, float))
            self.parent.append(parent)
        return self._known[key]


def _steps(whole: float, step: float) -> list[float]:
    """Multiples of `step` up to `whole`, then `whole` itself; nothing where it is zero."""
    if abs(whole) < 1e-9 * step:
        return []
    full = int(np.ceil(abs(whole) / step - 1e-9))
    return [*(np.sign(whole) * step * k for k in range(1, full)), whole]
