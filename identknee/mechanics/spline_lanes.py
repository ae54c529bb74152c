"""Value, gradient and Hessian of a cubic spline at one point, four coefficients at a time.

The compiler does not find this form by itself: left to it, a point costs nearly twice the time. The
four coefficients along z stay in one vector until the sums over x and y are done.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_LANES = ir.VectorType(ir.DoubleType(), 4)
_INDEX = ir.IntType(64)
_FLAGS = ("contract", "reassoc")
# The four weights of a cubic B-spline as polynomials of the place in the cell, lowest power first.
_WEIGHTS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
# Which derivative along x and y each partial sum takes, and which sum and derivative along z each
# result takes: value; x, y, z; xx, yy, zz; xy, xz, yz.
_SUMS = ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2))
_RESULTS = ((0, 0), (1, 0), (3, 0), (0, 1), (2, 0), (5, 0), (0, 2), (4, 0), (1, 1), (3, 1))


@intrinsic
def spline_at(  # type: ignore[no-untyped-def]
    _typing, coefficients, first, stride_x, stride_y, x, y, z, weights
):
    """The spline's value and derivatives (10), in units of the grid, at a place in a cell.

    `first` is where the 4 x 4 x 4 coefficients of the cell begin; `x`, `y` and `z` are the place in
    it, from 0 to 1. What is computed of the weights on the way goes to `weights` (24).
    """
    signature = types.UniTuple(types.float64, 10)(
        coefficients, first, stride_x, stride_y, x, y, z, weights
    )
    return signature, _generate


def _generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    lanes = _Lanes(builder)

    def address(position: int) -> Any:
        array = context.make_array(signature.args[position])
        return array(context, builder, arguments[position]).data

    coefficients, weights = address(0), address(7)
    # Weights along x and y are needed one by one in all lanes, which is quickest from memory.
    for axis in range(2):
        for d, vector in enumerate(lanes.weights(arguments[4 + axis])):
            lanes.store(vector, weights, 12 * axis + 4 * d)
    along_x, along_y = (
        [lanes.everywhere(weights, 12 * axis + k) for k in range(12)] for axis in range(2)
    )
    sums: list[Any] = [None] * len(_SUMS)
    for x in range(4):
        row = builder.add(arguments[1], builder.mul(arguments[2], ir.Constant(_INDEX, x)))
        partial: list[Any] = [None] * 3
        for y in range(4):
            vector = lanes.load(coefficients, row)
            row = builder.add(row, arguments[3])
            for d in range(3):
                partial[d] = lanes.add_product(partial[d], along_y[4 * d + y], vector)
        for n, (dx, dy) in enumerate(_SUMS):
            sums[n] = lanes.add_product(sums[n], along_x[4 * dx + x], partial[dy])
    along_z = lanes.weights(arguments[6])
    products = [lanes.product(sums[n], along_z[dz]) for n, dz in _RESULTS]
    return context.make_tuple(builder, signature.return_type, lanes.totals(products))


class _Lanes:
    """Arithmetic of vectors of four numbers."""

    def __init__(self, builder: Any) -> None:
        self._builder = builder

    def load(self, start: Any, offset: Any) -> Any:
        pointer = self._builder.bitcast(self._builder.gep(start, [offset]), _LANES.as_pointer())
        vector = self._builder.load(pointer)
        vector.align = 8
        return vector

    def store(self, vector: Any, start: Any, k: int) -> None:
        place = self._builder.gep(start, [ir.Constant(_INDEX, k)])
        pointer = self._builder.bitcast(place, _LANES.as_pointer())
        self._builder.store(vector, pointer).align = 8

    def everywhere(self, start: Any, k: int) -> Any:
        """One number of an array in all lanes."""
        place = self._builder.gep(start, [ir.Constant(_INDEX, k)])
        return self._repeat(self._builder.load(place))

    def product(self, a: Any, b: Any) -> Any:
        return self._builder.fmul(a, b, flags=_FLAGS)

    def add_product(self, total: Any, a: Any, b: Any) -> Any:
        product = self.product(a, b)
        return product if total is None else self._builder.fadd(total, product, flags=_FLAGS)

    def weights(self, place: Any) -> list[Any]:
        """The four weights of the value, of the first and of the second derivative."""
        u = self._repeat(place)
        result = []
        for order in range(3):
            powers = np.polynomial.polynomial.polyder(_WEIGHTS, order, axis=0)
            vectors = [ir.Constant(_LANES, list(map(float, x))) for x in powers]
            total = vectors.pop()
            while vectors:
                total = self.add_product(vectors.pop(), total, u)
            result.append(total)
        return result

    def totals(self, vectors: list[Any]) -> list[Any]:
        """The sum of the lanes of each vector, found for four vectors at once."""
        result = []
        for first in range(0, len(vectors), 4):
            group = vectors[first : first + 4]
            a, b, c, d = group + [group[0]] * (4 - len(group))
            ab, cd = self._added_pairwise(a, b), self._added_pairwise(c, d)
            low, high = (self._shuffle(ab, cd, x) for x in ((0, 1, 4, 5), (2, 3, 6, 7)))
            total = self._builder.fadd(low, high, flags=_FLAGS)
            for k in range(len(group)):
                lane = ir.Constant(ir.IntType(32), k)
                result.append(self._builder.extract_element(total, lane))
        return result

    def _added_pairwise(self, a: Any, b: Any) -> Any:
        low, high = (self._shuffle(a, b, x) for x in ((0, 4, 2, 6), (1, 5, 3, 7)))
        return self._builder.fadd(low, high, flags=_FLAGS)

    def _shuffle(self, a: Any, b: Any, lanes: tuple[int, ...]) -> Any:
        mask = ir.Constant(ir.VectorType(ir.IntType(32), 4), list(lanes))
        return self._builder.shuffle_vector(a, b, mask)

    def _repeat(self, value: Any) -> Any:
        undefined = ir.Constant(_LANES, ir.Undefined)
        zero = ir.Constant(ir.IntType(32), 0)
        single = self._builder.insert_element(undefined, value, zero)
        return self._shuffle(single, undefined, (0, 0, 0, 0))
