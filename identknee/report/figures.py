"""The canvas of figures, and the colours, markers, sizes and frames that all share.

Colours are those of Okabe and Ito, distinct for the colour-blind, and always come with a marker or
a label. A figure is drawn on its own canvas, or on axes and subfigures that a user gives.
The numbers that it shows can be had as a tidy table.
"""

import csv
import io
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.container import BarContainer
from matplotlib.figure import Figure as OwnFigure
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FuncFormatter
from typing_extensions import override

# A row is a point, or an end of a line, bar or band; x and y are places on the axes, and their
# words what an axis says there in place of a number.
HEADS = (
    *("panel", "series", "mark", "item"),
    *("x_axis", "x", "x_word", "y_axis", "y", "y_word", "value"),
)
Point = tuple[str, str, int, Any, Any, Any]


def figure_data(figure: OwnFigure) -> str:
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
    groups = [x for x in axes.containers if isinstance(x, BarContainer)]
    for k, patch in enumerate(x for x in axes.patches if isinstance(x, Rectangle)):
        low, base = patch.get_xy()
        series = _label(next((x for x in groups if patch in x.patches), patch))
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
            # Of a bar that is not known, as of a value not measured, nothing is left.
            for a, b in np.asarray(segment, float).reshape(-1, 2):
                yield _label(given), "interval", i, a, b, ""
    elif isinstance(given, PolyCollection):
        for i, path in enumerate(given.get_paths()):
            for a, b in np.asarray(path.vertices, float):
                yield _label(given), "band", i, a, b, ""


def _label(artist: Any) -> str:
    """A label that the legend shows; what matplotlib makes up is none."""
    label = str(artist.get_label())
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


# Text of a vector figure stays text, for those who edit it.
AS_TEXT: dict[Any, Any] = {"svg.fonttype": "none", "pdf.fonttype": 42, "ps.fonttype": 42}
SEVERAL = (
    "it has several panels, which do not fit into one axes; give ax=figure.subfigures() of a "
    'figure with layout="constrained", or no ax'
)


class SeveralPanelsError(ValueError):
    """A figure of several panels was to be drawn on one axes."""


Place = Axes | FigureBase
_place: ContextVar[Place | None] = ContextVar("place", default=None)


@contextmanager
def drawn_on(place: Place | None) -> Iterator[None]:
    """Figures that are made meanwhile are drawn on this axes or figure."""
    token = _place.set(place)
    try:
        yield
    finally:
        _place.reset(token)


class Paper(OwnFigure):
    """A figure that is drawn on the axes or subfigure of `drawn_on`, if there is one."""

    def __new__(cls, *_args: Any, **_how: Any) -> "Paper":
        """A new figure, or the figure or subfigure given."""
        place = _place.get()
        if isinstance(place, FigureBase):
            return place  # type: ignore[return-value]
        return super().__new__(cls)

    def __init__(self, *args: Any, **how: Any) -> None:
        place = _place.get()
        self._given = place if isinstance(place, Axes) else None
        super().__init__(*args, **how)

    @override
    def subplots(self, nrows: int = 1, ncols: int = 1, **how: Any) -> Any:
        """The panels; the axes given, where there is one."""
        if self._given is None:
            return super().subplots(nrows, ncols, **how)
        if nrows * ncols != 1:
            raise SeveralPanelsError(SEVERAL)
        return self._given if how.get("squeeze", True) else np.array([[self._given]])

    @override
    def add_subplot(self, *args: Any, **how: Any) -> Any:
        """A panel; the axes given, where there is one."""
        return super().add_subplot(*args, **how) if self._given is None else self._given

    @override
    def add_gridspec(self, *args: Any, **how: Any) -> Any:
        """Places of several panels, which axes given do not have."""
        if self._given is not None:
            raise SeveralPanelsError(SEVERAL)
        return super().add_gridspec(*args, **how)

    @override
    def legend(self, *args: Any, **how: Any) -> Any:
        """A legend beside the panels; within the axes given, where there is one."""
        if self._given is None:
            return super().legend(*args, **how)
        how.pop("loc", None)
        return self._given.legend(*args, **{**how, "ncols": 1})

    @override
    def suptitle(self, t: str, **how: Any) -> Any:
        """The title of all panels; that of the axes given, where there is one."""
        return (
            super().suptitle(t, **how) if self._given is None else self._given.set_title(t, **how)
        )

    @override
    def colorbar(self, mappable: Any, *args: Any, **how: Any) -> Any:
        """A bar of colours, on the figure that the axes given belong to."""
        if self._given is None:
            return super().colorbar(mappable, *args, **how)
        whole = self._given.get_figure()
        assert whole is not None
        return whole.colorbar(mappable, *args, **how)

    @override
    def savefig(self, fname: Any, **how: Any) -> None:
        """Write the figure; in SVG and PDF its text stays text."""
        with mpl.rc_context(AS_TEXT):
            super().savefig(fname, **how)


# The class of all figures; type checkers see that of matplotlib.
if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure
else:
    Figure = Paper


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")
STYLES = ("-", "--", "-.", ":")
BLACK, GREY = "#000000", "#777777"
SMALL = 8
# One colour for one thing in every figure: what was measured, the fit, and all that fits as well.
MEASURED, FIT, ALL_FITS = BLACK, COLOURS[0], COLOURS[5]
# Characters of one line of a legend.
LEGEND_LETTERS = 44
# Width of a letter, and of the mark and the gaps beside an entry, in heights of a letter.
LETTER_WIDTH, HANDLE_WIDTH = 0.56, 5.0


def number(value: float, form: str = ".3g") -> str:
    """A number as it stands on an axis, with a true minus sign.

    Examples
    --------
    >>> number(-0.52, ".1f"), number(3.0, "+.1f"), number(-0.01, ".1f")
    ('−0.5', '+3.0', '0.0')
    """
    text = f"{value:{form}}"
    if float(text) == 0.0:
        text = text.replace("-", "")
    return text.replace("-", "−")


def wrapped(text: str, letters: int = LEGEND_LETTERS) -> str:
    """A text on as many lines as it needs, each of so many letters at most.

    Examples
    --------
    >>> print(wrapped("with tibial frame and femoral frame", 20))
    with tibial frame
    and femoral frame
    """
    return "\n".join(wrap(text, letters, break_long_words=False))


def one_panel(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure of so many inches, and its one panel."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots()


def panel_grid(
    width: float, height: float, rows: int, columns: int, **how: Any
) -> tuple[Figure, Any]:
    """A figure of so many inches, and its panels, an array of rows and columns."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **how)


def panel_rows(
    n: int, size: tuple[float, float], around: tuple[float, float], across: int, **how: Any
) -> tuple[Figure, list[Axes]]:
    """A figure of `n` panels, so many across, of so many inches each and so many more in all."""
    columns = max(1, min(n, across))
    rows = max(1, -(-n // columns))
    width, height = around[0] + size[0] * columns, around[1] + size[1] * rows
    figure, grid = panel_grid(width, height, rows, columns, **how)
    for unused in grid.flat[n:]:
        unused.remove()
    return figure, list(grid.flat[:n])


def rows_down(axes: Axes, labels: Sequence[str], room: float = 0.6, **how: Any) -> None:
    """Give axes a row for each label, the first on top, with some room around them."""
    axes.set_yticks(range(len(labels)), labels, **how)
    axes.set_ylim(len(labels) - 1 + room, -room)


def legend_below(
    figure: Figure,
    handles: Sequence[Artist],
    labels: Sequence[str] | None = None,
    *,
    columns: int = 5,
    fontsize: int = 9,
    **more: Any,
) -> None:
    """A legend of the whole figure below its panels, of as many columns as fit, at most so many."""
    words = [wrapped(x) for x in (labels or [str(y.get_label()) for y in handles])]
    longest = max((len(y) for x in words for y in x.splitlines()), default=1)
    inches = (LETTER_WIDTH * longest + HANDLE_WIDTH) * fontsize / 72.0
    figure.legend(
        handles,
        words,
        loc="outside lower center",
        ncols=max(1, min(columns, int(figure.bbox.width / figure.dpi / inches))),
        frameon=False,
        fontsize=fontsize,
        **more,
    )


def bare(
    axes: Axes, grid: Literal["x", "y"] | None = None, *, labelsize: float | None = None
) -> None:
    """Axes without a frame above and on the right, with pale lines across one of them."""
    axes.spines[["top", "right"]].set_visible(False)
    if labelsize is not None:
        axes.tick_params(labelsize=labelsize)
    if grid is not None:
        axes.grid(axis=grid, color="0.92")
        axes.set_axisbelow(True)


DOTS_PER_INCH, DOTS_IN_NOTEBOOK = 150, 110
MATH = "\\mathdefault"


@contextmanager
def without_mathtext(figure: Figure) -> Iterator[None]:
    """Draw the user's names literally, without mathtext.

    A letter that the font lacks is drawn as a box, without a warning.
    """
    for text in figure.findobj(Text):
        # Tick labels of logarithmic axes are mathtext and must stay so.
        if "$" in text.get_text() and MATH not in text.get_text():
            text.set_parse_math(False)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def png(figure: Figure, dots: int = DOTS_PER_INCH) -> bytes:
    """The figure as a PNG with so many dots per inch."""
    buffer = io.BytesIO()
    with without_mathtext(figure):
        figure.savefig(buffer, format="png", dpi=dots)
    return buffer.getvalue()


def show_figures() -> None:
    """Let a notebook show figures as pictures, also where pyplot was not imported."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is None:
        return
    formatter = shell.display_formatter.formatters["image/png"]
    try:
        formatter.lookup_by_type(Figure)
    except KeyError:
        formatter.for_type(Figure, lambda figure: png(figure, DOTS_IN_NOTEBOOK))


def vector(figure: Figure, form: str) -> bytes:
    """The figure as ``"svg"`` or ``"pdf"`` for a paper: text stays text."""
    buffer = io.BytesIO()
    with (
        without_mathtext(figure),
        mpl.rc_context({**AS_TEXT, "svg.hashsalt": "identknee"}),
    ):
        figure.savefig(
            buffer, format=form, metadata={"Date" if form == "svg" else "CreationDate": None}
        )
    return buffer.getvalue()


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
    # Matplotlib makes tick labels when they are drawn.
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
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        figure.draw_without_rendering()
    if any("collapsed" in str(x.message) for x in raised):
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
            # Backgrounds have the colour of the style already.
            if any(own_artist is x for x in papers):
                continue
            for kind in kinds:
                own = getattr(own_artist, f"get_{kind}")()
                if not (isinstance(own, str) and own in ("none", "auto")):
                    own_artist.set(**{kind: _changed(own, changed)})
    artist: Any
    for artist in figure.findobj(Collection):
        # Collections with an array take their colours from a colour map.
        if artist.get_array() is None:
            for kind in ("facecolor", "edgecolor"):
                own = getattr(artist, f"get_{kind}")()
                artist.set(**{kind: [_changed(x, changed) for x in own]})


def _changed(colour: Any, changed: Mapping[str, str]) -> Any:
    """The colour as the style sheet has it, with its own opacity."""
    new = changed.get(to_hex(colour))
    return colour if new is None else to_rgba(new, to_rgba(colour)[3])
