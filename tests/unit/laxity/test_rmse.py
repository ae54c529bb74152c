from dataclasses import replace

import numpy as np
import pytest

from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, laxity_rmse


def drawer(coordinates: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> Laxity:
    return Laxity(protocol=load_protocol("drawer"), coordinates=coordinates)


def test_translations_and_rotations_are_pooled_over_measured_cells() -> None:
    measured = np.zeros((9, 5))
    measured[1:, 0] = np.nan
    measured[:, 4] = np.nan
    simulated = np.tile([3.0, 1, 2, 0.5, 99], (9, 1))
    error = laxity_rmse(drawer(simulated), drawer(measured))
    assert error.mm == np.sqrt((9 + 9 * 1 + 9 * 4) / 19)
    assert error.deg == 0.5
    np.testing.assert_array_equal(error.by_coordinate, [3, 1, 2, 0.5, np.nan])
    assert error.flexion_deg.tolist() == [0, 30, 60]
    np.testing.assert_array_equal(error.by_flexion[0], [3, 1, 2, 0.5, np.nan])
    np.testing.assert_array_equal(error.by_flexion[1], [np.nan, 1, 2, 0.5, np.nan])
    assert (error.n_compared, error.n_missing) == (1 + 9 * 3, 0)


def test_a_missing_simulation_is_counted() -> None:
    simulated = np.zeros((9, 5))
    simulated[2] = np.nan
    error = laxity_rmse(drawer(simulated), drawer(np.ones((9, 5))))
    assert (error.mm, error.n_missing, error.n_compared) == (1, 5, 40)
    nothing = laxity_rmse(drawer(np.full((9, 5), np.nan)), drawer(np.ones((9, 5))))
    assert np.isnan(nothing.mm)
    assert nothing.n_missing == 45


def test_simulation_is_made_relative_where_the_measurement_is() -> None:
    absolute = drawer(np.arange(45.0).reshape(9, 5))
    rows = absolute.protocol.flexion_deg[:, None] / 30 * 15 + np.arange(5) + 5
    relative = replace(drawer(absolute.coordinates - rows), zero="unloaded")
    assert laxity_rmse(absolute, relative).mm == 0
    with pytest.raises(ValueError, match=r"the measured one absolute\. Give the simulated one"):
        laxity_rmse(relative, absolute)


def test_other_trials_are_a_mistake() -> None:
    whole = drawer(np.zeros((9, 5)))
    with pytest.raises(ValueError, match=r"different trials\. Simulate the protocol"):
        laxity_rmse(whole, whole.select([0, 1]))
