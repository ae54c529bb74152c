"""The decorators that compile the functions of this package."""

from functools import partial

from identknee.runs import compiling

# Sums may be reordered and fused; NaN and infinity keep their meaning.
FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}

compiled = partial(compiling.compiled, fastmath=FAST_MATH)
# For the body of a loop over elements: inlined, so that the compiler takes four elements at a time.
compiled_into_callers = partial(compiled, inline="always")
# For functions that Python calls and whose results must agree to the last bit between processes.
compiled_once = partial(compiling.compiled_once, fastmath=FAST_MATH)
