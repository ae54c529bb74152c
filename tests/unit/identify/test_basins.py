"""Basins are minima in parameter space, with their share of the starts."""

import numpy as np
import pytest
from landscapes import Quadrant, Trench, TwoWells
from problems import disc_in_the_way

from identknee.identify.sweep.basins import NONE, find_basins, has_barrier
from identknee.identify.sweep.starts_design import sobol_starts
from identknee.identify.sweep.sweep import sweep


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
    assert str(found) == "no basin was found"


def test_a_barrier_is_a_rise_or_a_loss() -> None:
    wells = TwoWells()
    assert has_barrier(wells, np.array([2.0, 0.0]), np.array([-2.0, 0.0]))
    assert not has_barrier(wells, np.array([2.0, 0.0]), np.array([3.0, 0.0]))
    disc = disc_in_the_way()
    assert has_barrier(disc, disc.problem.start, disc.problem.minimum)
