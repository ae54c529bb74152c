"""Closed-form landscapes with known basins and cliffs, picklable."""

from dataclasses import dataclass

import numpy as np
from problems import plain_parameters

from identknee.model.parameters import Parameters
from identknee.runs.declare import Array

BOX = plain_parameters(2, -6.0, 6.0)


@dataclass(frozen=True, kw_only=True)
class TwoWells:
    """Residuals ``x^2 - 4`` and ``0.1 (x - 2)``, and ``y``: a minimum at x = 2, a second near -2.

    Searches that descend from x < 0 find the second, so that each takes half of the bounds.
    """

    parameters: Parameters = BOX

    def residuals(self, theta: Array) -> Array:
        x, y = theta
        return np.array([x**2 - 4.0, 0.1 * (x - 2.0), y])

    def jacobian(self, theta: Array) -> Array:
        return np.array([[2.0 * theta[0], 0.0], [0.1, 0.0], [0.0, 1.0]])


@dataclass(frozen=True, kw_only=True)
class Quadrant:
    """A distance from the origin, with no prediction where the first parameter is above `wall`."""

    wall: float = 2.0
    parameters: Parameters = BOX

    def residuals(self, theta: Array) -> Array:
        return np.full(2, np.inf) if theta[0] > self.wall else np.array(theta, dtype=np.float64)

    def jacobian(self, theta: Array) -> Array:
        return np.eye(2) if theta[0] <= self.wall else np.full((2, 2), np.nan)


@dataclass(frozen=True, kw_only=True)
class Trench:
    """One residual ``x - 1``: the second parameter changes nothing, and the minimum is a line."""

    parameters: Parameters = BOX

    def residuals(self, theta: Array) -> Array:
        return np.array([theta[0] - 1.0])

    def jacobian(self, theta: Array) -> Array:
        return np.array([[1.0, 0.0]])


def lost_sides(theta: Array) -> list[str]:
    """What a `Quadrant` loses beyond its wall."""
    return ["right"] if theta[0] > 2.0 else []
