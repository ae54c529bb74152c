"""Colours, markers, sizes and frames that all figures share.

Colours are those of Okabe and Ito, distinct for the colour-blind, and always come with a marker or
a label.
"""

import io
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from textwrap import wrap
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.text import Text

from identknee.report.canvas import AS_TEXT, Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")
STYLES = ("-", "--", "-.", ":")
BLACK, GREY = "#000000", "#777777"
SMALL = 8
# One colour for one thing in every figure: what was measured, the fit or model without causes, that
# with causes, and all that fits as well.
MEASURED, FIT, WITH_CAUSE, ALL_FITS = BLACK, *COLOURS[:2], COLOURS[5]
# Letters of one line of a legend.
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


def panel_row(
    n: int, *, width: float, height: float, sharey: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure of `n` panels side by side, and the panels."""
    figure, grid = panel_grid(0.7 + width * n, height, 1, n, sharey=sharey)
    return figure, list(grid[0])


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
        # The labels of logarithmic axes are formulas; those not made yet must be able to be.
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
