"""The decorators that compile functions.

What Python calls is reached through `identknee.mechanics.machine_code`. Only the process that
compiles it, and tests of its parts, import this module and with it the compiler.
"""

from collections.abc import Callable
from typing import Any

import numba

from identknee.mechanics.compiled_folder import compiled_folder

Function = Callable[..., Any]

# Sums may be reordered and fused; NaN and infinity keep their meaning.
FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}

# Whether this process compiles for others to load, as `identknee.mechanics.object_process` does.
is_for_others = False


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
    if is_for_others:
        return compiled_with(function, no_cpython_wrapper=True, **options)
    return compiled_with(function, cache=True, **options)


def compiled_with(function: Function, **options: Any) -> Function:
    """`function` compiled with numba's options and those that all have in common."""
    options |= {"nogil": True, "fastmath": FAST_MATH, "error_model": "numpy"}
    options |= {"no_cfunc_wrapper": True}  # C calls none of them.
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(compiled_folder())
    try:
        result: Function = numba.njit(**options)(function)
    except RuntimeError:  # No writable cache: compile every time rather than fail.
        result = numba.njit(**{**options, "cache": False})(function)
    finally:
        numba.config.CACHE_DIR = previous
    return result
