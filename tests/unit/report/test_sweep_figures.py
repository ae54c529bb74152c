"""Figures of sweeps show what they are given, and leave out what is not there."""

import numpy as np
from matplotlib.figure import Figure

from identknee.report.figures import png
from identknee.report.sweep_figures import start_end_figure, waterfall_figure

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


def test_starts_are_marked_by_what_is_at_their_end() -> None:
    starts = TRUTH + np.array([[1.0] * 4, [-1.0] * 4, [2.0] * 4])
    panels = {"Complex": (starts, np.tile(TRUTH, (3, 1)), ["valley", "minimum", "start_failed"])}
    labels = drawn(start_end_figure(panels, NAMES, TRUTH))
    assert labels == ["minimum", "optimizer stopped", "no prediction at the start", "end", "truth"]
