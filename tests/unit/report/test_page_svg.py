"""Figures inside the page: their colours follow it, and their parts have names of their own."""

import re

import numpy as np
from matplotlib.figure import Figure

from identknee.report.figures import COLOURS
from identknee.report.page.svg import inline_svg


def drawn() -> Figure:
    figure = Figure(figsize=(3.0, 2.0))
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color=COLOURS[0])
    axes.plot([0, 1], [1, 0], color="0.85")
    axes.set_title("a title")
    return figure


def test_black_follows_the_text_and_series_their_colours() -> None:
    svg = inline_svg(drawn(), "one", "A line that rises & one that falls.")
    assert "currentColor" in svg
    assert "var(--series-0)" in svg
    assert "color-mix(in srgb, currentColor 15%, transparent)" in svg
    assert not re.search(r"(fill|stroke): #(000000|ffffff|0072b2)", svg)


def test_text_stays_text_in_the_font_of_the_page() -> None:
    svg = inline_svg(drawn(), "one", "A line.")
    assert re.search(r"<text[^>]*>a title</text>", svg)
    assert "DejaVu" not in svg


def test_what_it_shows_is_its_title() -> None:
    svg = inline_svg(drawn(), "one", "Rises & <falls>.")
    assert svg.startswith('<svg class="drawing" role="img" aria-labelledby="one-title"')
    assert '<title id="one-title">Rises &amp; &lt;falls&gt;.</title>' in svg


def test_two_figures_share_no_identity() -> None:
    one, other = (
        set(re.findall(r'\bid="([^"]+)"', inline_svg(drawn(), name, "A line.")))
        for name in ("one", "other")
    )
    assert one.isdisjoint(other)


def test_nothing_is_written_of_the_day() -> None:
    assert inline_svg(drawn(), "one", "A line.") == inline_svg(drawn(), "one", "A line.")
    assert "metadata" not in inline_svg(drawn(), "one", "A line.")


def test_words_on_a_map_stay_black() -> None:
    figure = Figure(figsize=(3.0, 2.0))
    axes = figure.add_subplot()
    axes.imshow(np.zeros((2, 2)))
    axes.text(0.5, 0.5, "inside")
    axes.text(0.5, -2.0, "above")
    svg = inline_svg(figure, "map", "A map.")
    colours = dict(re.findall(r'<text style="([^"]*)"[^>]*>(inside|above)</text>', svg)[::-1])
    by_word = {word: style for style, word in colours.items()}
    assert "#010101" in by_word["inside"]
    assert "#010101" not in by_word["above"]


def test_very_many_points_become_a_picture() -> None:
    figure = Figure(figsize=(3.0, 2.0))
    figure.add_subplot().plot(np.arange(1000.0), np.zeros(1000), ".")
    svg = inline_svg(figure, "many", "Many points.")
    assert 'href="data:image/png;base64,' in svg.replace("\n", "")
    assert len(svg) < 40_000
