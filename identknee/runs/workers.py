"""Who does the work: this process, others or threads on this machine, or a cluster elsewhere."""

from collections.abc import Callable
from contextlib import AbstractContextManager

from identknee.runs.dask_executor import dask_cluster
from identknee.runs.executors import Executor, process_pool

# How many on this machine, or the address of a dask scheduler.
Workers = int | str


def executor_of(
    workers: Workers, own: Callable[[int], AbstractContextManager[Executor]] = process_pool
) -> AbstractContextManager[Executor]:
    """Executor over these workers; the results do not depend on who they are.

    Parameters
    ----------
    workers
        A number on this machine, or the address of a running dask scheduler, as
        ``"tcp://10.0.0.5:8786"``.
    own
        What makes an executor of a number.
    """
    return dask_cluster(workers) if isinstance(workers, str) else own(workers)
