"""The process that compiles a function for others to load.

Run as ``python -m identknee.mechanics.object_process``; it answers one request on standard input
with an object file on standard output.
"""

import ctypes
import gc
import sys

from llvmlite import binding


def main() -> None:
    """Compile what is asked for, and nothing that only this process would call."""
    # Short-lived, and all that the compiler makes hangs together: nothing is worth collecting.
    gc.disable()
    # Machine code is wanted of the whole alone. Numba, which looks these up when it is imported,
    # would have it made of every part as well, in a quarter of the time, to write addresses there.
    nowhere = ctypes.create_string_buffer(ctypes.sizeof(ctypes.c_void_p))
    binding.ExecutionEngine.finalize_object = lambda _: None
    binding.ExecutionEngine.get_global_value_address = lambda *_: ctypes.addressof(nowhere)

    from identknee.mechanics import compiled
    from identknee.mechanics.object_file import object_file

    compiled.is_for_others = True
    sys.stdout.buffer.write(object_file(sys.stdin.buffer.read()))


if __name__ == "__main__":
    main()
