"""Basins are minima in parameter space, with their share of the starts."""

from dataclasses import dataclass

import numpy as np
import pytest
from landscapes import BOX, Quadrant, Trench, TwoWells
from problems import disc_in_the_way

from identknee.identify.sweep import NONE, find_basins, has_barrier, sobol_starts, sweep
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array


def test_two_wells_are_two_basins_of_half_the_volume() -> None:
    problem = TwoWells()
    starts = sobol_starts(problem.parameters, 256, seed=1)
    found = find_basins(problem, sweep(problem, starts))
    low, high = found.basins
    assert low.theta == pytest.approx([2.0, 0.0], abs=1e-6)
    # Where x (x^2 - 4) 2 + 0.01 (x - 2) = 0.
    assert high.theta == pytest.approx([-1.997496, 0.0], abs=1e-5)
    assert low.objective < 1e-12 < high.objective
    assert low.share.count + high.share.count == 256
    for basin in found.basins:
        assert basin.share.lower < 0.5 < basin.share.upper
    # But for starts beside the hill, from where a step may go over it.
    assert np.mean(found.labels == (starts[:, 0] < 0.0)) > 0.97
    assert str(found).startswith("basin 0: objective ")


def test_a_line_of_minima_is_one_basin() -> None:
    problem = Trench()
    swept = sweep(problem, sobol_starts(problem.parameters, 40, seed=2))
    assert np.ptp(swept.polished[:, 1]) > 5.0
    found = find_basins(problem, swept)
    assert len(found.basins) == 1
    assert not found.labels.any()


def test_failed_starts_are_in_no_basin_but_in_the_volume() -> None:
    problem = Quadrant()
    starts = np.array([[1.0, 1.0], [5.0, 1.0], [-3.0, 2.0], [3.0, 0.0]])
    found = find_basins(problem, sweep(problem, starts))
    assert found.labels.tolist() == [0, NONE, 0, NONE]
    assert (found.basins[0].share.count, found.basins[0].share.n) == (2, 4)


def test_nothing_found_is_no_basin() -> None:
    problem = Quadrant()
    found = find_basins(problem, sweep(problem, np.array([[5.0, 1.0]])))
    assert found.basins == ()


def test_a_barrier_is_a_rise_or_a_loss() -> None:
    wells = TwoWells()
    assert has_barrier(wells, np.array([2.0, 0.0]), np.array([-2.0, 0.0]))
    assert not has_barrier(wells, np.array([2.0, 0.0]), np.array([3.0, 0.0]))
    disc = disc_in_the_way()
    assert has_barrier(disc, disc.problem.start, disc.problem.minimum)


@dataclass(frozen=True, kw_only=True)
class Ripples:
    """Minima every `apart` along the first parameter, a hill between any two of them."""

    apart: float
    parameters: Parameters = BOX

    def residuals(self, theta: Array) -> Array:
        return np.array([np.sin(np.pi * theta[0] / self.apart), theta[1]])

    def jacobian(self, theta: Array) -> Array:
        slope = np.pi / self.apart * np.cos(np.pi * theta[0] / self.apart)
        return np.array([[slope, 0.0], [0.0, 1.0]])


@pytest.mark.parametrize(("apart", "n"), [(0.016, 1), (0.024, 2)])
def test_ends_closer_than_a_fiftieth_of_a_percent_are_one_minimum(apart: float, n: int) -> None:
    """A hundredth of the typical step, which is 2 % for a reference strain, on either side."""
    problem = Ripples(apart=apart)
    starts = np.array([[0.0, 1.0], [apart, -1.0], [0.0, 0.5]])
    swept = sweep(problem, starts)
    wanted = np.array([[0.0, 0.0], [apart, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(swept.polished, wanted, atol=1e-6)
    assert has_barrier(problem, swept.polished[0], swept.polished[1])
    found = find_basins(problem, swept)
    assert len(found.basins) == n
    assert found.labels.tolist() == ([0, 0, 0] if n == 1 else [0, 1, 0])


def test_a_rise_of_a_thousandth_is_a_barrier_and_rounding_is_none() -> None:
    """Rounding is a millionth of the objective, or 1e-9 where that is nothing."""

    def rise(height: float, floor: float) -> bool:
        bump = Bump(height=height, floor=floor)
        return has_barrier(bump, np.array([-1.0, 0.0]), np.array([1.0, 0.0]))

    assert rise(1e-3, 1.0)
    assert rise(1e-5, 1.0)
    assert not rise(1e-8, 1.0)
    assert rise(1e-6, 0.0)
    assert not rise(1e-11, 0.0)


@dataclass(frozen=True, kw_only=True)
class Bump:
    """Half the sum of squares is `floor`, and `height` more at zero."""

    height: float
    floor: float
    parameters: Parameters = BOX

    def residuals(self, theta: Array) -> Array:
        rise = self.height * max(0.0, 1.0 - abs(theta[0]))
        return np.sqrt([2.0 * (self.floor + rise), 0.0])

    def jacobian(self, theta: Array) -> Array:
        raise AssertionError
