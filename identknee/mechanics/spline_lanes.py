"""Value, gradient and Hessian of a cubic spline at one point, four coefficients at a time.

The compiler does not find this form by itself: left to it, a point costs nearly twice the time. The
four coefficients along z stay in one vector until the sums over x and y are done.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_LANES = ir.VectorType(ir.DoubleType(), 4)
_INDEX = ir.IntType(64)
_FLAGS = ("contract", "reassoc")
# Which derivative along x and y each partial sum takes, and which sum and derivative along z each
# result takes: value; x, y, z; xx, yy, zz; xy, xz, yz.
_SUMS = ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2))
_RESULTS = ((0, 0), (1, 0), (3, 0), (0, 1), (2, 0), (5, 0), (0, 2), (4, 0), (1, 1), (3, 1))


@intrinsic
def spline_at(  # type: ignore[no-untyped-def]
    _typing, coefficients, first, stride_x, stride_y, weights, row
):
    """The spline's value and derivatives (10), in units of the grid.

    `first` is where the 4 x 4 x 4 coefficients of the cell begin; row `row` of `weights` (n, 36)
    holds, for x, y and z, the four weights of the value, of the first and of the second derivative.
    """
    signature = types.UniTuple(types.float64, 10)(
        coefficients, first, stride_x, stride_y, weights, row
    )
    return signature, _generate


def _generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    def address(position: int) -> Any:
        array = context.make_array(signature.args[position])
        return array(context, builder, arguments[position]).data

    start = builder.mul(arguments[5], ir.Constant(_INDEX, 36))
    coefficients, weights = address(0), builder.gep(address(4), [start])

    def load(start: Any, offset: Any) -> Any:
        pointer = builder.bitcast(builder.gep(start, [offset]), _LANES.as_pointer())
        vector = builder.load(pointer)
        vector.align = 8
        return vector

    def everywhere(k: int) -> Any:
        undefined = ir.Constant(_LANES, ir.Undefined)
        zero = ir.Constant(ir.IntType(32), 0)
        value = builder.load(builder.gep(weights, [ir.Constant(_INDEX, k)]))
        single = builder.insert_element(undefined, value, zero)
        mask = ir.Constant(ir.VectorType(ir.IntType(32), 4), [0] * 4)
        return builder.shuffle_vector(single, undefined, mask)

    def add_product(total: Any, a: Any, b: Any) -> Any:
        product = builder.fmul(a, b, flags=_FLAGS)
        return product if total is None else builder.fadd(total, product, flags=_FLAGS)

    along_x, along_y = [everywhere(k) for k in range(12)], [everywhere(12 + k) for k in range(12)]
    sums: list[Any] = [None] * len(_SUMS)
    for x in range(4):
        row = builder.add(arguments[1], builder.mul(arguments[2], ir.Constant(_INDEX, x)))
        partial: list[Any] = [None] * 3
        for y in range(4):
            vector = load(coefficients, row)
            row = builder.add(row, arguments[3])
            for d in range(3):
                partial[d] = add_product(partial[d], along_y[4 * d + y], vector)
        for n, (dx, dy) in enumerate(_SUMS):
            sums[n] = add_product(sums[n], along_x[4 * dx + x], partial[dy])
    along_z = [load(weights, ir.Constant(_INDEX, 24 + 4 * d)) for d in range(3)]
    number = ir.DoubleType()
    reduce = cgutils.get_or_insert_function(
        builder.module,
        ir.FunctionType(number, [number, _LANES]),
        "llvm.vector.reduce.fadd.v4f64",
    )
    results = []
    for n, dz in _RESULTS:
        product = builder.fmul(sums[n], along_z[dz], flags=_FLAGS)
        start = ir.Constant(number, -0.0)
        results.append(builder.call(reduce, [start, product], fastmath=("reassoc",)))
    return context.make_tuple(builder, signature.return_type, results)
