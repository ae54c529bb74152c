"""The door to compiled functions: machine code that one process makes and every other loads.

The compiler takes seconds to compile and half a second to begin. So what Python calls is compiled
once, in a process of its own, to an object file that is kept; a process that finds one loads it
without the compiler, and all run the same code, to the last bit.
"""

import ctypes
import hashlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn

import numpy as np
from llvmlite import binding

from identknee.mechanics.compiled_folder import compiled_folder
from identknee.mechanics.memory import ALONE
from identknee.runs.errors import InputError
from identknee.runs.files import write_atomically
from identknee.runs.turns import in_turn

# What an argument is: the letter of an array's type and its number of axes, the class of a tuple
# with what is in it, or the type of a number.
Kind = tuple[Any, ...]
# Numba's calling convention: where to put a result and an error, then the argument; 0 if all went
# well.
_SIGNATURE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)


class Packed:
    """An argument of compiled functions whose addresses were looked up before.

    Never pickled: another process has other addresses.
    """

    __slots__ = ("arrays", "kind", "table")

    def __init__(self, arrays: Any) -> None:
        self.arrays = arrays
        self.table: list[int] = []
        self.kind = _put(arrays, self.table)

    # typing.override came with Python 3.12.
    def __reduce__(self) -> NoReturn:  # type: ignore[explicit-override]
        raise TypeError("addresses mean nothing in another process")


class MachineCode:
    """A compiled function that Python calls.

    Arguments are arrays in C order, tuples of them, and whole numbers; it gives nothing back but
    what it writes to arrays, and other threads go on while it runs.
    """

    def __init__(self, module: str, name: str) -> None:
        self._module, self._name = module, name
        self._loaded: dict[tuple[Kind, ...], Callable[[int], None]] = {}
        self._loading = threading.Lock()

    def __call__(self, *arguments: Any) -> None:
        """Run it, once loaded for arguments of these kinds."""
        run, table = self.prepared(*arguments)
        numbers = np.array(table, np.int64)
        run(numbers.ctypes.data)

    def prepared(self, *arguments: Any) -> tuple[Callable[[int], None], list[int]]:
        """The code for arguments of these kinds, loaded, and the table of a call with them."""
        table = [ALONE, 0]
        kinds = tuple([_put(x, table) for x in arguments])
        run = self._loaded.get(kinds)
        if run is None:
            with self._loading:
                if kinds not in self._loaded:
                    self._loaded[kinds] = _load(self._module, self._name, kinds)
                run = self._loaded[kinds]
        return run, table


def _put(argument: Any, table: list[int]) -> Kind:
    """Append to the table where an argument is and how large; give back what it is."""
    if isinstance(argument, Packed):
        table += argument.table
        return argument.kind
    if isinstance(argument, np.ndarray):
        if not argument.flags.c_contiguous:
            raise ValueError("compiled functions take arrays in C order")
        table.append(argument.ctypes.data)
        table += argument.shape
        return argument.dtype.char, argument.ndim
    if isinstance(argument, tuple):
        return type(argument), *[_put(x, table) for x in argument]
    table.append(int(argument))
    return (type(argument),)


_engines: list[Any] = []  # They own the code.


def _load(module: str, name: str, kinds: tuple[Kind, ...]) -> Callable[[int], None]:
    """The machine code for arguments of these kinds, made by another process unless it is kept."""
    content = _made(module, name, kinds)
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_default_triple().create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
    engine.add_object_file(binding.ObjectFileRef.from_data(content))
    engine.finalize_object()
    native = _SIGNATURE(engine.get_function_address(name))
    _engines.append(engine)
    unused = ctypes.create_string_buffer(8)

    def run(table: int) -> None:
        if native(unused, unused, table):
            raise RuntimeError(f"the compiled function {name} failed")

    return run


def _made(module: str, name: str, kinds: tuple[Kind, ...]) -> bytes:
    """The object file, from where it is kept if it can be kept anywhere."""
    request = pickle.dumps((module, name, kinds))
    place = (
        compiled_folder() / f"{name}-{hashlib.sha256(request + _processor()).hexdigest()[:16]}.o"
    )
    with suppress(OSError):
        return place.read_bytes()
    with suppress(OSError):  # Where nothing can be kept, every process compiles.
        place.parent.mkdir(parents=True, exist_ok=True)
    with in_turn(place):
        with suppress(OSError):
            return place.read_bytes()
        content = _compiled_apart(request)
        with suppress(InputError):
            write_atomically(place, content)
    return content


def _compiled_apart(request: bytes) -> bytes:
    """The object file made by another process, or by this one where there can be no other."""
    # Parts are optimised together, once.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "NUMBA_OPT": "0"}
    try:
        made = subprocess.run(
            # Without the folder it is run in, which may hold another version of this package.
            [sys.executable, "-P", "-m", "identknee.mechanics.object_process"],
            input=request,
            env=environment,
            check=True,
            capture_output=True,
        )
    except (OSError, subprocess.SubprocessError):
        from identknee.mechanics.object_file import object_file

        return object_file(request)
    return made.stdout


def _processor() -> bytes:
    features = binding.get_host_cpu_features().flatten()
    return f"{binding.get_host_cpu_name()} {features}".encode()
