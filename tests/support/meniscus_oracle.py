"""The energy of menisci as the issue states it, point by point in plain Python and numpy."""

from collections.abc import Sequence

import numpy as np
from energy_evaluation import femoral_places, field_values

from identknee.mechanics.equilibria import Menisci
from identknee.runs.declare import Array

ROUNDING = 0.15  # mm


def pressed(depth: float, rounding: float = ROUNDING) -> tuple[float, float]:
    """How deep a point is felt to lie, and twice the energy of a unit spring pressed so far."""
    if depth <= -rounding:
        return 0.0, 0.0
    if depth >= rounding:
        # The rounded part of the way holds r^2 / 6 more than the law up to the same depth.
        return depth, depth**2 + rounding**2 / 3.0
    felt = (depth + rounding) ** 2 / (4.0 * rounding)
    return felt, (depth + rounding) ** 3 / (6.0 * rounding)


def meniscus_energy(
    menisci: Menisci, values: Sequence[float], flexion: float, pose: Array
) -> tuple[float, Array]:
    """Energy [N mm] at a pose, and the force of each side [N] along the steepest way, ``(2,)``."""
    assert menisci.field is not None
    places = femoral_places(flexion, pose, menisci.points)
    distance = field_values(menisci.field, places)
    step = 1e-4
    slopes = [
        (field_values(menisci.field, places + x) - field_values(menisci.field, places - x))
        / (2.0 * step)
        for x in step * np.eye(3)
    ]
    steepness = np.linalg.norm(slopes, axis=0)
    energy, forces = 0.0, np.zeros(2)
    for i, side in enumerate(menisci.side):
        depth = menisci.heights[i] + values[2] - distance[i]
        felt, twice = pressed(float(depth))
        spring = values[side] * menisci.areas[i]
        energy += 0.5 * spring * twice
        forces[side] += spring * felt * steepness[i]
    return energy, forces
