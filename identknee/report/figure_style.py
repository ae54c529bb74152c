"""Figures in the width of a journal and in the colours of a style sheet."""

import warnings
from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
from matplotlib.collections import Collection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from identknee.report.figures import BLACK, COLOURS

# Millimetres of a column and of two, as most journals have them.
ONE_COLUMN_MM, TWO_COLUMNS_MM = 89.0, 183.0
MM_PER_INCH = 25.4
# The smallest letters that journals print [pt].
LEAST_LETTERS = 5.0


def resize(figure: Figure, width_mm: float) -> None:
    """Give a figure a width, with all in proportion and no letters too small to print.

    Raises
    ------
    ValueError
        If its texts do not fit into that width; the message names one that does.
    """
    width, height = figure.get_size_inches()
    # Labels of ticks are made when they are drawn.
    figure.draw_without_rendering()
    letters: list[Any] = figure.findobj(Text)
    sizes = [float(x.get_fontsize()) for x in letters]
    shown = [size for x, size in zip(letters, sizes, strict=True) if x.get_text().strip()]
    scale = width_mm / MM_PER_INCH / width
    own = min(1.0, max(scale, LEAST_LETTERS / min(shown, default=LEAST_LETTERS)))
    for text, size in zip(letters, sizes, strict=True):
        text.set_fontsize(own * size)
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            for label in axis.get_ticklabels()[:1]:
                axis.set_tick_params(labelsize=label.get_fontsize())
        for line in axes.lines:
            line.set_linewidth(own * line.get_linewidth())
            line.set_markersize(own * line.get_markersize())
    figure.set_size_inches(width * scale, height * max(scale, own))
    if _has_clash(figure):
        fitting = [x for x in (ONE_COLUMN_MM, TWO_COLUMNS_MM) if x > width_mm]
        remedy = f"{fitting[0]:g} mm" if fitting else f"{width * MM_PER_INCH:.0f} mm"
        raise ValueError(
            f"the texts of this figure do not fit into {width_mm:g} mm; give {remedy} or more"
        )


def _has_clash(figure: Figure) -> bool:
    """Whether titles or labels of axes lie upon one another or beyond the figure."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        figure.draw_without_rendering()
    if any("collapsed" in str(x.message) for x in told):
        return True
    words = [
        y
        for x in figure.axes
        for y in (x.title, x.xaxis.label, x.yaxis.label)
        if x.get_visible() and y.get_text().strip()
    ]
    boxes = [x.get_window_extent() for x in words]
    whole = figure.bbox
    room = 1.0
    if any(
        min(x.x0 - whole.x0, x.y0 - whole.y0, whole.x1 - x.x1, whole.y1 - x.y1) < -room
        for x in boxes
    ):
        return True
    return any(a.shrunk(0.9, 0.9).overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])


def recolour(figure: Figure) -> None:
    """Give a figure the colours of the style sheet in use, where it is not the usual one."""
    cycle = list(mpl.rcParams["axes.prop_cycle"].by_key().get("color", ()))
    usual = list(mpl.rcParamsDefault["axes.prop_cycle"].by_key()["color"])
    changed: dict[str, str] = {}
    if cycle and cycle != usual:
        changed |= {x.lower(): to_hex(cycle[k % len(cycle)]) for k, x in enumerate(COLOURS)}
    ink = to_hex(mpl.rcParams["text.color"])
    if ink != BLACK:
        changed[BLACK] = ink
    if not changed:
        return
    papers = [figure.patch, *(x.patch for x in figure.axes), *(x.patch for x in figure.subfigs)]
    parts: dict[type[Any], tuple[str, ...]] = {
        Line2D: ("color", "markerfacecolor", "markeredgecolor"),
        Patch: ("facecolor", "edgecolor"),
        Text: ("color",),
    }
    for kind_of_artist, kinds in parts.items():
        for own_artist in figure.findobj(kind_of_artist):
            # The paper has the colour of the style already.
            if not any(own_artist is x for x in papers):
                _change(own_artist, kinds, changed)
    artist: Any
    for artist in figure.findobj(Collection):
        # Those of a map have its colours.
        if artist.get_array() is None:
            for kind in ("facecolor", "edgecolor"):
                own = [_changed(x, changed) for x in getattr(artist, f"get_{kind}")()]
                getattr(artist, f"set_{kind}")(own)


def _change(artist: Any, kinds: tuple[str, ...], changed: Mapping[str, str]) -> None:
    for kind in kinds:
        own = getattr(artist, f"get_{kind}")()
        if not (isinstance(own, str) and own in ("none", "auto")):
            getattr(artist, f"set_{kind}")(_changed(own, changed))


def _changed(colour: Any, changed: Mapping[str, str]) -> Any:
    """The colour as the style sheet has it, with its own opacity."""
    new = changed.get(to_hex(colour))
    return colour if new is None else to_rgba(new, to_rgba(colour)[3])
