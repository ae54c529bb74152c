"""A survey reads basins, unseen mass and recovery from one sweep."""

import numpy as np
import pytest
from landscapes import Quadrant, TwoWells

from identknee.identify.sweep import shell_starts, survey, sweep

TARGET = np.array([2.0, 0.0])


@pytest.mark.slow
def test_recovery_falls_where_the_other_basin_begins() -> None:
    problem = TwoWells()
    shells = [0.5, 1.0, 1.5, 2.0, 3.0]
    starts = shell_starts(problem.parameters, 250, center=TARGET, distances=shells, seed=1)
    found = survey(problem, sweep(problem, starts), within=0.01)
    assert found.target == pytest.approx(TARGET, abs=1e-6)
    shares = found.recoveries["end"].shares
    # Within a mean distance of 1 no start can be left of 0; farther out some are.
    assert [x.value for x in shares[:2]] == [1.0, 1.0]
    assert shares[-1].value < 0.9
    assert 0.5 < found.recoveries["end"].radius.value < 2.5
    assert len(found.basins.basins) == 2
    assert found.unseen.n_once == 0


def test_the_truth_may_be_stated() -> None:
    problem = TwoWells()
    found = survey(problem, sweep(problem, [[-3.0, 0.0]]), target=TARGET, within=0.01)
    assert found.recoveries["polished"].shares[0].count == 0


def test_without_a_prediction_there_is_no_target() -> None:
    found = survey(Quadrant(), sweep(Quadrant(), [[5.0, 0.0]]))
    assert found.target is None
    assert not found.recoveries
    assert found.unseen.n == 0
