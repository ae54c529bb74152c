"""The branches of a tree of load paths, solved side by side in threads of this process."""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache

import numpy as np

from identknee.runs.arrays import IntArray, frozen_integers
from identknee.runs.declare import declared, entry

# Subtrees with at most this share of one thread's nodes are branches, all before them is the trunk.
SMALL_SHARE = 0.5

_threads: ContextVar[tuple[int, Executor | None]] = ContextVar("threads", default=(1, None))


@contextmanager
def branch_threads(n: int) -> Iterator[None]:
    """Context in which `n` threads share the branches of each simulation, bit for bit as one does.

    The calling thread is one of them, and there are no more than the machine has processor cores.
    Worth it where simulations come one after the other and cores are idle.

    Raises
    ------
    ValueError
        If `n` is less than 1.
    """
    if n < 1:
        raise ValueError(f"the number of workers must be at least 1, got {n}")
    n = min(n, os.cpu_count() or 1)
    if n == 1:
        yield
        return
    with ThreadPoolExecutor(n - 1) as pool:
        before = _threads.set((n, pool))
        try:
            yield
        finally:
            _threads.reset(before)


def on_branches(parent: IntArray, solve: Callable[[IntArray], None]) -> None:
    """Call `solve` with the nodes of a tree, in as many threads as the context has.

    Parameters
    ----------
    parent
        The node before each, -1 where a path begins, shape ``(n,)``; parents come first.
    solve
        Solves the nodes it is given, in their order, those before them being solved.
    """
    n, pool = _threads.get()
    if pool is None:
        solve(np.arange(len(parent)))
        return
    pieces = pieces_of(parent.tobytes(), n)
    early, late = _Queue(pieces.early, n), _Queue(pieces.late, n)
    is_trunk_solved = threading.Event()

    def help_out() -> None:
        early.empty(solve)
        is_trunk_solved.wait()
        late.empty(solve)

    if pieces.root.size:
        solve(pieces.root)
    n_helping = min(n, len(pieces.early) + len(pieces.late)) - 1
    helping = [pool.submit(help_out) for _ in range(n_helping)]
    try:
        if pieces.trunk.size:
            solve(pieces.trunk)
    finally:
        is_trunk_solved.set()
    late.empty(solve)
    early.empty(solve)
    for each in helping:
        each.result()


class _Queue:
    """Branches that `n` threads take, more of them at once as long as many are left."""

    def __init__(self, branches: Iterable[IntArray], n: int) -> None:
        self._left = deque(branches)
        self._n = n
        self._lock = threading.Lock()

    def empty(self, solve: Callable[[IntArray], None]) -> None:
        """Solve branches until none is left."""
        while self._left:
            with self._lock:
                some = -(-len(self._left) // (self._n + 1))
                taken = [self._left.popleft() for _ in range(some)]
            if taken:
                solve(np.concatenate(taken))


@declared
class Pieces:
    """The nodes of a tree in pieces that threads take one after the other."""

    root: IntArray = entry("Nodes that all others wait for")
    trunk: IntArray = entry("The other nodes that large parts of the tree hang on")
    early: tuple[IntArray, ...] = entry("Branches that begin anew or at the root")
    late: tuple[IntArray, ...] = entry("Branches that begin at the trunk")


@lru_cache(maxsize=32)
def pieces_of(parent: bytes, n: int) -> Pieces:
    """The pieces for `n` threads of a tree with these nodes before each, as bytes."""
    before = np.frombuffer(parent, np.int64)
    nodes = np.arange(len(before))
    size = np.ones(len(before), np.int64)
    for node in nodes[::-1]:
        if before[node] >= 0:
            size[before[node]] += size[node]
    is_trunk = size > max(SMALL_SHARE * len(before) / n, 1.0)
    is_root = is_trunk & (before < 0)
    branch = nodes.copy()  # the first node of the branch each is on
    for node, previous in enumerate(before):
        if previous >= 0 and not is_trunk[previous]:
            branch[node] = branch[previous]
    early: list[IntArray] = []
    late: list[IntArray] = []
    for first in sorted(nodes[~is_trunk & (branch == nodes)], key=lambda x: -size[x]):
        is_early = before[first] < 0 or is_root[before[first]]
        (early if is_early else late).append(frozen_integers(nodes[branch == first]))
    return Pieces(
        root=frozen_integers(nodes[is_root]),
        trunk=frozen_integers(nodes[is_trunk & ~is_root]),
        early=tuple(early),
        late=tuple(late),
    )
