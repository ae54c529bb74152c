"""What is wrong with a figure for those who look at it: measured from what is drawn."""

import re
from collections.abc import Iterator
from importlib.resources import files
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from identknee.report.figures import without_mathtext

# Boxes of text have room above and below the letters [px at 100 dots an inch].
ROOM = 1.5
# What a page leaves beside a figure, and at most for it [px].
PAGE_MARGINS, WIDEST = 40.0, 992.0
_CODE_NAME = re.compile(r"[a-z]_(?:kN|pct|mm|deg|Nm|N)\b")


def drawn(figure: Figure) -> RendererAgg:
    """The renderer of a figure that has been drawn."""
    canvas: Any = FigureCanvasAgg(figure)
    with without_mathtext(figure):
        canvas.draw()
    renderer: RendererAgg = canvas.get_renderer()
    return renderer


def texts(figure: Figure) -> list[Text]:
    """All that is written and shown."""
    hidden = {id(y) for x in figure.axes if not x.get_visible() for y in x.findobj(Text)}
    ticks = {id(y) for x in figure.axes for y in _unseen_ticks(x)}
    return [
        x
        for x in figure.findobj(Text)
        if x.get_visible() and x.get_text().strip() and id(x) not in hidden | ticks
    ]


def clipped(figure: Figure, renderer: RendererAgg) -> list[str]:
    """Texts that reach beyond the figure."""
    whole = figure.bbox
    return [
        x.get_text()
        for x in texts(figure)
        for box in [x.get_window_extent(renderer)]
        if min(box.x0 - whole.x0, box.y0 - whole.y0, whole.x1 - box.x1, whole.y1 - box.y1) < -ROOM
    ]


def overlapping(figure: Figure, renderer: RendererAgg) -> list[tuple[str, str]]:
    """Pairs of texts that lie upon one another; those at a slant are not in their boxes."""
    straight = [x for x in texts(figure) if x.get_rotation() % 90.0 == 0.0]
    boxes = [(x.get_text(), x.get_window_extent(renderer)) for x in straight]
    return [
        (a, b) for (a, one), (b, other) in combinations(boxes, 2) if _overlap(one, other) > ROOM
    ]


def empty_axes(figure: Figure, renderer: RendererAgg) -> list[str]:
    """Panels in which nothing is to be seen."""
    return [
        x.get_title() or x.get_xlabel() or "?"
        for x in figure.axes
        if x.get_visible() and x.axison and not any(_contents(x, renderer))
    ]


def code_names(figure: Figure) -> list[str]:
    """Texts that name a parameter or a coordinate as files do."""
    return [x.get_text() for x in texts(figure) if _CODE_NAME.search(x.get_text())]


def smallest_text(svg: str, width: float) -> float:
    """The smallest letters of a drawing on a page of some width [px]."""
    own, least = (float(re.findall(rf"--{x}: (\d+)px", svg)[0]) for x in ("width", "least"))
    scale = max(min(own, width - PAGE_MARGINS, WIDEST), least) / own
    sizes = re.findall(r"<text style=\"[^\"]*?([\d.]+)px", svg)
    return min(map(float, sizes)) * 4.0 / 3.0 * scale


def page_colours(scheme: str) -> dict[str, str]:
    """Colours of the page by their names, ``"light"`` or ``"dark"``."""
    style = files("identknee.report.page").joinpath("style.css").read_text(encoding="utf-8")
    blocks = re.findall(r":root \{(.*?)\}", style, re.DOTALL)
    found = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", blocks[0]))
    if scheme == "dark":
        found |= dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", blocks[1]))
    return found


def text_contrasts(svg: str, scheme: str) -> dict[str, float]:
    """Contrast of every text of a drawing with the page it stands on.

    Texts in the two colours that are kept for coloured maps are left out.
    """
    colours = page_colours(scheme)
    found = {}
    for style, word in re.findall(r'<text style="([^"]*)"[^>]*>([^<]*)</text>', svg):
        fill = (re.search(r"fill: ([^;]+)", style) or ["", "currentColor"])[1]
        if fill not in ("#010101", "#ffffff"):
            found[word] = contrast(_resolved(fill, colours), to_rgb(colours["paper"]))
    return found


def contrast(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """Contrast of two colours after WCAG 2.2."""
    dark, bright = sorted((_luminance(one), _luminance(other)))
    return (bright + 0.05) / (dark + 0.05)


def _resolved(fill: str, colours: dict[str, str]) -> tuple[float, ...]:
    if fill == "currentColor":
        return to_rgb(colours["ink"])
    if named := re.fullmatch(r"var\(--([\w-]+)\)", fill):
        return to_rgb(colours[named[1]])
    if mixed := re.match(r"color-mix\(in srgb, currentColor (\d+)%", fill):
        share = int(mixed[1]) / 100.0
        ink, paper = np.array(to_rgb(colours["ink"])), np.array(to_rgb(colours["paper"]))
        return tuple((share * ink + (1.0 - share) * paper).tolist())
    return to_rgb(fill)


def _luminance(colour: tuple[float, ...]) -> float:
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _overlap(one: Bbox, other: Bbox) -> float:
    """The smaller side of what two boxes share [px]."""
    width = min(one.x1, other.x1) - max(one.x0, other.x0)
    height = min(one.y1, other.y1) - max(one.y0, other.y0)
    return float(min(width, height))


def _contents(axes: Axes, renderer: RendererAgg) -> Iterator[bool]:
    """Of everything drawn in axes, whether some of it is where they can be seen."""
    inside = axes.get_window_extent(renderer)
    for artist in (*axes.lines, *axes.collections, *axes.patches, *axes.images, *axes.texts):
        box = artist.get_window_extent(renderer)
        is_finite = bool(np.all(np.isfinite(box.extents)))
        yield artist.get_visible() and is_finite and bool(inside.overlaps(box))


def _unseen_ticks(axes: Axes) -> Iterator[Text]:
    """Labels of ticks that lie outside the limits and are not drawn."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        slack = 1e-9 * (high - low) if axis.get_scale() == "linear" else 0.0
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low - slack <= tick.get_loc() <= high + slack or not axes.axison:
                yield from (tick.label1, tick.label2)
