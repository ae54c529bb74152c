"""Every figure of the page: nothing empty, clipped, overlapping, too small or too pale."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from figure_checks import (
    clipped,
    code_names,
    drawn,
    empty_axes,
    overlapping,
    smallest_text,
    text_contrasts,
)
from matplotlib.figure import Figure
from slow_cases import some_slow

from identknee.report.page.page import report_drawings
from identknee.report.page.results import found_results
from identknee.report.page.svg import inline_svg
from identknee.report.presenter import Drawing

RESULTS = Path(__file__).parents[2] / "fuzz" / "results"
VERBS = sorted(x.name for x in RESULTS.iterdir() if x.name != "check")
# WCAG 2.2, success criterion 1.4.3.
LEAST_CONTRAST = 4.5
LEAST_LETTERS = 7.0  # px, in a figure, on any of these pages
WIDTHS = (390, 760, 1400)


@cache
def drawings(verb: str) -> dict[str, Drawing]:
    """All figures of one result of a verb, drawn once for all tests."""
    return dict(report_drawings(found_results(RESULTS / verb)))


@cache
def pictures(verb: str) -> dict[str, str]:
    """The same as they stand in a page."""
    return {k: inline_svg(x.figure, k, x.description) for k, x in drawings(verb).items()}


@pytest.mark.parametrize("verb", VERBS)
def test_figures_can_be_read(verb: str) -> None:
    for name, drawing in drawings(verb).items():
        figure = drawing.figure
        renderer = drawn(figure)
        assert empty_axes(figure, renderer) == [], name
        assert clipped(figure, renderer) == [], name
        assert overlapping(figure, renderer) == [], name
        assert code_names(figure) == [], name


@pytest.mark.parametrize("verb", some_slow(VERBS, ["demo", "diagnose"]))
def test_letters_are_large_enough_on_every_page(verb: str) -> None:
    for name, svg in pictures(verb).items():
        for width in WIDTHS:
            assert smallest_text(svg, width) >= LEAST_LETTERS, (name, width)


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_of_figures_stands_out(verb: str, scheme: str) -> None:
    pale = {
        (name, word): value
        for name, svg in pictures(verb).items()
        for word, value in text_contrasts(svg, scheme).items()
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
    right.set_xlabel("ACL.stiffness_kN")
    renderer = drawn(figure)
    assert empty_axes(figure, renderer) == ["nothing here"]
    assert code_names(figure) == ["ACL.stiffness_kN"]
    assert clipped(figure, renderer) == ["reaches beyond the edge"]
    assert ("one upon", "the other") in overlapping(figure, renderer)
    pale = '<text style="fill: #999999">a</text><text style="fill: currentColor">b</text>'
    assert text_contrasts(pale, "light")["a"] < LEAST_CONTRAST < text_contrasts(pale, "dark")["b"]
