"""A sweep's arrays and summary say the same, without what changes from run to run."""

import numpy as np
import pytest
from problems import linear, wall_before_the_minimum

from identknee.identify.sweep.cliffs import map_cliffs
from identknee.identify.sweep.starts_design import sobol_starts
from identknee.identify.sweep.survey import survey
from identknee.identify.sweep.sweep import sweep
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.report.sweep_groups import sweep_groups, sweep_summary, tenths, trials_lost
from identknee.subject.knee import Knee

PROBLEM = linear(2)
SWEPT = sweep(PROBLEM, sobol_starts(PROBLEM.parameters, 24, seed=1), seed=3)


def test_groups_hold_every_start() -> None:
    read = survey(PROBLEM, SWEPT)
    cliffs = map_cliffs(PROBLEM, SWEPT.starts[:5], PROBLEM.minimum)
    groups = sweep_groups(read, cliffs)
    assert set(groups) == {"optimization", "basins", "recovery", "cliffs", "timing"}
    ends = groups["optimization"]
    assert np.array_equal(ends["theta_polished"], SWEPT.polished)
    assert ends["kind"].attrs["flag_meanings"].split()[0] == "minimum"
    assert not ends["kind"].any()
    assert not ends["basin"].any()
    assert ends.attrs["seed"] == 3
    basins = groups["basins"]
    assert basins["n_starts"].item() == 24
    assert basins["share_upper"].item() == 1.0
    assert basins["theta"][0].to_numpy() == pytest.approx(PROBLEM.minimum, abs=1e-6)
    assert groups["recovery"]["share"].sel(end="polished").min() == 1.0
    assert groups["cliffs"]["edge_distance"].isnull().all()
    assert "seconds" not in ends


def test_the_summary_counts_what_the_groups_hold() -> None:
    summary = sweep_summary(survey(PROBLEM, SWEPT), None)
    assert summary["kinds"] == {"minimum": 24}
    assert summary["n_basins"] == 1
    assert summary["basins"][0]["parameters"]["x0.value_pct"] == pytest.approx(PROBLEM.minimum[0])
    assert summary["recovery"]["end"]["radius"] == np.inf
    assert summary["recovery"]["end"]["probability"] == 0.9
    assert summary["cliffs"] is None
    assert summary["n_simulations"] == SWEPT.n_simulations.sum()
    assert len(summary["seconds_per_start"]["deciles"]) == 11
    assert len(summary["seconds_per_start"]["by_tenth_of_starts"]) == 10


def test_cliffs_are_summed_up() -> None:
    wall = wall_before_the_minimum()
    start = wall.problem.start
    found = map_cliffs(wall, np.array([wall.problem.minimum]), start)
    swept = sweep(wall, start[None])
    summary = sweep_summary(survey(wall, swept), found)["cliffs"]
    assert summary["n_ways_with_cliff"] == 1
    assert summary["nearest_distance"] == summary["median_distance"]
    # The wall stands half-way.
    half = np.abs(wall.problem.minimum - start).mean() / 2
    assert summary["nearest_distance"] == pytest.approx(half, rel=1e-3)


def test_a_sweep_that_found_nothing_has_no_recovery() -> None:
    wall = wall_before_the_minimum()
    read = survey(wall, sweep(wall, wall.problem.minimum[None]))
    assert set(sweep_groups(read, None)) == {"optimization", "basins", "timing"}
    assert sweep_summary(read, None)["recovery"] == {}
    assert sweep_summary(read, None)["unseen_mass"]["upper"] == 1.0


def test_few_values_make_fewer_tenths() -> None:
    assert [x.tolist() for x in tenths(np.arange(3.0))] == [[0.0], [1.0], [2.0]]


def test_lost_trials_are_named(reference: Knee) -> None:
    model = LaxityModel(knee=reference, protocol=load_protocol("seed63").select([0, 5]))
    assert trials_lost(model, model.parameters.center) == []
    m = model.parameters.n // 2
    slack = np.r_[model.parameters.center[:m], np.full(m, -15.0)]
    assert trials_lost(model, slack)[0] in model.protocol.trials
