"""Figures as SVG inside a page: text stays text, colours follow the page's light or dark."""

import io
import re
from html import escape

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

from identknee.report.figures import COLOURS
from identknee.report.picture import names_as_they_are

# Above something drawn in fixed colours black must stay black; this is not taken for it.
FIXED_BLACK = "#010101"
MANY_POINTS = 300
# Room beside a figure for text that a reader's font sets wider [pt].
MARGIN = 9.0
# A figure gets no smaller than its smallest letters allow [pt]; it scrolls instead.
LEAST_LETTERS = 5.6
RASTER_DPI = 130
# Of the text's colour, at least: what is lighter is hard to read.
TEXT_SHARE = 0.72
PAGE_COLOURS = {colour.lower(): f"var(--series-{k})" for k, colour in enumerate(COLOURS)}
PAPER = re.compile(r'(<g id="patch_\d+">\s*<path[^>]*?style="fill: )#ffffff')
IDENTITY = re.compile(r'\bid="([^"]+)"')
REFERENCE = re.compile(r'(url\(#|href="#)')
HEX = re.compile(r"(fill|stroke): (#[0-9a-f]{6})")
FONT = re.compile(r"(font-family: |font: [^;\"]*?px )[^;\"]*")


def inline_svg(figure: Figure, identity: str, description: str) -> str:
    """The figure as an element ``svg`` for a page, with `description` as its alternative text.

    Parameters
    ----------
    figure
        Any figure.
    identity
        A word that no other figure of the page has; it begins all identities within.
    description
        What the figure shows, for those who do not see it.
    """
    _fix_colours(figure)
    buffer = io.StringIO()
    with (
        names_as_they_are(figure),
        mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": identity}),
    ):
        figure.savefig(buffer, format="svg", dpi=RASTER_DPI, metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = PAPER.sub(r"\1none", text).replace("xlink:href", "href")
    text = IDENTITY.sub(rf'id="{identity}-\1"', text)
    text = REFERENCE.sub(rf"\1{identity}-", text)
    text = FONT.sub(r"\1var(--figure-font)", HEX.sub(_page_colour, text))
    return _titled(text, figure, identity, description)


def _titled(text: str, figure: Figure, identity: str, description: str) -> str:
    """With the page's class, its own width, and the description where readers look for it."""
    width, height = 72.0 * np.asarray(figure.get_size_inches()) + (2.0 * MARGIN, 0.0)
    letters = [float(x.get_fontsize()) for x in figure.findobj(Text) if x.get_text().strip()]
    least = width * min(1.0, LEAST_LETTERS / min(letters, default=width))
    head = (
        f'<svg class="drawing" role="img" aria-labelledby="{identity}-title" '
        f'viewBox="{-MARGIN:g} 0 {width:g} {height:g}" '
        f'style="--width: {width * 4 / 3:.0f}px; --least: {least * 4 / 3:.0f}px">'
        f'<title id="{identity}-title">{escape(description)}</title>'
    )
    return re.sub(r"<svg[^>]*>", lambda _: head, text, count=1)


def _page_colour(match: re.Match[str]) -> str:
    attribute, colour = match[1], match[2]
    if colour in PAGE_COLOURS:
        return f"{attribute}: {PAGE_COLOURS[colour]}"
    red, green, blue = to_rgb(colour)
    if not (red == green == blue) or colour in (FIXED_BLACK, "#ffffff"):
        return match[0]
    if red == 0.0:
        return f"{attribute}: currentColor"
    share = 1.0 - red
    share = max(share, TEXT_SHARE) if share >= 0.45 else share
    return f"{attribute}: color-mix(in srgb, currentColor {100 * share:.0f}%, transparent)"


def _fix_colours(figure: Figure) -> None:
    """Keep black what lies on a coloured map, and make pictures of what has very many points."""
    for axes in figure.axes:
        has_map = bool(axes.images) or any(x.get_array() is not None for x in axes.collections)
        for line in axes.lines:
            if (
                len(np.atleast_1d(line.get_xdata())) > MANY_POINTS
                and line.get_linestyle() == "None"
            ):
                line.set_rasterized(True)
            if has_map and to_rgb(line.get_color()) == (0.0, 0.0, 0.0):
                line.set_color(FIXED_BLACK)
        for text in axes.texts if has_map else ():
            if to_rgb(text.get_color()) == (0.0, 0.0, 0.0) and _is_inside(axes, text):
                text.set_color(FIXED_BLACK)


def _is_inside(axes: Axes, text: Text) -> bool:
    """Whether a text, or what an annotation is about, lies within the axes."""
    if isinstance(text, Annotation):
        position, transform = text.xy, axes.transData
    else:
        position, transform = text.get_position(), text.get_transform()
    place = axes.transAxes.inverted().transform(transform.transform(position))
    return bool(np.all((place >= 0.0) & (place <= 1.0)))
