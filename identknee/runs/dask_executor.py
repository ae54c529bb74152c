"""Many tasks on a dask cluster: one on this machine, or one that runs elsewhere."""

import logging
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from identknee.runs.executors import Executor, WorkerDied
from identknee.runs.library_threads import use_one_library_thread

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item")
Result = TypeVar("Result")


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
    WorkerDied
        By the map, if a worker ends before its task.

    Examples
    --------
    >>> with dask_cluster(0) as executor:
    ...     executor.map(abs, [-1])
    Traceback (most recent call last):
    ValueError: the number of workers must be at least 1, got 0
    """
    if isinstance(cluster, int) and cluster < 1:
        raise ValueError(f"the number of workers must be at least 1, got {cluster}")
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
        tasks = [self._client.submit(_apply, there, item, pure=False) for item in items]
        try:
            for task in tasks:
                yield task.result()
        except (KilledWorker, CancelledError) as error:
            raise WorkerDied(
                "a worker of the dask cluster died before its task was done, perhaps for want of "
                "memory; try fewer workers"
            ) from error
        finally:
            self._client.cancel(tasks)


def _apply(function: Callable[[Any], Any], item: Any) -> Any:
    _keep_to_one_thread()
    return function(item)


@cache
def _keep_to_one_thread() -> None:
    """As processes of this machine are told when they start, so that sums have the same bits."""
    use_one_library_thread()
