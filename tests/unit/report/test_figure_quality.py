"""Every figure of the page: nothing empty, clipped, overlapping, too small or too pale."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from figure_checks import (
    clipped,
    empty_axes,
    overlapping,
    smallest_text,
    text_contrasts,
)
from matplotlib.figure import Figure

from identknee.report.page.drawing import Drawing
from identknee.report.page.page import report_drawings
from identknee.report.page.results import found_results
from identknee.report.page.svg import inline_svg

RESULTS = Path(__file__).parents[2] / "fuzz" / "results"
# WCAG 2.2, success criterion 1.4.3.
LEAST_CONTRAST = 4.5
LEAST_LETTERS = 7.0  # px, in a figure, on any of these pages
WIDTHS = (390, 760, 1400)


@cache
def drawings() -> dict[str, Drawing]:
    """All figures of one result of each verb."""
    return dict(report_drawings(found_results(RESULTS)))


@pytest.mark.parametrize("name", sorted(drawings()))
def test_a_figure_can_be_read(name: str) -> None:
    figure = drawings()[name].figure
    assert empty_axes(figure) == []
    assert clipped(figure) == []
    assert overlapping(figure) == []


@pytest.mark.parametrize("name", sorted(drawings()))
@pytest.mark.parametrize("width", WIDTHS)
def test_letters_are_large_enough_on_every_page(name: str, width: int) -> None:
    x = drawings()[name]
    assert smallest_text(inline_svg(x.figure, name, x.description), width) >= LEAST_LETTERS


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_of_figures_stands_out(scheme: str) -> None:
    pale = {
        (name, word): value
        for name, x in drawings().items()
        for word, value in text_contrasts(inline_svg(x.figure, name, x.description), scheme).items()
        if value < LEAST_CONTRAST
    }
    assert pale == {}


def test_faults_of_figures_are_found() -> None:
    figure = Figure(figsize=(5.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot([0.0], [0.0], "o")
    left.text(0.5, 0.5, "one upon", transform=left.transAxes)
    left.text(0.5, 0.52, "the other", transform=left.transAxes)
    figure.text(0.95, 0.02, "reaches beyond the edge")
    right.plot([np.nan], [np.nan])
    right.set_title("nothing here")
    assert empty_axes(figure) == ["nothing here"]
    assert clipped(figure) == ["reaches beyond the edge"]
    assert ("one upon", "the other") in overlapping(figure)
    pale = '<text style="fill: #999999">a</text><text style="fill: currentColor">b</text>'
    assert text_contrasts(pale, "light")["a"] < LEAST_CONTRAST < text_contrasts(pale, "dark")["b"]
