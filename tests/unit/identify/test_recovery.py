"""How close a start must be: shares by shell, and the radius of a curve through them."""

import numpy as np
import pytest
from landscapes import Quadrant, TwoWells
from scipy.special import expit, logit

from identknee.identify.sweep import is_recovered, radius, recovery, sweep

SHELLS = np.linspace(0.0, 6.0, 13)


def drawn(true: float, slope: float, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    distances = np.resize(SHELLS, n)
    chance = expit(logit(0.9) - slope * (distances - true))
    return distances, np.random.default_rng(seed).uniform(size=n) < chance


def test_shells_are_counted_one_by_one() -> None:
    found = recovery(np.array([0.0, 1.0, 0.0, 1.0]), np.array([True, False, True, True]))
    assert found.distances.tolist() == [0.0, 1.0]
    assert [x.count for x in found.shares] == [2, 1]


def test_scattered_distances_are_counted_in_ten_groups() -> None:
    distances = np.random.default_rng(1).uniform(0.0, 10.0, 200)
    found = recovery(distances, distances < 5.0)
    assert [x.n for x in found.shares] == [20] * 10
    assert np.all(np.diff(found.distances) > 0)
    assert found.shares[0].value == 1.0
    assert found.shares[-1].value == 0.0


@pytest.mark.slow
def test_the_radius_of_a_curve_is_found_and_covered() -> None:
    covered, replicates = 0, 100
    for seed in range(replicates):
        found = radius(recovery(*drawn(2.25, 1.0, 1300, seed)))
        covered += found.lower <= 2.25 <= found.upper
        assert found.lower <= found.value <= found.upper
    # The limits of the shares are 95 % each: 95 less three standard errors.
    assert covered >= 88


def test_a_step_is_found_between_its_shells() -> None:
    distances = np.resize(SHELLS, 1300)
    found = radius(recovery(distances, distances < 2.75))
    assert 2.5 <= found.lower <= found.value <= found.upper <= 3.0


def test_all_recovered_leaves_the_radius_open_above() -> None:
    found = radius(recovery(np.resize(SHELLS, 1300), np.ones(1300, bool)))
    assert found.value == found.lower == found.upper == np.inf


def test_few_starts_leave_the_radius_open_below() -> None:
    found = radius(recovery(np.resize(SHELLS, 39), np.ones(39, bool)))
    assert found.value == np.inf
    assert found.lower == 0.0


def test_none_recovered_leaves_no_radius() -> None:
    found = radius(recovery(np.resize(SHELLS, 1300), np.zeros(1300, bool)))
    assert found.value == found.lower == found.upper == 0.0


def test_recovery_asks_for_a_prediction() -> None:
    problem = Quadrant()
    target = np.array([2.5, 0.0])
    found = sweep(problem, np.array([[2.5, 0.0], [1.0, 1.0]]))
    assert not is_recovered(found, target, within=0.5).any()
    assert is_recovered(found, np.zeros(2), within=0.5).tolist() == [False, True]


def test_polished_ends_recover_where_raw_ones_stopped() -> None:
    problem = TwoWells()
    found = sweep(problem, np.array([[3.0, 0.5], [-3.0, 0.5]]), method="complex", budget=21)
    target = np.array([2.0, 0.0])
    assert is_recovered(found, target, within=1e-4, polished=True).tolist() == [True, False]
    assert not is_recovered(found, target, within=1e-4).any()


def test_a_mistake_is_named() -> None:
    with pytest.raises(ValueError, match="0 and 1, got 1"):
        radius(recovery(SHELLS, SHELLS < 1.0), probability=1.0)
