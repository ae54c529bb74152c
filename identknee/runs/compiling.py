"""Functions compiled by numba, and kept on disk as long as their sources stay as they are."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np

from identknee.runs.cache_folder import cache_folder

Function = Callable[..., Any]


def compiled(
    function: Function, *, fastmath: bool | set[str] = False, inline: str = "never"
) -> Function:
    """`function` compiled at its first call, without the interpreter's lock, and kept on disk.

    Parameters
    ----------
    fastmath
        Liberties the compiler may take with floating-point arithmetic, as numba names them.
    inline
        ``"always"`` to compile it as if it stood in its callers.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    options |= {"fastmath": fastmath, "inline": inline}
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(compiled_folder(Path(function.__code__.co_filename).parent))
    try:
        result: Function = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # There is no writable cache: every process compiles.
        result = numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = before
    return result


@cache
def compiled_folder(package: Path) -> Path:
    """The folder that keeps what is compiled from the sources in `package`.

    Its name is a hash of all of them, because numba compares only the file of the function that is
    called: it would go on using one whose callees, in other files, were edited.
    """
    content = hashlib.sha256(f"numba {numba.__version__} numpy {np.__version__}".encode())
    for source in sorted(package.glob("*.py")):
        content.update(source.read_bytes())
    return cache_folder() / "compiled" / f"{package.name}-{content.hexdigest()[:16]}"
