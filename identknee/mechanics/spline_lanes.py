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
_FLAGS = ("contract",)
# The four weights of a cubic B-spline as polynomials of the place in the cell, lowest power first.
_WEIGHTS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
# Which derivative along x, y and z each result is: value; x, y, z; xx, yy, zz; xy, xz, yz.
_RESULTS = (
    *((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    *((2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (1, 0, 1), (0, 1, 1)),
)


@intrinsic
def spline_at(  # type: ignore[no-untyped-def]
    _typing, coefficients, first, stride_x, stride_y, x, y, z
):
    """The spline's value and derivatives (10), in units of the grid, at a place in a cell.

    `first` is where the 4 x 4 x 4 coefficients of the cell begin; `x`, `y` and `z` are the place in
    it, from 0 to 1.
    """
    signature = types.UniTuple(types.float64, 10)(coefficients, first, stride_x, stride_y, x, y, z)
    return signature, _generate


def _generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    lanes = _Lanes(builder)
    array = context.make_array(signature.args[0])
    coefficients = array(context, builder, arguments[0]).data
    _, row_x, stride_x, stride_y, x, y, z = arguments
    x, y, z = (lanes.everywhere(place) for place in (x, y, z))
    along_y = []
    for _ in range(4):
        row, four = row_x, []
        for _ in range(4):
            four.append(lanes.load(coefficients, row))
            row = builder.add(row, stride_y)
        along_y.append(lanes.derivatives(four, y, 2))
        row_x = builder.add(row_x, stride_x)
    along_xy = [lanes.derivatives([c[d] for c in along_y], x, 2 - d) for d in range(3)]
    weights = lanes.weights(z)
    products = [lanes.product(along_xy[dy][dx], weights[dz]) for dx, dy, dz in _RESULTS]
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

    def everywhere(self, value: Any) -> Any:
        """One number in all lanes."""
        undefined = ir.Constant(_LANES, ir.Undefined)
        zero = ir.Constant(ir.IntType(32), 0)
        single = self._builder.insert_element(undefined, value, zero)
        return self._shuffle(single, undefined, (0, 0, 0, 0))

    def constant(self, value: float) -> Any:
        return ir.Constant(_LANES, [value] * 4)

    def product(self, a: Any, b: Any) -> Any:
        return self._builder.fmul(a, b, flags=_FLAGS)

    def sum(self, a: Any, b: Any) -> Any:
        return self._builder.fadd(a, b, flags=_FLAGS)

    def difference(self, a: Any, b: Any) -> Any:
        return self._builder.fsub(a, b, flags=_FLAGS)

    def add_product(self, total: Any, a: Any, b: Any) -> Any:
        return self.sum(total, self.product(a, b))

    def derivatives(self, four: list[Any], place: Any, highest: int) -> list[Any]:
        """Value and derivatives, as far as the `highest`, from four coefficients along an axis.

        Taken from their differences, which needs fewer products than weights do.
        """
        half, third = (self.product(place, self.constant(1 / k)) for k in (2, 3))
        before, here, after, last = four
        first = self.difference(here, before)
        middle = self.difference(after, here)
        bend = self.difference(middle, first)
        change = self.difference(self.difference(self.difference(last, after), middle), bend)
        slope = self.product(self.difference(after, before), self.constant(1 / 2))
        rise = self.add_product(slope, half, self.add_product(bend, third, change))
        start = self.add_product(here, self.constant(1 / 6), bend)
        result = [self.add_product(start, place, rise)]
        if highest > 0:
            mean = self.add_product(bend, half, change)
            result.append(self.add_product(slope, place, mean))
        if highest > 1:
            result.append(self.add_product(bend, place, change))
        return result

    def weights(self, place: Any) -> list[Any]:
        """The four weights of the value, of the first and of the second derivative."""
        result = []
        for order in range(3):
            powers = np.polynomial.polynomial.polyder(_WEIGHTS, order, axis=0)
            vectors = [ir.Constant(_LANES, list(map(float, x))) for x in powers]
            total = vectors.pop()
            while vectors:
                total = self.add_product(vectors.pop(), total, place)
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
            total = self.sum(low, high)
            for k in range(len(group)):
                lane = ir.Constant(ir.IntType(32), k)
                result.append(self._builder.extract_element(total, lane))
        return result

    def _added_pairwise(self, a: Any, b: Any) -> Any:
        low, high = (self._shuffle(a, b, x) for x in ((0, 4, 2, 6), (1, 5, 3, 7)))
        return self.sum(low, high)

    def _shuffle(self, a: Any, b: Any, lanes: tuple[int, ...]) -> Any:
        mask = ir.Constant(ir.VectorType(ir.IntType(32), 4), list(lanes))
        return self._builder.shuffle_vector(a, b, mask)
