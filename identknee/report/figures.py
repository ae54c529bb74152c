"""Colours, markers, sizes and frames that all figures share.

Colours are those of Okabe and Ito, which the colour-blind tell apart, and always come with a marker
or a label.
"""

from collections.abc import Sequence

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")
STYLES = ("-", "--", "-.", ":")
BLACK, GREY = "#000000", "#777777"
SMALL = 8


def panel_row(
    n: int, *, width: float, height: float, sharey: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure of `n` panels side by side, and the panels."""
    figure = Figure(figsize=(0.7 + width * n, height), layout="constrained")
    return figure, list(figure.subplots(1, n, squeeze=False, sharey=sharey)[0])


def legend_below(
    figure: Figure, handles: Sequence[Artist], labels: Sequence[str], columns: int = 5
) -> None:
    """A legend of the whole figure below its panels, of so many columns at most."""
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=min(len(labels), columns),
        frameon=False,
        fontsize=9,
    )


def bare(axes: Axes) -> None:
    """Axes without a frame above and on the right."""
    axes.spines[["top", "right"]].set_visible(False)
