"""The numbers that a figure shows, as a tidy table."""

import csv
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PathCollection, PolyCollection
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedFormatter, FuncFormatter

# A row is a point, or an end of a line, bar or band; x and y are places on the axes, and their
# words what an axis says there in place of a number.
HEADS = (
    *("panel", "series", "mark", "item"),
    *("x_axis", "x", "x_word", "y_axis", "y", "y_word", "value"),
)
Point = tuple[str, str, int, Any, Any, Any]


def figure_data(figure: Figure) -> str:
    """Every point, line, bar, band and cell of a figure as CSV, a row each.

    Words written beside points are left out.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADS)
    bars = {id(x.colorbar.ax) for axes in figure.axes for x in axes.images if x.colorbar}
    shown = [x for x in figure.axes if x.get_visible() and id(x) not in bars]
    for number, axes in enumerate(shown, 1):
        panel = " ".join(axes.get_title().split()) or (str(number) if len(shown) > 1 else "")
        names = [" ".join(x.get_label().get_text().split()) for x in (axes.xaxis, axes.yaxis)]
        words = [_words(axes, which) for which in ("x", "y")]
        for series, mark, item, x, y, value in _points(axes):
            writer.writerow(
                [
                    *(panel, series, mark, item),
                    *(names[0], _number(x), words[0].get(_key(x), "")),
                    *(names[1], _number(y), words[1].get(_key(y), "")),
                    _number(value),
                ]
            )
    return text.getvalue()


def _points(axes: Axes) -> Iterator[Point]:
    """Series, mark, number of the artist, x, y and value of all that axes show."""
    for k, line in enumerate(axes.lines):
        x, y = (np.atleast_1d(np.asarray(z, float)) for z in line.get_data(orig=False))
        # A threshold is across the whole panel, from 0 to 1 of it along the other axis.
        is_threshold = line.get_transform() != axes.transData
        plain = "points" if line.get_linestyle() in ("None", "", " ") else "line"
        for a, b in zip(x, y, strict=True):
            yield _label(line), "threshold" if is_threshold else plain, k, a, b, ""
    for k, patch in enumerate(x for x in axes.patches if isinstance(x, Rectangle)):
        low, base = patch.get_xy()
        series = _bar_label(axes, patch)
        for a, b in ((low, base), (low + patch.get_width(), base + patch.get_height())):
            yield series, "bar", k, a, b, ""
    for k, collection in enumerate(axes.collections):
        yield from _collection(collection, k)
    for k, image in enumerate(axes.images):
        values: Any = np.ma.filled(np.ma.asarray(image.get_array(), float), np.nan)
        left, right, bottom, top = image.get_extent()
        rows, columns = values.shape[:2]
        xs = left + (np.arange(columns) + 0.5) * (right - left) / columns
        ys = top + (np.arange(rows) + 0.5) * (bottom - top) / rows
        for i, j in np.ndindex(rows, columns):
            yield _label(image), "cell", k, xs[j], ys[i], values[i, j]


def _collection(given: Collection, k: int) -> Iterator[Point]:
    if isinstance(given, PathCollection):
        values = given.get_array()
        for i, (a, b) in enumerate(np.asarray(given.get_offsets(), float)):
            yield _label(given), "points", k, a, b, "" if values is None else values[i]
    elif isinstance(given, LineCollection):
        for i, segment in enumerate(given.get_segments()):
            for a, b in np.asarray(segment, float)[:, :2]:
                yield _label(given), "interval", i, a, b, ""
    elif isinstance(given, PolyCollection):
        for i, path in enumerate(given.get_paths()):
            for a, b in np.asarray(path.vertices, float):
                yield _label(given), "band", i, a, b, ""


def _bar_label(axes: Axes, patch: Rectangle) -> str:
    for container in axes.containers:
        if isinstance(container, BarContainer) and patch in container.patches:
            return _named(str(container.get_label()))
    return _label(patch)


def _label(artist: Any) -> str:
    return _named(str(artist.get_label()))


def _named(label: str) -> str:
    """A label that the legend shows; what matplotlib makes up is none."""
    return "" if label.startswith("_") else " ".join(label.split())


def _words(axes: Axes, which: str) -> dict[float, str]:
    """What stands on an axis at fixed places in place of numbers."""
    axis = getattr(axes, f"{which}axis")
    formatter = axis.get_major_formatter()
    if not isinstance(formatter, FixedFormatter | FuncFormatter):
        return {}
    places = [float(x) for x in axis.get_ticklocs()]
    texts = formatter.format_ticks(places)
    return {_key(x): " ".join(str(y).split()) for x, y in zip(places, texts, strict=True)}


def _key(place: Any) -> float:
    return round(float(place), 9)


def _number(value: Any) -> str:
    if isinstance(value, str):
        return value
    number = float(value)
    return "" if np.isnan(number) else f"{number:.10g}"
