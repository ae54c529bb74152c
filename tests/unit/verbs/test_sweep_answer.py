"""The answer of a sweep: what it holds, and that files give it back."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from problems import linear, wall_before_the_minimum
from report_folders import write_given

from identknee.identify.cliffs import map_cliffs
from identknee.identify.sweep import sobol_starts, survey, sweep
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.report.printer import terminal_lines
from identknee.runs.findings import finding
from identknee.runs.schema import summary_of, to_plain
from identknee.subject.knee import Knee
from identknee.verbs.files import groups_of, load
from identknee.verbs.sweep import Sweep, trials_lost

PROBLEM = linear(2)
SEARCHES = sweep(PROBLEM, sobol_starts(PROBLEM.parameters, 24, seed=1), seed=3)
LOST = finding("no-prediction", "trials", sentence="no prediction")


def straight() -> Sweep:
    """Searches of a problem with one minimum."""
    cliffs = map_cliffs(PROBLEM, SEARCHES.starts[:5], PROBLEM.minimum)
    return Sweep(design="sobol", survey=survey(PROBLEM, SEARCHES), cliffs=cliffs)


def walled() -> Sweep:
    """One search, and a wall half-way from the only minimum to the target."""
    wall = wall_before_the_minimum()
    start = wall.problem.start
    cliffs = map_cliffs(wall, np.array([wall.problem.minimum]), start, lost_at=lambda _: ["a", "b"])
    return Sweep(design="sobol", survey=survey(wall, sweep(wall, start[None])), cliffs=cliffs)


def lost() -> Sweep:
    """Searches that all began without a prediction."""
    wall = wall_before_the_minimum()
    found = survey(wall, sweep(wall, wall.problem.minimum[None]))
    return Sweep(design="sobol", survey=found, cliffs=None, findings=(LOST,))


@pytest.mark.parametrize("answer", [straight(), walled(), lost()], ids=["one", "wall", "none"])
def test_files_give_the_answer_back(answer: Sweep, tmp_path: Path) -> None:
    write_given(tmp_path, "sweep", answer)
    again = load(tmp_path)
    assert isinstance(again, Sweep)
    one, other = (to_plain(x) | {"record": None} for x in (answer, again))
    assert json.dumps(one) == json.dumps(other)
    assert terminal_lines(again) == terminal_lines(answer)
    assert again.failure == answer.failure


def test_groups_hold_every_start() -> None:
    groups = groups_of(straight())
    assert set(groups) == {
        *("optimization", "parameters", "basins", "recovery", "cliffs", "timing", "result"),
    }
    ends = groups["optimization"]
    assert np.array_equal(ends["theta_polished"], SEARCHES.polished)
    assert ends["kind"].attrs["flag_meanings"].split()[0] == "minimum"
    assert not ends["kind"].any()
    assert not ends["basin"].any()
    basins = groups["basins"]
    assert basins["share_count"].item() == 24
    assert basins["theta"][0].to_numpy() == pytest.approx(PROBLEM.minimum, abs=1e-6)
    assert groups["recovery"]["shares_lower"].sel(end="polished").min() > 0.0
    assert groups["cliffs"]["edge_distance"].isnull().all()
    assert "seconds" not in ends


def test_the_summary_counts_what_the_groups_hold() -> None:
    summary = summary_of(straight())
    assert summary["kinds"] == {"minimum": 24}
    assert summary["n_basins"] == 1
    assert summary["basins"][0]["parameters"]["x0.value_pct"] == pytest.approx(PROBLEM.minimum[0])
    assert summary["recovery"]["end"]["radius"]["value"] == np.inf
    assert summary["recovery"]["end"]["radius"]["probability"] == 0.9
    assert summary["cliffs"]["n_paths_with_cliff"] == 0
    assert summary["n_simulations"] == SEARCHES.n_simulations.sum()
    assert len(summary["seconds_per_start"]["deciles"]) == 11
    assert len(summary["seconds_per_start"]["by_tenth_of_starts"]) == 10


def test_cliffs_are_summed_up() -> None:
    summary = summary_of(walled())["cliffs"]
    assert summary["n_paths_with_cliff"] == 1
    assert summary["nearest_distance"] == summary["median_distance"]
    assert summary["trials_lost"] == {"a": 1, "b": 1}
    # The wall stands half-way.
    wall = wall_before_the_minimum()
    half = np.abs(wall.problem.minimum - wall.problem.start).mean() / 2
    assert summary["nearest_distance"] == pytest.approx(half, rel=1e-3)


def test_searches_that_found_nothing_have_no_recovery() -> None:
    answer = lost()
    assert "recovery" not in groups_of(answer)
    assert summary_of(answer)["recovery"] == {}
    assert summary_of(answer)["unseen_mass"]["upper"] == 1.0
    assert answer.failure == "no prediction"
    assert re.match(r"Of 1 .* 1 began ", terminal_lines(answer)[0])


def test_lost_trials_are_named(reference: Knee) -> None:
    model = LaxityModel(knee=reference, protocol=load_protocol("seed63").select([0, 5]))
    assert trials_lost(model, model.parameters.center) == []
    m = model.parameters.n // 2
    slack = np.r_[model.parameters.center[:m], np.full(m, -15.0)]
    assert trials_lost(model, slack)[0] in model.protocol.trials
