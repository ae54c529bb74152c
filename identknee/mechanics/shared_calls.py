"""Calls of compiled code that several threads share, without the interpreter in between.

A call begins with a table of numbers: its state, whether a helper is to leave, then the arguments.
The thread that calls offers its helpers a share while they look for one inside compiled code, and
takes back what no helper has taken. Waking a thread would take longer than what it is woken for.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from identknee.mechanics.compiled import compiled_in_place
from identknee.mechanics.memory import ALONE, ASLEEP, AWAKE, ENDED, OFFERED, TAKEN, WORD

# Looks for an offer, some 4 ms, after which a helper leaves the processor to others.
LOOKS = 10_000_000


@intrinsic
def read(_typing, address):  # noqa: ARG001
    """The number at an address, with all that was written before it was."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.load_atomic(_pointer(builder, arguments[0]), "acquire", WORD)

    return types.int64(types.int64), generate


@intrinsic
def replace(_typing, address, old, new):  # noqa: ARG001
    """Whether the old number stood at an address; then the new one stands there."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        address, old, new = arguments
        order = ("seq_cst", "seq_cst")
        found = builder.cmpxchg(_pointer(builder, address), old, new, *order)
        return builder.extract_value(found, 1)

    return types.boolean(types.int64, types.int64, types.int64), generate


@intrinsic
def count_up(_typing, address):  # noqa: ARG001
    """The number at an address, which is one more afterwards."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        one = ir.Constant(ir.IntType(64), 1)
        return builder.atomic_rmw("add", _pointer(builder, arguments[0]), one, "seq_cst")

    return types.int64(types.int64), generate


def _pointer(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, ir.IntType(64).as_pointer())


@compiled_in_place
def begins(table):
    """Whether to run the call that a table describes: once if alone, else once an offer."""
    if replace(table, ALONE, ENDED):
        return True
    if read(table) == ENDED:
        return False
    replace(table, TAKEN, AWAKE)
    replace(table, ASLEEP, AWAKE)
    for _ in range(LOOKS):
        if read(table) == OFFERED and replace(table, OFFERED, TAKEN):
            return True
        if read(table + WORD):
            break
    return not replace(table, AWAKE, ASLEEP) and replace(table, OFFERED, TAKEN)


@compiled_in_place
def offer(table):
    """Offer a share of the call to a helper that looks for one."""
    replace(table, AWAKE, OFFERED)


@compiled_in_place
def take_back(table):
    """Take back what was offered, or wait until the helper that took it is done."""
    if not replace(table, OFFERED, AWAKE):
        while read(table) == TAKEN:
            pass
