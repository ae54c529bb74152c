"""The object file of a compiled function, as `identknee.mechanics.machine_code` loads it."""

import importlib
import pickle
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from identknee.mechanics import compiled
from identknee.mechanics.memory import HEAD, WORD
from identknee.mechanics.shared_calls import begins


def object_file(request: bytes) -> bytes:
    """The object file of a function, under its name, that takes its arguments from a table.

    Parameters
    ----------
    request
        The pickled name of its module, its own name and what its arguments are.
    """
    module_name, name, kinds = pickle.loads(request)
    function = getattr(importlib.import_module(module_name), name)
    unpacked = _unpacking(types.Tuple([_type_of(x) for x in kinds]))

    def entry(table):  # type: ignore[no-untyped-def]
        while begins(table):
            function(*unpacked(table + HEAD * WORD))

    dispatcher: Any = compiled.compiled_with(entry, no_cpython_wrapper=True, _nrt=False)
    dispatcher.compile((types.int64,))
    (compilation,) = dispatcher.overloads.values()
    (text,) = dispatcher.inspect_llvm().values()
    module = binding.parse_assembly(text)
    module.get_function(compilation.fndesc.llvm_func_name).name = name
    return _machine_code(module, name)


def _machine_code(module: Any, name: str) -> bytes:
    """The object file of a module of which others call one function, optimised as a whole."""
    for function in module.functions:
        if function.name != name and not function.is_declaration:
            # Nobody else calls it: its checks for errors that cannot happen may go with it.
            function.linkage = "internal"
    target = binding.Target.from_default_triple().create_target_machine(
        cpu=binding.get_host_cpu_name(),
        features=binding.get_host_cpu_features().flatten(),
        opt=3,
        jit=True,
    )
    tuning = binding.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = True
    passes = binding.create_pass_builder(target, tuning)
    passes.getModulePassManager().run(module, passes)
    return bytes(target.emit_object(module))


def _type_of(kind: tuple[Any, ...]) -> Any:
    """Numba's type of an argument."""
    what = kind[0]
    if isinstance(what, str):
        return types.Array(numba.from_dtype(np.dtype(what)), kind[1], "C")
    if issubclass(what, tuple):
        parts = [_type_of(x) for x in kind[1:]]
        return types.Tuple(parts) if what is tuple else types.NamedTuple(parts, what)
    return numba.typeof(what())


def _unpacking(wanted: Any) -> Any:
    """A function of the address of a table that gives the arguments it describes."""

    @intrinsic
    def unpacked(_typing, table):  # type: ignore[no-untyped-def]
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
            numbers = _numbers(builder, pointer)
            return _value(context, builder, wanted, numbers)

        return wanted(table), generate

    return unpacked


def _numbers(builder: Any, pointer: Any) -> Iterator[Any]:
    """The numbers of a table, one after the other."""
    k = 0
    while True:
        yield builder.load(builder.gep(pointer, [ir.Constant(ir.IntType(64), k)]))
        k += 1


def _value(context: Any, builder: Any, wanted: Any, numbers: Iterator[Any]) -> Any:
    """An argument made of the next numbers of a table."""
    if isinstance(wanted, types.BaseTuple):
        parts = [_value(context, builder, x, numbers) for x in wanted.types]
        return context.make_tuple(builder, wanted, parts)
    if not isinstance(wanted, types.Array):
        number = next(numbers)
        return context.cast(builder, number, types.int64, wanted)
    array = context.make_array(wanted)(context, builder)
    address = next(numbers)
    shape = [next(numbers) for _ in range(wanted.ndim)]
    size = context.get_abi_sizeof(context.get_data_type(wanted.dtype))
    itemsize = ir.Constant(ir.IntType(64), size)
    strides = [itemsize]
    for n in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], n))
    populate_array(
        array,
        data=builder.inttoptr(address, array.data.type),
        shape=shape,
        strides=strides,
        itemsize=itemsize,
        meminfo=None,
    )
    return array._getvalue()  # noqa: SLF001 - numba's name for the value of a structure
