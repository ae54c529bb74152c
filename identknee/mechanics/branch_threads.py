"""The branches of a tree of load paths, solved side by side in threads of this process."""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from typing import Any

import numpy as np

from identknee.mechanics.machine_code import MachineCode, Packed
from identknee.mechanics.memory import ASLEEP, HEAD, Share
from identknee.mechanics.workspace import KeptWorkspace, kept_by_thread
from identknee.runs.arrays import IntArray, frozen_integers
from identknee.runs.declare import declared, entry

# Subtrees with at most this share of one thread's nodes are branches, all before them is the trunk.
SMALL_SHARE = 0.5
# Numbers of the largest table of a call.
MOST_NUMBERS = 1024
# Trees whose shares are kept.
MOST_TREES = 32

ArgumentsOf = Callable[[Packed, KeptWorkspace], tuple[Any, ...]]


class Helper:
    """A thread that looks for a share of this thread's simulations, inside compiled code."""

    def __init__(self) -> None:
        self._table = np.zeros(MOST_NUMBERS, np.int64)
        self._table[0] = ASLEEP
        self._run: Callable[[int], None] | None = None
        self._is_inside = self._is_over = False
        self._wanted = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self.kept = KeptWorkspace()
        self._thread.start()

    @property
    def address(self) -> int:
        """Where its table is."""
        return self._table.ctypes.data

    def prepare(self, code: MachineCode, *arguments: Any) -> bool:
        """Lay out a call, and wake the thread if it sleeps; whether the call may be offered.

        It may not while the thread is inside other code, whose arguments are laid out otherwise.
        """
        run, table = code.prepared(*arguments)
        with self._lock:
            if self._is_inside and run is not self._run:
                self._table[1] = True
                return False
            self._table[HEAD : len(table)] = table[HEAD:]
            if not self._is_inside:
                self._table[1] = False
                self._run, self._is_inside = run, True
                self._wanted.set()
        return True

    def dismiss(self) -> None:
        """End the thread."""
        with self._lock:
            self._is_over = True
            self._table[1] = True
            self._wanted.set()
        self._thread.join()

    def _serve(self) -> None:
        while True:
            self._wanted.wait()
            with self._lock:
                self._wanted.clear()
                if self._is_over:
                    return
                run = self._run
            assert run is not None
            run(self.address)
            with self._lock:
                self._is_inside = False


class Crew:
    """Threads that share the simulations of one thread, one simulation at a time."""

    def __init__(self, n_helpers: int) -> None:
        self._helpers = [Helper() for _ in range(n_helpers)]
        self._begun = np.zeros(3, np.int64)
        self._shares: dict[bytes, tuple[Packed, Packed]] = {}
        self._is_busy = threading.Lock()

    def run(self, code: MachineCode, parent: bytes, arguments_of: ArgumentsOf) -> bool:
        """Whether the threads were free and ran it; see `run_shared`."""
        if not self._is_busy.acquire(blocking=False):
            return False
        try:
            own, theirs = self._shares_of(parent)
            self._begun[:] = 0
            if not all(x.prepare(code, *arguments_of(theirs, x.kept)) for x in self._helpers):
                return False
            code(*arguments_of(own, kept_by_thread()))
        finally:
            self._is_busy.release()
        return True

    def dismiss(self) -> None:
        """End the threads."""
        for helper in self._helpers:
            helper.dismiss()

    def _shares_of(self, parent: bytes) -> tuple[Packed, Packed]:
        """That of the calling thread and that of each helper."""
        if parent not in self._shares:
            if len(self._shares) == MOST_TREES:
                self._shares.clear()
            pieces = pieces_of(parent, len(self._helpers) + 1)
            addresses = [x.address for x in self._helpers]
            own = _share(pieces, self._begun, addresses)
            self._shares[parent] = own, _share(pieces, self._begun, is_helper=True)
        return self._shares[parent]


_crew: ContextVar[Crew | None] = ContextVar("crew", default=None)


@contextmanager
def branch_threads(n: int) -> Iterator[None]:
    """Context in which `n` threads share the branches of each simulation, bit for bit as one does.

    The calling thread is one of them, and there are no more than the machine has processor cores.
    The others keep their cores busy for some milliseconds after each simulation. Worth it where
    simulations come one after the other and cores are idle.

    Raises
    ------
    ValueError
        If `n` is less than 1.
    """
    if n < 1:
        raise ValueError(f"the number of workers must be at least 1, got {n}")
    n_helpers = min(n, os.cpu_count() or 1) - 1
    if not n_helpers:
        yield
        return
    crew = Crew(n_helpers)
    before = _crew.set(crew)
    try:
        yield
    finally:
        _crew.reset(before)
        crew.dismiss()


def run_shared(code: MachineCode, parent: IntArray, arguments_of: ArgumentsOf) -> None:
    """Run a compiled function over a tree, in as many threads as the context has.

    Parameters
    ----------
    code
        The function; see `identknee.mechanics.kernel.simulate_path`.
    parent
        The node before each, -1 where a path begins, shape ``(n,)``; parents come first.
    arguments_of
        What a thread calls it with, by its share and its own memory.
    """
    crew = _crew.get()
    if crew is None or not crew.run(code, parent.tobytes(), arguments_of):
        code(*arguments_of(_whole(len(parent)), kept_by_thread()))


@lru_cache(maxsize=32)
def _whole(n: int) -> Packed:
    """The share of a thread that has no helpers."""
    nodes = frozen_integers(range(n))
    whole = Pieces(nodes=nodes, ends=frozen_integers([n, n]), n_early=frozen_integers([0]))
    return _share(whole, np.zeros(3, np.int64))


def _share(
    pieces: "Pieces", begun: IntArray, helpers: Iterable[int] = (), *, is_helper: bool = False
) -> Packed:
    return Packed(
        Share(
            nodes=pieces.nodes,
            ends=pieces.ends,
            n_early=pieces.n_early,
            begun=begun,
            helpers=np.array(helpers, np.int64),
            is_helper=np.array([is_helper], np.int64),
        )
    )


@declared
class Pieces:
    """The nodes of a tree in pieces that threads take one after the other.

    The root, which all others wait for, the trunk, which large parts of the tree hang on, early
    branches, which begin anew or at the root, and late ones, which begin at the trunk.
    """

    nodes: IntArray = entry("The nodes, piece after piece")
    ends: IntArray = entry("Where each piece ends, shape ``(pieces,)``")
    n_early: IntArray = entry("How many pieces are early branches, shape ``(1,)``")


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
    # Large ones first, and those that leave the trunk late, where a flexed knee takes more work.
    for first in sorted(nodes[~is_trunk & (branch == nodes)], key=lambda x: (-size[x], -x)):
        is_early = before[first] < 0 or is_root[before[first]]
        (early if is_early else late).append(nodes[branch == first])
    parts = [nodes[is_root], nodes[is_trunk & ~is_root], *early, *late]
    return Pieces(
        nodes=frozen_integers(np.concatenate(parts)),
        ends=frozen_integers(np.cumsum([len(x) for x in parts])),
        n_early=frozen_integers([len(early)]),
    )
