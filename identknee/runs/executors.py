"""Ways to run many tasks, all of them an ordered `map`, and one seed for each task.

A computation asks for an `Executor` and never opens a pool itself: anything with an ordered `map`
will do. The results do not depend on the choice, bit for bit, because each task carries its own
seed and shares nothing.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Protocol, TypeVar

import numpy as np

Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Anything that maps a function over items and keeps their order."""

    def map(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterable[Result]:
        """Results of `function` for each of `items`, in their order."""
        ...


class SerialExecutor:
    """An executor that does one task after the other, each when its result is asked for."""

    def map(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        """Results of `function` for each of `items`, in their order."""
        return map(function, items)


serial = SerialExecutor()


@contextmanager
def process_pool(n_workers: int) -> Iterator[Executor]:
    """Executor over `n_workers` new Python processes; `n_workers` = 1 stays in this one.

    Workers start afresh (spawn) on every system, so the function must live at the top of a module,
    and a script that opens a pool needs ``if __name__ == "__main__":``. Ctrl-C reaches this process
    alone: tasks not yet begun are dropped. Workers end when this process dies.

    Raises
    ------
    ValueError
        If `n_workers` is less than 1.
    """
    _check_workers(n_workers)
    if n_workers == 1:
        yield serial
        return
    pool = ProcessPoolExecutor(
        n_workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def threads(n_workers: int) -> Iterator[Executor]:
    """Executor over `n_workers` threads; worth it where the work releases the interpreter lock.

    Raises
    ------
    ValueError
        If `n_workers` is less than 1.
    """
    _check_workers(n_workers)
    if n_workers == 1:
        yield serial
        return
    pool = ThreadPoolExecutor(n_workers)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def spawn_seeds(seed: int | np.random.SeedSequence, n: int) -> list[np.random.SeedSequence]:
    """Independent seeds for `n` tasks, the same for the same `seed` however often it is asked.

    The first seeds do not change when `n` grows.

    Examples
    --------
    >>> first, second = (np.random.default_rng(s).integers(100) for s in spawn_seeds(0, 2))
    >>> bool(first == second)
    False
    """
    if isinstance(seed, np.random.SeedSequence):
        # spawn() counts its children; a copy starts from none, so the answer never changes.
        seed = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key)
    else:
        seed = np.random.SeedSequence(seed)
    return seed.spawn(n)


def _check_workers(n_workers: int) -> None:
    if n_workers < 1:
        raise ValueError(f"the number of workers must be at least 1, got {n_workers}")


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    # An idle worker waits on a queue that stays open when the parent is killed.
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
