"""Advice on trials as dataset, summary and figures."""

import json

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from problems import Linear, plain_parameters
from trial_formulas import linear_trials

from identknee.identify.design.design import Design, design
from identknee.laxity.candidates import candidate_trials
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.report.design_figures import candidates_figure, intervals_figure, steps_figure
from identknee.report.design_groups import design_groups, design_summary
from identknee.report.groups import Groups
from identknee.runs.files import plain

NAMES = tuple(f"x{i}.value_pct" for i in range(3))


@pytest.fixture(scope="module")
def candidates() -> Protocol:
    return load_protocol("seed63").select(range(7))


@pytest.fixture(scope="module")
def found() -> Design:
    """The last parameter is open until trials are added; trial 3 has no prediction."""
    rng = np.random.default_rng(2)
    problem = Linear(
        parameters=plain_parameters(3), matrix=np.eye(3)[:2] * [[2.0], [3.0]], data=np.ones(2)
    )
    trials = linear_trials(rng.normal(size=(7, 2, 3)), beyond=lambda i, _: 1.0 if i == 3 else -1.0)
    return design(problem, np.array([0.5, 1 / 3, 0.0]), trials, n_trials=2)


@pytest.fixture(scope="module")
def groups(found: Design, candidates: Protocol) -> Groups:
    return design_groups(found, candidates, NAMES)


def test_the_dataset_has_every_candidate_step_and_target(found: Design, groups: Groups) -> None:
    data = groups["design"]
    assert data.sizes == {"candidate": 7, "step": 3, "target": 1, "end": 2, "added": 2}
    assert data["target"].to_numpy().tolist() == ["x2.value_pct"]
    assert np.isnan(data["before"].to_numpy()).all()
    assert np.isfinite(data["after"].to_numpy()).all()
    assert data["failures"].to_numpy()[3] > 0
    assert np.isnan(data["loss_alone"].to_numpy()[3])
    np.testing.assert_array_equal(data["predicted"], found.predicted)
    assert data["varus_moment_Nm"].to_numpy()[0] == -10.0


def test_the_curves_before_and_after_are_kept(groups: Groups) -> None:
    for name in ("profile_before", "profile_after"):
        assert isinstance(groups[name], xarray.Dataset)
        assert groups[name]["value"].sizes["quantity"] == 1


def test_the_summary_is_json_and_says_what_was_left_out(
    found: Design, candidates: Protocol
) -> None:
    summary = json.loads(json.dumps(plain(design_summary(found, candidates)), allow_nan=False))
    assert [x["trial"] for x in summary["trials"]] == list(found.trials)
    target = summary["targets"]["x2.value_pct"]
    assert target["before"]["lower"] is None
    assert target["after"]["upper"] == found.after[0].upper
    assert target["predicted"]["upper"] == pytest.approx(found.after[0].upper, rel=0.01)
    assert [x["trial"] for x in summary["excluded"]] == ["trial 3"]
    assert "no prediction at the best fit" in summary["excluded"][0]["reason"]


def _texts(figure: Figure) -> list[str]:
    axes = figure.axes[0]
    return [x.get_text() for x in (*axes.texts, *axes.get_yticklabels())]


def test_candidates_show_the_order_of_choice_and_those_left_out() -> None:
    protocol = candidate_trials(load_protocol("table2"), [0, 30])
    gains = np.linspace(0.0, 5.0, protocol.n)
    gains[-1] = np.nan
    figure = candidates_figure(protocol, gains, [2, 5, 2], "narrower [%]")
    texts = _texts(figure)
    assert "1 x2" in texts
    assert "2" in texts
    assert "unloaded" in texts
    assert "internal moment 5 N·m + valgus moment 10 N·m" in texts
    assert len(figure.axes[0].lines) == 2 + 1


def test_intervals_have_a_panel_for_each_target_and_arrows_for_open_ends() -> None:
    ends = {"before": [[1.0, np.nan], [0.0, 2.0]], "achieved": [[1.2, 1.9], [0.5, 1.5]]}
    figure = intervals_figure(["a [kN]", "b [%]"], [1.5, 1.0], ends)
    assert [x.get_title() for x in figure.axes] == ["a [kN]", "b [%]"]
    markers = [[line.get_marker() for line in axes.lines] for axes in figure.axes]
    assert markers[0].count(">") == 1
    assert markers[1].count(">") == 0


def test_steps_begin_at_what_was_and_end_at_what_was_achieved() -> None:
    widths = {f"p{k}": [1.0, 0.8, 0.7] for k in range(8)}
    figure = steps_figure(widths, dict.fromkeys(widths, 0.71))
    axes = figure.axes[0]
    legend = axes.get_legend()
    assert legend is not None
    assert len(legend.get_texts()) == 9
    styles = {(line.get_color(), line.get_linestyle()) for line in axes.lines[0:16:2]}
    assert len(styles) == 8
