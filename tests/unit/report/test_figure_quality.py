"""Every figure of the page and of commands can be read: nothing of `figure_checks` is wrong."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from figure_checks import (
    RESULTS,
    clipped,
    code_names,
    drawn,
    empty_axes,
    faults,
    faults_of,
    overlapping,
    smallest_text,
    stored_figures,
    text_contrasts,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from slow_cases import some_slow

import identknee as ik
from identknee.laxity.table import example_laxity
from identknee.report.figures import COLOURS, FIT, MEASURED
from identknee.report.page.svg import inline_svg

VERBS = sorted(x.name for x in RESULTS.iterdir() if x.name != "check")
# WCAG 2.2, success criterion 1.4.3.
LEAST_CONTRAST = 4.5
LEAST_LETTERS = 7.0  # px, in a figure, on any of these pages
WIDTHS = (390, 760, 1400)
FEW_WAYS = ("Ant", "Pos", "Int", "Ext")


@cache
def pictures(verb: str) -> dict[str, str]:
    """All figures of one result of a verb as they stand in a page."""
    made = stored_figures(verb).drawings
    for x in made.values():
        # Sizes and colours of letters are the same wherever they stand.
        x.figure.set_layout_engine("none")
    return {k: inline_svg(x.figure, k, x.description) for k, x in made.items()}


@pytest.mark.parametrize("verb", some_slow(VERBS, ["demo", "diagnose"]))
def test_figures_can_be_read(verb: str) -> None:
    shown = stored_figures(verb)
    found = {name: faults(x, shown.names) for name, x in shown.figures.items()}
    assert found
    assert {name: x for name, x in found.items() if x} == {}


@pytest.mark.slow
def test_figures_of_the_measured_knee_can_be_read(tmp_path: Path) -> None:
    knee = ik.example("s192803")
    # Both directions of two loads at all angles; the fit is short, and loses trials.
    table = example_laxity("s192803")
    whole = table.select([k for k, x in enumerate(table.protocol.trials) if x[:3] in FEW_WAYS])
    answer = ik.fit(knee, whole, noise="1mm,1.5deg", budget=1, more_starts=0, out=tmp_path / "fit")
    assert answer.data.protocol.n == 16
    found = faults_of(tmp_path / "fit")
    assert any("laxity" in x for x in found)
    assert {name: x for name, x in found.items() if x} == {}


@pytest.mark.parametrize("verb", some_slow(VERBS, ["demo", "diagnose"]))
def test_letters_are_large_enough_on_every_page(verb: str) -> None:
    for name, svg in pictures(verb).items():
        for width in WIDTHS:
            assert smallest_text(svg, width) >= LEAST_LETTERS, (name, width)


@pytest.mark.parametrize("verb", some_slow(VERBS, ["demo", "diagnose"]))
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


def _made(**words: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(5.0, 3.0), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [0.0, 1.0], color=FIT, label=words.pop("label", "fit"))
    axes.set(**words)
    return figure, axes


def test_a_sound_figure_has_no_fault() -> None:
    figure, axes = _made(xlabel="internal rotation [deg]", ylabel="force [N]")
    axes.plot([0.0, 1.0], [1.0, 0.0], color=MEASURED, label="measured ± 2 sd")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center")
    assert faults(figure) == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ({"xlabel": "tibia_frame"}, "named as in code: 'tibia_frame'"),
        ({"title": "change of -0.5 mm"}, "hyphen for a minus: 'change of -0.5 mm'"),
        ({"title": "a very long title " * 6}, f"too long: {'a very long title ' * 6!r}"),
    ],
)
def test_faults_of_words_are_found(words: dict[str, str], expected: str) -> None:
    figure, _ = _made(**words)
    assert expected in faults(figure)
    if "tibia_frame" in expected:
        # A user may call a trial so.
        assert faults(figure, ["tibia_frame"]) == []


def test_what_comes_twice_is_found() -> None:
    figure, axes = _made()
    axes.plot([0.0, 1.0], [1.0, 0.0], color=FIT, label="fit")
    axes.legend()
    axes.set_yticks([0.0, 0.5, 1.0], ["ACL", "MCL", "MCL"])
    assert faults(figure) == ["twice: the entry 'fit'", "twice: the label 'MCL'"]
    figure = Figure()
    for panel in figure.subplots(1, 2):
        panel.plot([0.0, 1.0], [0.0, 2.0])
        panel.set_title("drawer")
    assert faults(figure) == ["twice: a panel"]


def test_colours_that_mean_something_else_are_found() -> None:
    figure, axes = _made(label="measured")
    axes.plot([0.0, 1.0], [1.0, 0.0], color=COLOURS[2])
    axes.legend()
    assert faults(figure) == [
        f"in another colour: measured ({FIT.lower()})",
        f"in no legend: {COLOURS[2].lower()}",
    ]


def test_a_figure_without_a_panel_is_found() -> None:
    assert faults(Figure()) == ["empty: there is no panel"]
