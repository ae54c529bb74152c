"""Ways to run many tasks, all of them an ordered `map`, and one seed for each task.

A computation asks for an `Executor` and never opens a pool itself: anything with an ordered `map`
will do. The results do not depend on the choice, bit for bit, because each task carries its own
seed and shares nothing.
"""

import hashlib
import multiprocessing
import os
import pickle
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from identknee.runs.files import write_atomically
from identknee.runs.library_threads import use_one_library_thread
from identknee.runs.unforeseen import are_warnings_logged, log_warnings

Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Anything that maps a function over items and keeps their order."""

    def map(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterable[Result]:
        """Results of `function` for each of `items`, in their order."""
        ...


class WorkerDied(RuntimeError):  # noqa: N818 - said to a person as a sentence
    """Raised where a worker process ended before its task: killed, or out of memory."""


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
    and a script that opens a pool needs ``if __name__ == "__main__":``. The function goes to each
    worker once, however many items it gets, so it may hold a large model. Ctrl-C reaches this
    process alone. Workers end with it, and where an exception leaves the context, busy or not.

    Raises
    ------
    ValueError
        If `n_workers` is less than 1.
    WorkerDied
        By the map, if a worker ends before its task.
    InputError
        By the map, if there is no room for the function in the folder of temporary files.
    """
    _check_workers(n_workers)
    if n_workers == 1:
        yield serial
        return
    context = multiprocessing.get_context("spawn")
    # Nothing is ever sent: its end is the sign for workers to end, busy or not.
    line, ours = context.Pipe(duplex=False)
    with (
        line,
        ours,
        tempfile.TemporaryDirectory(prefix="identknee-", ignore_cleanup_errors=True) as folder,
    ):
        pool = ProcessPoolExecutor(
            n_workers,
            mp_context=context,
            initializer=_start_worker,
            initargs=(line, folder, are_warnings_logged()),
        )
        try:
            yield _Processes(pool, Path(folder))
        except BaseException:
            ours.close()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


class _Processes:
    """A process pool that leaves the function in a file, where each worker picks it up once."""

    def __init__(self, pool: ProcessPoolExecutor, folder: Path) -> None:
        self._pool = pool
        self._folder = folder

    def map(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        """Results of `function` for each of `items`, in their order."""
        content = pickle.dumps(function, protocol=pickle.HIGHEST_PROTOCOL)
        path = self._folder / hashlib.sha256(content).hexdigest()
        if not path.exists():
            write_atomically(path, content)
        try:
            yield from self._pool.map(partial(_apply, str(path)), items)
        except BrokenProcessPool as error:
            raise WorkerDied(
                "a worker process died before its task was done, perhaps for want of memory; "
                "try fewer workers"
            ) from error


def _apply(path: str, item: Any) -> Any:
    return _function_in(path)(item)


@lru_cache(maxsize=4)
def _function_in(path: str) -> Callable[[Any], Any]:
    function: Callable[[Any], Any] = pickle.loads(Path(path).read_bytes())
    return function


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


def _start_worker(line: Connection, folder: str, has_log: bool) -> None:  # noqa: FBT001
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    use_one_library_thread()
    if has_log:
        log_warnings()
    threading.Thread(target=_end_with, args=(line, folder), daemon=True).start()


def _end_with(line: Connection, folder: str) -> None:
    # The other end is closed by the parent where its work is broken off, or by its death. Compiled
    # code runs without the interpreter's lock, so that this thread comes to its turn meanwhile.
    with suppress(EOFError, OSError):
        line.recv_bytes()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)
