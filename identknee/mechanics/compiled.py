"""The decorators that compile the functions of this package."""

from functools import partial

from identknee.runs import compiling

# Sums may be reordered and fused; NaN and infinity keep their meaning.
FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}

compiled = partial(compiling.compiled, fastmath=FAST_MATH)
# What a loop does with each element: the compiler takes four at a time where it stands in the loop.
compiled_into_callers = partial(compiled, inline="always")
# What Python calls and bits hang on.
compiled_once = partial(compiling.compiled_once, fastmath=FAST_MATH)
