"""The memory of one thread for one simulation."""

import threading

import numpy as np

from identknee.mechanics.memory import (
    N_LISTED,
    PATH,
    PLACED,
    SOLVER,
    EvaluationMemory,
    Workspace,
    record,
)


class _Kept(threading.local):
    """The workspace that a thread used last."""

    size = (-1, -1)
    last: Workspace


_kept = _Kept()


def kept_workspace(n_points: int, n_columns: int) -> Workspace:
    """The calling thread's workspace, which has forgotten what the last simulation evaluated."""
    if _kept.size != (n_points, n_columns):
        _kept.last, _kept.size = workspace(n_points, n_columns), (n_points, n_columns)
    _forget(_kept.last.evaluation)
    return _kept.last


def workspace(n_points: int, n_columns: int = 0) -> Workspace:
    """Memory for the work with so many contact points, and columns of sensitivities."""
    n = n_points + 1
    evaluation = EvaluationMemory(
        placed=record(PLACED),
        expansion=np.zeros((17, n)),
        listed=np.zeros((4, n)),
        cells=np.zeros(n, np.uint32),
        eighths=np.zeros(n, np.uint32),
        touching=np.zeros(n, np.uint32),
        pushes=np.zeros((7, n)),
        which=np.zeros(n, np.uint32),
        moved=np.zeros((3, n)),
    )
    _forget(evaluation)
    return Workspace(
        evaluation=evaluation,
        solver=record(SOLVER),
        path=record(PATH),
        columns=np.zeros((5, n_columns)),
    )


def _forget(evaluation: EvaluationMemory) -> None:
    placed = evaluation.placed
    placed.counts[:] = 0
    placed.counts[N_LISTED] = -1
    placed.pose[:] = np.inf
    placed.expanded[:] = np.inf
