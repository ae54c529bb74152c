"""Figures as SVG inside a page: text stays text, colours follow the page's light or dark."""

import io
import re
import xml.etree.ElementTree as ET

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

from identknee.report.figures import COLOURS, without_mathtext

# Above something drawn in fixed colours black must stay black; this is not taken for it.
FIXED_BLACK = "#010101"
MANY_POINTS = 300
# Room beside a figure for text that a reader's font sets wider [pt].
MARGIN = 9.0
# A figure gets no smaller than its smallest letters allow [pt]; it scrolls instead.
LEAST_LETTERS = 5.6
RASTER_DPI = 130
# Least share of the text's colour: lighter text is hard to read.
TEXT_SHARE = 0.72
PAGE_COLOURS = {colour.lower(): f"var(--series-{k})" for k, colour in enumerate(COLOURS)}
SVG, LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"


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
            if isinstance(text, Annotation):
                position, transform = text.xy, axes.transData
            else:
                position, transform = text.get_position(), text.get_transform()
            place = axes.transAxes.inverted().transform(transform.transform(position))
            if to_rgb(text.get_color()) == (0.0, 0.0, 0.0) and bool(
                np.all((place >= 0.0) & (place <= 1.0))
            ):
                text.set_color(FIXED_BLACK)
    buffer = io.StringIO()
    with (
        without_mathtext(figure),
        mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": identity}),
    ):
        figure.savefig(buffer, format="svg", dpi=RASTER_DPI, metadata={"Date": None})
    root = ET.fromstring(buffer.getvalue())
    for element in root.findall(f"{SVG}metadata"):
        root.remove(element)
    # The figure and its axes have the background of the page.
    for patch in root.iterfind(f".//{SVG}g"):
        paper = patch.find(f"{SVG}path")
        if paper is not None and patch.get("id", "").startswith("patch_"):
            paper.set("style", paper.get("style", "").replace("fill: #ffffff", "fill: none"))
    for element in root.iter():
        element.tag = element.tag.removeprefix(SVG)
        element.attrib = {
            ("href" if key == LINK else key): _for_page(key, value, identity)
            for key, value in element.items()
        }
    # Its own width beside the page's class, and the description where readers look for it.
    width, height = 72.0 * np.asarray(figure.get_size_inches()) + (2.0 * MARGIN, 0.0)
    letters = [float(x.get_fontsize()) for x in figure.findobj(Text) if x.get_text().strip()]
    least = width * min(1.0, LEAST_LETTERS / min(letters, default=width))
    root.attrib = {
        "class": "drawing",
        "role": "img",
        "aria-labelledby": f"{identity}-title",
        "viewBox": f"{-MARGIN:g} 0 {width:g} {height:g}",
        "style": f"--width: {width * 4 / 3:.0f}px; --least: {least * 4 / 3:.0f}px",
    }
    title = ET.Element("title", id=f"{identity}-title")
    title.text = description
    root.insert(0, title)
    return ET.tostring(root, encoding="unicode")


def least_width(svg: str) -> str:
    """How wide a drawing must be for its smallest letters to be read, as the page has it."""
    found = re.search(r"--least: (\d+px)", svg)
    return found[1] if found else "0px"


def _for_page(key: str, value: str, identity: str) -> str:
    """An attribute whose names are this figure's alone, and whose colours and fonts the page's."""
    if key == "id":
        return f"{identity}-{value}"
    if key == LINK and value.startswith("#"):
        return f"#{identity}-{value[1:]}"
    value = value.replace("url(#", f"url(#{identity}-")
    if key != "style":
        return value
    rules = [x.partition(": ") for x in value.split("; ")]
    return "; ".join(f"{name}{colon}{_page_style(name, x)}" for name, colon, x in rules)


def _page_style(name: str, value: str) -> str:
    """The value of a rule of a style."""
    if name in ("fill", "stroke"):
        if value in PAGE_COLOURS:
            return PAGE_COLOURS[value]
        if not value.startswith("#") or value in (FIXED_BLACK, "#ffffff"):
            return value
        red, green, blue = to_rgb(value)
        if not (red == green == blue):
            return value
        if red == 0.0:
            return "currentColor"
        share = 1.0 - red
        share = max(share, TEXT_SHARE) if share >= 0.45 else share
        return f"color-mix(in srgb, currentColor {100 * share:.0f}%, transparent)"
    if name == "font-family":
        return "var(--figure-font)"
    if name == "font":  # such as "italic 10px 'DejaVu Sans'"
        return f"{value[: value.index('px')]}px var(--figure-font)"
    return value
