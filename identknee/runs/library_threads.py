"""How many threads the libraries of linear algebra may start."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Libraries read these when they are loaded.
LIBRARY_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def use_one_library_thread() -> Any:
    """Keep linear algebra to the calling thread from now on; gives back how to undo it.

    Threads inside linear algebra on matrices of ten to fifty columns cost more than they bring:
    beside other processes they wait for each other, and a fit takes up to a hundred times as long.
    Libraries that are loaded later, and processes that are started, keep to one thread as well.
    """
    # Not loaded by the start of a command.
    from threadpoolctl import threadpool_limits

    os.environ.update(dict.fromkeys(LIBRARY_THREADS, "1"))
    return threadpool_limits(limits=1, user_api="blas")


@contextmanager
def one_library_thread() -> Iterator[None]:
    """Context in which linear algebra keeps to the calling thread."""
    before = {name: os.environ.get(name) for name in LIBRARY_THREADS}
    limits = use_one_library_thread()
    try:
        yield
    finally:
        limits.restore_original_limits()
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
