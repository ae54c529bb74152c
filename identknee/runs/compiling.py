"""Functions compiled by numba, and kept on disk as long as their sources stay as they are."""

import hashlib
import pickle
import subprocess
import sys
from collections.abc import Callable
from functools import cache, partial, wraps
from pathlib import Path
from typing import Any

import numba
import numpy as np
from filelock import FileLock, Timeout

from identknee.runs.files import cache_folder

Function = Callable[..., Any]
# Longest wait for another process that compiles the same function; then this one compiles it too.
MOST_SECONDS = 120.0


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


def compiled_once(function: Function, **options: Any) -> Function:
    """A function for Python to call, compiled once, so that processes run the same machine code.

    Code that is compiled together with its callees and code that is made with callees from the disk
    may differ in the last bits of their results. So one separate process compiles the function
    while others wait, and all load the result from the disk.
    """
    made: list[Any] = []

    @wraps(function)
    def call(*arguments: Any) -> Any:
        if not made:
            dispatcher: Any = compiled(function, **options)
            kinds = tuple(map(numba.typeof, arguments))
            _compile_elsewhere(function, kinds, dispatcher.stats.cache_path)
            dispatcher.compile(kinds)
            made.append(dispatcher)
        return made[0](*arguments)

    call.dispatcher = partial(compiled, function, **options)  # type: ignore[attr-defined]
    return call


# Program of a process that only compiles; it imports from the same places as its parent.
_COMPILE = """
import importlib, pickle, sys
sys.path, module, name, kinds = pickle.load(sys.stdin.buffer)
getattr(importlib.import_module(module), name).dispatcher().compile(pickle.loads(kinds))
"""


def _compile_elsewhere(function: Function, kinds: tuple[Any, ...], folder: str | None) -> None:
    if folder is None:  # There is no writable cache: every process compiles.
        return
    mark = Path(folder) / f"{function.__name__}.compiled"
    given = (sys.path, function.__module__, function.__name__, pickle.dumps(kinds))
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(mark.with_suffix(".lock"), timeout=MOST_SECONDS):
            if not mark.exists():
                subprocess.run(
                    [sys.executable, "-c", _COMPILE],
                    input=pickle.dumps(given),
                    check=True,
                    capture_output=True,
                )
                mark.touch()
    # The caller then compiles it itself.
    except (Timeout, OSError, subprocess.CalledProcessError):
        return


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
