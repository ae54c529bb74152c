"""Figures of advice on trials."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from identknee.laxity.protocol import candidate_trials, load_protocol
from identknee.report.design_figures import candidates_figure, intervals_figure, steps_figure
from identknee.report.presenter import presenter_of
from identknee.verbs.design import Design
from identknee.verbs.files import load


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


def test_steps_are_drawn_of_intervals_that_were_closed_before() -> None:
    answer = load(Path(__file__).parents[2] / "fuzz" / "results" / "design")
    assert isinstance(answer, Design)
    presenter = presenter_of(answer)
    names = [x.name for x in presenter.drawings(answer, "knee", None)]
    assert "design-steps" in names
    predicted = np.array(answer.choice.predicted)
    predicted[:, :, 1] = np.nan
    open_above = replace(answer, choice=replace(answer.choice, predicted=predicted))
    drawn = [x.name for x in presenter.drawings(open_above, "knee", None)]
    assert drawn == [x for x in names if x != "design-steps"]
