"""Where the generator keeps what can be computed again, and how its functions are compiled."""

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from platformdirs import user_cache_path

Function = Callable[..., Any]


def cache_root() -> Path:
    """The folder of everything kept between calls, in ``IDENTKNEE_CACHE`` if that is set."""
    return Path(os.environ.get("IDENTKNEE_CACHE") or user_cache_path("identknee")) / "blind"


def compiled(function: Function) -> Function:
    """`function` compiled on its first call and kept on disk.

    The folder is named after the sources of this package, because numba itself would go on using
    a function of one file after an edit to another that it calls.
    """
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_root() / f"compiled-{_digest()}")
    try:
        result: Function = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # No place to keep it: compile in every process.
        result = numba.njit(nogil=True, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = before
    return result


@cache
def _digest() -> str:
    digest = hashlib.sha256(f"numba {numba.__version__} numpy {np.__version__}".encode())
    for source in ("compiling.py", "energy.py", "equilibrium.py"):
        digest.update(Path(__file__).with_name(source).read_bytes())
    return digest.hexdigest()[:16]
