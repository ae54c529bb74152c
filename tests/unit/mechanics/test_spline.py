"""The spline at one point against scipy."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from tolerances import DERIVATIVE

from identknee.mechanics.contact_elements import spline_at
from identknee.runs.declare import Array

SHAPE = (9, 8, 7)


def _found(coefficients: Array, place: Array) -> Array:
    cell = np.floor(place).astype(int)
    first = int((cell - 1) @ [56, 7, 1])
    return np.array(spline_at(coefficients.reshape(-1), first, 56, 7, *(place - cell)))


def _value(coefficients: Array, place: Array) -> float:
    found = map_coordinates(coefficients, place[:, None], order=3, prefilter=False, mode="mirror")
    return float(found[0])


@pytest.mark.parametrize("seed", range(5))
def test_value_gradient_and_hessian(seed: int) -> None:
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=SHAPE)
    place = 1.0 + rng.random(3) * (np.array(SHAPE) - 3.0)
    found = _found(coefficients, place)
    assert found[0] == pytest.approx(_value(coefficients, place), rel=DERIVATIVE, abs=1e-13)
    step = 1e-4
    cell = np.floor(place)
    place = cell + np.clip(place - cell, 2 * step, 1 - 2 * step)
    found = _found(coefficients, place)
    ahead = [_found(coefficients, place + step * x) for x in np.eye(3)]
    behind = [_found(coefficients, place - step * x) for x in np.eye(3)]
    slopes = (np.array(ahead) - behind) / (2 * step)
    # Second derivatives are linear or quadratic in the cell, so the differences are near exact.
    assert found[1:4] == pytest.approx(slopes[:, 0], abs=1e-7)
    xx, yy, zz, xy, xz, yz = found[4:]
    hessian = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    assert hessian == pytest.approx(slopes[:, 1:4], abs=1e-7)
