"""Executors that map a function over many tasks in order, and an independent seed for each task.

A computation takes an `Executor`, that is anything with an ordered `map`, and never opens a pool
itself. Results are the same bit for bit with any executor, because each task has its own seed and
shares nothing.
"""

import hashlib
import logging
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import cache, lru_cache, partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from identknee.runs.crash_report import are_warnings_redirected, log_warnings
from identknee.runs.files import write_atomically

if TYPE_CHECKING:
    from distributed import Client

# Numbers of threads of linear algebra libraries, which read these variables when they are loaded.
LIBRARY_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def use_one_library_thread() -> Any:
    """Keep linear algebra to the calling thread from now on; the object returned can undo it.

    Threads inside linear algebra on matrices of ten to fifty columns cost more than they bring:
    beside other processes they wait for each other, and a fit takes up to a hundred times as long.
    Libraries that are loaded later, and processes that are started, keep to one thread as well.
    """
    # Loaded late, so that commands start quickly.
    from threadpoolctl import threadpool_limits

    os.environ.update(dict.fromkeys(LIBRARY_THREADS, "1"))
    return threadpool_limits(limits=1, user_api="blas")


@contextmanager
def one_library_thread() -> Iterator[None]:
    """Context in which linear algebra keeps to the calling thread."""
    with _environment(dict.fromkeys(LIBRARY_THREADS, "1")):
        limits = use_one_library_thread()
        try:
            yield
        finally:
            limits.restore_original_limits()


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Context in which variables of the environment have these values."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Anything that maps a function over items and keeps their order."""

    def map(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterable[Result]:
        """Results of `function` for each of `items`, in their order."""
        ...


class WorkerTerminated(RuntimeError):  # noqa: N818 - said to a person as a sentence
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
    WorkerTerminated
        By the map, if a worker ends before its task, or cannot start; the message says which.
    InputError
        By the map, if there is no room for the function in the folder of temporary files.
    """
    _check_workers(n_workers)
    if n_workers == 1:
        yield serial
        return
    _end_if_importing_script()
    context = multiprocessing.get_context("spawn")
    # Nothing is ever sent: when this end is closed, workers end, busy or not.
    line, ours = context.Pipe(duplex=False)
    with (
        line,
        ours,
        tempfile.TemporaryDirectory(prefix="identknee-", ignore_cleanup_errors=True) as folder,
        _environment({POOL: folder}),
    ):
        pool = ProcessPoolExecutor(
            n_workers,
            mp_context=context,
            initializer=_start_worker,
            initargs=(line, folder, are_warnings_redirected()),
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
            raise WorkerTerminated(self._why_broken()) from error

    def _why_broken(self) -> str:
        """Why a worker ended, and the remedy."""
        script = str(getattr(sys.modules["__main__"], "__file__", ""))
        guard = f'put what {Path(script).name} does under: if __name__ == "__main__":'
        if (self._folder / UNGUARDED).exists():
            return (
                f"worker processes import {Path(script).name}, which starts workers again when it "
                f"is imported; {guard}"
            )
        if (self._folder / STARTED).exists():
            return (
                "a worker process ended before its task was done, perhaps out of memory; "
                "try fewer workers"
            )
        if script and not Path(script).exists():
            return (
                "worker processes import the script that starts them, and this one is not a file; "
                "save it as a file, or use 1 worker"
            )
        return (
            "no worker process could start: each imports the script first, which failed as is said "
            f"above; {guard}"
            if script
            else "no worker process could start; try 1 worker"
        )


# Files that workers leave in the folder of their pool: a worker has started; a worker was about to
# start workers itself, because it imported a script without a guard.
STARTED, UNGUARDED = "started", "unguarded"
# The variable by which a worker finds that folder while it is being started.
POOL = "IDENTKNEE_POOL"


def _end_if_importing_script() -> None:
    """End a worker that imports a script which starts workers when it is imported.

    Python would refuse, with a trace of each worker; the parent says it once.
    """
    folder = os.environ.get(POOL)
    # Python tells by this flag as well whether a new process still imports the script.
    is_importing = getattr(multiprocessing.current_process(), "_inheriting", False)
    if folder is not None and is_importing:
        (Path(folder) / UNGUARDED).touch()
        raise SystemExit(1)


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
    (Path(folder) / STARTED).touch()
    use_one_library_thread()
    if has_log:
        log_warnings()
    threading.Thread(target=_end_with, args=(line, folder), daemon=True).start()


def _end_with(line: Connection, folder: str) -> None:
    # The parent closes the other end when its work is interrupted or when it dies. Compiled code
    # releases the interpreter's lock, so this thread runs meanwhile.
    with suppress(EOFError, OSError):
        line.recv_bytes()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


@contextmanager
def dask_cluster(cluster: str | int) -> Iterator[Executor]:
    """Executor over the workers of a dask cluster; the results are those of any other executor.

    Parameters
    ----------
    cluster
        Address of a running scheduler, as ``"tcp://10.0.0.5:8786"``, whose workers have the same
        versions of everything; or a number of worker processes to start on this machine for as
        long as the context lasts. A script that starts some needs
        ``if __name__ == "__main__":``.

    Raises
    ------
    ValueError
        If the number of workers is less than 1, or nothing answers at the address.
    ModuleNotFoundError
        If dask and distributed are not installed.
    WorkerTerminated
        By the map, if a worker ends before its task.

    Examples
    --------
    >>> with dask_cluster(0) as executor:
    ...     executor.map(abs, [-1])
    Traceback (most recent call last):
    ValueError: the number of workers must be at least 1, got 0
    """
    if isinstance(cluster, int):
        _check_workers(cluster)
    try:
        from distributed import Client, LocalCluster
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "running on a dask cluster needs the packages dask and distributed; install them with "
            "pip install 'identknee[cluster]'"
        ) from error
    if isinstance(cluster, int):
        # One thread each, as in a process pool; any free port; a dead worker is ours to report.
        local = LocalCluster(
            n_workers=cluster,
            threads_per_worker=1,
            dashboard_address=":0",
            silence_logs=logging.CRITICAL,
        )
        with local, Client(local) as client:
            yield _Dask(client)
        return
    try:
        client = Client(cluster)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"no dask scheduler answers at {cluster} ({error}); start one with the command "
            "dask scheduler and give its address"
        ) from error
    with client:
        yield _Dask(client)


class _Dask:
    """The workers behind a client; the function goes to each of them once."""

    def __init__(self, client: "Client") -> None:
        self._client = client

    def map(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        """Results of `function` for each of `items`, in their order."""
        from distributed.scheduler import KilledWorker

        # To all of them, so that it does not go with the one worker that held it.
        there = self._client.scatter(function, broadcast=True, hash=False)
        tasks = [
            self._client.submit(_apply_on_one_thread, there, item, pure=False) for item in items
        ]
        try:
            for task in tasks:
                yield task.result()
        except (KilledWorker, CancelledError) as error:
            raise WorkerTerminated(
                "a worker of the dask cluster died before its task was done, perhaps out of "
                "memory; try fewer workers"
            ) from error
        finally:
            self._client.cancel(tasks)


def _apply_on_one_thread(function: Callable[[Any], Any], item: Any) -> Any:
    _keep_to_one_thread()
    return function(item)


# Once in each worker, as processes on this machine do at their start, so that sums have equal bits.
_keep_to_one_thread = cache(use_one_library_thread)


# How many on this machine, or the address of a dask scheduler.
Workers = int | str


def executor_of(
    workers: Workers, own: Callable[[int], AbstractContextManager[Executor]] = process_pool
) -> AbstractContextManager[Executor]:
    """Executor over these workers; the results do not depend on their number or place.

    Parameters
    ----------
    workers
        A number on this machine, or the address of a running dask scheduler, as
        ``"tcp://10.0.0.5:8786"``.
    own
        Makes the executor of a number of workers on this machine.
    """
    if isinstance(workers, str) and not workers.isdecimal():
        return dask_cluster(workers)
    return own(int(workers))
