"""The decorator that compiles a function, with a disk cache keyed by the sources' content.

numba's own cache looks at one file only: a caller of an edited function in another file is not
recompiled and may crash the interpreter. Here the cache folder's name is a digest of every source
in this package, of where it lies and since when, which numba asks for as well, and of the versions
involved, so an edit, an upgrade or another installation starts a fresh folder.

A process that compiles also runs other machine code than one that loads what was kept: its linker
takes an inner function from where that was compiled alone, not from the optimised whole, and sums
come out different in their last bits. A run begun by the one and resumed by the other would not
repeat itself, so what Python calls is compiled in a process of its own and then always loaded.
"""

import gc
import hashlib
import importlib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np
from platformdirs import user_cache_path

from identknee.runs.errors import InputError
from identknee.runs.files import write_atomically

Function = Callable[..., Any]

# Sums may be reordered and fused; NaN and infinity keep their meaning.
FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}

# Whether this process compiles for others to load.
_for_others = False


@cache
def cache_folder() -> Path:
    """The folder for everything that can be computed again, ``IDENTKNEE_CACHE`` if that is set."""
    return Path(os.environ.get("IDENTKNEE_CACHE") or user_cache_path("identknee"))


@cache
def _compiled_folder() -> Path:
    digest = hashlib.sha256(f"numba {numba.__version__} numpy {np.__version__}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(f"{source} {source.stat().st_mtime_ns}".encode() + source.read_bytes())
    return cache_folder() / "compiled" / digest.hexdigest()[:16]


def compiled(function: Function) -> Function:
    """`function` compiled on first call, without the interpreter's lock, and kept on disk."""
    return _part(function)


def compiled_in_place(function: Function) -> Function:
    """The same for what writes to arrays it is given, and neither makes any nor gives any back.

    It counts no references to arrays, on which a simulation would spend a fifth of its time.
    """
    return _part(function, _nrt=False)


def compiled_into_callers(function: Function) -> Function:
    """The same, put into its callers as if it stood there: what a loop does with each element."""
    return _part(function, _nrt=False, forceinline=True)


def _part(function: Function, **options: Any) -> Function:
    """A function that compiled ones call, and tests from Python.

    A process that compiles for others makes nothing for Python to call, which would take it twice
    as long, and keeps only the whole.
    """
    if _for_others:
        return _compiled(function, no_cpython_wrapper=True, **options)
    return _compiled(function, cache=True, **options)


def _compiled(function: Function, **options: Any) -> Function:
    options |= {"nogil": True, "fastmath": FAST_MATH, "error_model": "numpy"}
    options |= {"no_cfunc_wrapper": True}  # C calls none of them.
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_compiled_folder())
    try:
        result: Function = numba.njit(**options)(function)
    except RuntimeError:  # No writable cache: compile every time rather than fail.
        result = numba.njit(**{**options, "cache": False})(function)
    finally:
        numba.config.CACHE_DIR = previous
    return result


def compiled_apart(function: Function) -> Function:
    """`function` compiled for Python to call: the same machine code in every process.

    The first process that calls it has another one compile it and loads the result. Where that is
    not possible, because no cache can be written, every process compiles for itself.
    """
    dispatcher: Any = _compiled(function, cache=True)

    @wraps(function)
    def call(*arguments: Any) -> Any:
        if not dispatcher.overloads:
            _have_compiled(function, tuple(numba.typeof(x) for x in arguments))
        return dispatcher(*arguments)

    call.compile = dispatcher.compile  # type: ignore[attr-defined]
    return call


def _have_compiled(function: Function, signature: tuple[Any, ...]) -> None:
    """Compile in another process, unless that was done before."""
    place = _compiled_folder() / f"{_name_of(function, signature)}.done"
    if place.exists():
        return
    code = "from identknee.mechanics.compiled import _compile_here as f; f()"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        _compiled_folder().mkdir(parents=True, exist_ok=True)
        subprocess.run(
            [sys.executable, "-c", code],
            input=pickle.dumps((function.__module__, function.__name__, signature)),
            env=environment,
            check=True,
            capture_output=True,
        )
        write_atomically(place, "")
    except (OSError, InputError, subprocess.SubprocessError):
        return  # Then it is compiled here.


def _compile_here() -> None:
    global _for_others
    _for_others = True
    # Short-lived, and all that the compiler makes hangs together: nothing is worth collecting.
    gc.disable()
    module, name, signature = pickle.loads(sys.stdin.buffer.read())
    getattr(importlib.import_module(module), name).compile(signature)


def _name_of(function: Function, signature: tuple[Any, ...]) -> str:
    """Name of what is compiled, by its argument types and the processor."""
    processor = llvmlite.binding.get_host_cpu_name(), llvmlite.binding.get_host_cpu_features()
    text = f"{signature} {processor[0]} {processor[1].flatten()}"
    return f"{function.__name__}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
