"""Scalar functions of the parameters, with derivatives."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import declared

# The cube root of the rounding error: the best step of central differences.
DIFFERENCE_STEP = float(np.cbrt(np.finfo(np.float64).eps))
UNITS = {"kN": "kN", "pct": "%", "mm": "mm", "deg": "deg", "N": "N"}


class Quantity(Protocol):
    """A number as a function of theta, with its derivatives."""

    @property
    def name(self) -> str:
        """Its name, for example ``"ACL force, trial 12"``."""
        ...

    @property
    def unit(self) -> str:
        """Its unit, for example ``"N"``; empty if it has none."""
        ...

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient by theta, shape ``(n,)``; NaN where there is no prediction."""
        ...


@declared
class ParameterQuantity:
    """One of the parameters as a quantity.

    Attributes
    ----------
    parameters
        All parameters, in the order of theta.
    name
        Name of the one meant.

    Raises
    ------
    ValueError
        If there is no parameter of that name.
    """

    parameters: Parameters
    name: str

    def __post_init__(self) -> None:
        self.parameters.index(self.name)

    @property
    def unit(self) -> str:
        """Its unit: the last word of the name, where that is one."""
        return UNITS.get(self.name.rpartition("_")[2], "")

    @property
    def index(self) -> int:
        """Its index in theta."""
        return self.parameters.index(self.name)

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient by theta, shape ``(n,)``."""
        gradient = np.zeros(self.parameters.n)
        gradient[self.index] = 1.0
        return float(theta[self.index]), gradient


@declared
class UserQuantity:
    """Any function of theta as a quantity.

    Attributes
    ----------
    name, unit
        What to call it, and its unit.
    function
        Its value at theta, shape ``(n,)``; NaN where there is none.
    gradient
        Its derivatives at theta, shape ``(n,)``. Central differences take its place where it is
        None: the function is then asked up to 6e-6 of a parameter outside the bounds too, and a
        side without a value is left out.
    """

    name: str
    unit: str
    function: Callable[[Array], float]
    gradient: Callable[[Array], Array] | None = None

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient by theta, shape ``(n,)``; NaN where there is no value."""
        value = float(self.function(theta))
        if not np.isfinite(value):
            return np.nan, np.full(theta.size, np.nan)
        if self.gradient is not None:
            return value, np.asarray(self.gradient(theta), dtype=np.float64)
        return value, np.array([self._difference(theta, value, i) for i in range(theta.size)])

    def _difference(self, theta: Array, value: float, i: int) -> float:
        step = DIFFERENCE_STEP * max(1.0, abs(theta[i]))
        places, values = [theta[i]], [value]
        for sign in (-1.0, 1.0):
            moved = np.array(theta)
            moved[i] += sign * step
            there = float(self.function(moved))
            if np.isfinite(there):
                places.append(moved[i])
                values.append(there)
        if len(places) == 1:
            return np.nan
        # With both sides the value in the middle drops out.
        low, high = (0, 1) if len(places) == 2 else (1, 2)
        return float((values[high] - values[low]) / (places[high] - places[low]))


@declared
class RestrictedQuantity:
    """A quantity of all parameters of which only some are free.

    Attributes
    ----------
    quantity
        Over all parameters.
    free
        The parameters that move, and the values of the others.
    """

    quantity: Quantity
    free: FreeParameters

    @property
    def name(self) -> str:
        """That of the quantity."""
        return self.quantity.name

    @property
    def unit(self) -> str:
        """That of the quantity."""
        return self.quantity.unit

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient by the free parameters, shape ``(n_free,)``."""
        value, gradient = self.quantity.evaluate(self.free.expand(theta))
        return value, self.free.restrict(gradient)
