"""The memory of one thread for one simulation."""

import threading

import numpy as np

from identknee.mechanics.machine_code import Packed
from identknee.mechanics.memory import (
    MOST_HALVINGS,
    N_LISTED,
    EvaluationMemory,
    PathMemory,
    Point,
    SolverMemory,
    State,
    Workspace,
)


class KeptWorkspace:
    """The memory that one thread used last, used again where it fits."""

    def __init__(self) -> None:
        self._size = (-1, -1)
        self.packed: Packed | None = None

    def fitting(self, n_points: int, n_columns: int) -> Packed:
        """Memory that has forgotten what the last simulation evaluated."""
        if self.packed is None or self._size != (n_points, n_columns):
            self.packed, self._size = Packed(workspace(n_points, n_columns)), (n_points, n_columns)
        else:
            _forget(self.packed.arrays.evaluation)
        return self.packed


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.kept = KeptWorkspace()


_OF_THREAD = _OfThread()


def kept_by_thread() -> KeptWorkspace:
    """That of the calling thread."""
    return _OF_THREAD.kept


def workspace(n_points: int, n_columns: int = 0) -> Workspace:
    """Memory for the work with so many contact points, and columns of sensitivities."""
    n = n_points + 1
    solver = SolverMemory(
        factor=np.zeros((5, 5)),
        right=np.zeros(5),
        step=np.zeros(5),
        trial=_point(),
        candidate=_point(),
        start=np.zeros(5),
        gradient=np.zeros(5),
        columns=np.zeros((5, n_columns)),
    )
    path = PathMemory(
        here=_states(),
        there=_states(),
        far=_states(MOST_HALVINGS + 1),
        goals=np.zeros(MOST_HALVINGS + 1),
        load=np.zeros(5),
        change=np.zeros(5),
    )
    evaluation = EvaluationMemory(
        expansion=np.zeros((17, n)),
        listed=np.zeros((4, n)),
        counts=np.zeros(5, np.int64),
        listed_pose=np.zeros(12),
        cells=np.zeros(n, np.uint32),
        eighths=np.zeros(n, np.uint32),
        pose=np.zeros(5),
        expanded=np.zeros(5),
        rotation=np.zeros(9),
        translation=np.zeros(3),
        field_rotation=np.zeros(9),
        field_translation=np.zeros(3),
        sums=np.zeros(39),
        axes=np.zeros((9, 3)),
        touching=np.zeros(n, np.uint32),
        pushes=np.zeros((7, n)),
        which=np.zeros(n, np.uint32),
        moved=np.zeros((3, n)),
        line=np.zeros(10),
    )
    _forget(evaluation)
    return Workspace(evaluation=evaluation, solver=solver, path=path)


def _point() -> Point:
    return Point(np.zeros(5), np.zeros(5), np.zeros((5, 5)), np.zeros(5))


def _states(*n: int) -> State:
    return State(np.zeros((*n, 5)), np.zeros((*n, 5, 5)), np.zeros((*n, 5)), np.zeros((*n, 5)))


def _forget(evaluation: EvaluationMemory) -> None:
    evaluation.counts[:] = 0
    evaluation.counts[N_LISTED] = -1
    evaluation.pose[:] = np.inf
    evaluation.expanded[:] = np.inf
