"""The distance spline converges as cubic splines do."""

import numpy as np
import pytest
from energy_evaluation import field_values
from tolerances import ORDER

from identknee.mechanics.distance_field import DistanceField, build_field
from identknee.runs.declare import Array

RADIUS = 8.0
SPACINGS = (0.8, 0.5, 0.3)


def _sphere(points: Array) -> Array:
    return np.asarray(np.linalg.norm(points, axis=1)) - RADIUS


@pytest.fixture(scope="module")
def fields() -> list[DistanceField]:
    lower, upper = np.full(3, -RADIUS), np.full(3, RADIUS)
    return [build_field(_sphere, lower, upper, spacing=x) for x in SPACINGS]


def _shell() -> Array:
    """Places where contact is: from 2 mm inside to the surface."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(4000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return direction * rng.uniform(RADIUS - 2.0, RADIUS, (4000, 1))


def _orders(errors: list[Array]) -> Array:
    sizes = [np.sqrt((x**2).mean()) for x in errors]
    return np.diff(np.log(sizes)) / np.diff(np.log(SPACINGS))


def test_values_to_fourth_order(fields: list[DistanceField]) -> None:
    points = _shell()
    errors = [field_values(x, points) - _sphere(points) for x in fields]
    assert _orders(errors) == pytest.approx(np.full(2, 4.0), abs=ORDER)


def test_gradients_to_third_order(fields: list[DistanceField]) -> None:
    """Their length, which is 1 on a distance, with them."""
    points, step = _shell(), 1e-4
    exact = points / np.linalg.norm(points, axis=1)[:, None]
    errors, lengths = [], []
    for field in fields:
        slopes = np.transpose(
            [
                (field_values(field, points + x) - field_values(field, points - x)) / (2 * step)
                for x in step * np.eye(3)
            ]
        )
        errors.append(slopes - exact)
        lengths.append(np.linalg.norm(slopes, axis=1) - 1.0)
    assert _orders(errors) == pytest.approx(np.full(2, 3.0), abs=ORDER)
    assert _orders(lengths)[-1] >= 3.0 - ORDER
    assert np.abs(lengths[-1]).max() < 1e-4
