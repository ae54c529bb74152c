"""Figures of sweeps show what they are given, and leave out what is not there."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from identknee.report.picture import png
from identknee.report.sweep_figures import (
    cliff_figure,
    descent_figure,
    methods_figure,
    plane_figure,
    recovery_figure,
    start_end_figure,
    waterfall_figure,
)

NAMES = ("A.stiffness_kN", "B.stiffness_kN", "A.reference_strain_pct", "B.reference_strain_pct")
TRUTH = np.array([10.0, 20.0, 1.0, -2.0])


def drawn(figure: Figure) -> list[str]:
    """Labels of the legend of a figure that can be drawn."""
    assert png(figure).startswith(b"\x89PNG")
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_every_waterfall_is_within_the_shared_axis() -> None:
    number = np.array([1.0, 2.0])
    figure = waterfall_figure(
        {
            "low": {"end": (number, np.array([1e-12, 1e-11]))},
            "high": {"end": (number, np.array([1.0, 100.0]))},
        }
    )
    for axes in figure.axes:
        low, high = axes.get_ylim()
        assert low < 1e-12
        assert high > 100.0


def test_waterfall_leaves_failed_starts_out() -> None:
    fall = np.array([0.0, 1e-3, np.inf])
    figure = waterfall_figure({"sweep": {"end": (np.arange(1.0, 4.0), fall)}})
    drawn(figure)
    (line,) = figure.axes[0].lines
    assert np.asarray(line.get_ydata()).tolist() == [1e-12, 1e-3]


def test_recovery_marks_the_guesses() -> None:
    rows = [[9, 10, 0.55, 1.0], [2, 10, 0.03, 0.56]]
    figure = recovery_figure({"knee": {"Complex": ([0.5, 3.0], rows)}}, {"IG4": 3.6})
    assert drawn(figure) == ["Complex"]
    assert [x.get_text() for x in figure.axes[0].texts] == ["IG4"]


def test_starts_are_marked_by_what_is_at_their_end() -> None:
    starts = TRUTH + np.array([[1.0] * 4, [-1.0] * 4, [2.0] * 4])
    panels = {"Complex": (starts, np.tile(TRUTH, (3, 1)), ["valley", "minimum", "start_failed"])}
    labels = drawn(start_end_figure(panels, NAMES, TRUTH))
    assert labels == ["minimum", "optimizer stopped", "no prediction at the start", "end", "truth"]


def test_cliffs_are_counted_among_all_ways() -> None:
    figure = cliff_figure(
        {"knee": (np.array([1.0, 2.0]), 4)}, {"knee": {"flexion60_internal-10Nm": 2}}
    )
    drawn(figure)
    assert np.asarray(figure.axes[0].lines[0].get_ydata()).tolist() == [0.0, 0.25, 0.5]
    assert figure.axes[1].get_yticklabels()[0].get_text() == "60 deg, internal-10Nm"


def test_cliffs_of_a_knee_without_any_are_an_empty_panel() -> None:
    drawn(cliff_figure({"knee": (np.array([]), 4)}, {"knee": {}}))


def test_planes_show_where_there_is_no_prediction() -> None:
    values = np.array([[0.0, 10.0, 20.0], [-5.0, 0.0, 5.0]])
    objectives = np.array([[np.inf, 1.0, 2.0], [1.0, 1e-9, 1.0], [2.0, 1.0, 2.0]])
    truth: Mapping[str, tuple[float, float]] = {"A": (10.0, 0.0)}
    labels = drawn(plane_figure({"knee": {"A": (values, objectives)}}, truth))
    assert labels == ["a trial has no equilibrium", "truth"]


def test_descents_may_begin_without_a_prediction() -> None:
    best = np.array([[np.inf, 3.0, 1.0], [np.inf, np.inf, 2.0], [5.0, 4.0, 0.0]])
    figure = descent_figure({"knee": {"complex": best, "cma-es": best}}, (1, 10, 100))
    assert drawn(figure) == ["complex", "cma-es"]


def test_methods_stand_side_by_side() -> None:
    errors = {x: {"IG1": np.array([[0.1, 0.2]])} for x in ("complex", "genetic")}
    figure = methods_figure(errors, {"IG1": (0.15, 0.08)})
    assert drawn(figure) == ["complex", "genetic", "the paper"]
