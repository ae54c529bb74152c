"""The decorator that compiles a function, with a disk cache keyed by the sources' content.

numba's own cache looks at one file only: a caller of an edited function in another file is not
recompiled and may crash the interpreter. Here the cache folder's name is a digest of every source
in this package and of the versions involved, so an edit or an upgrade starts a fresh folder.
"""

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

# Sums may be reordered and fused; NaN and infinity keep their meaning.
FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}


@cache
def cache_folder() -> Path:
    """The folder for everything that can be computed again, ``IDENTKNEE_CACHE`` if that is set."""
    return Path(os.environ.get("IDENTKNEE_CACHE") or user_cache_path("identknee"))


@cache
def _compiled_folder() -> Path:
    digest = hashlib.sha256(f"numba {numba.__version__} numpy {np.__version__}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return cache_folder() / "compiled" / digest.hexdigest()[:16]


def compiled(function: Function) -> Function:
    """`function` compiled on first call, without the interpreter's lock, and kept on disk."""
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_compiled_folder())
    try:
        result: Function = numba.njit(
            cache=True, nogil=True, fastmath=FAST_MATH, error_model="numpy"
        )(function)
    except RuntimeError:  # No writable cache: compile every time rather than fail.
        result = numba.njit(nogil=True, fastmath=FAST_MATH, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = previous
    return result
