"""The figure of fits from several starts: how wrong the parameters, how good the laxity."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identknee.report.figures import COLOURS, MARKERS
from identknee.verbs.demo import StartFits

# What is below this is exact for every purpose and would stretch the axis.
FLOOR = 1e-3


def starts_figure(fits: Sequence[StartFits]) -> Figure:
    """Figure with parameter errors on the left and laxity errors on the right, one dot a run.

    Parameters
    ----------
    fits
        By method and start.
    """
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    _dots(left, fits, "error_kN")
    _dots(right, fits, "rmse_deg")
    left.set_ylabel("mean absolute error of stiffness [kN]")
    left.set_title("how far the parameters are from the truth", fontsize=10)
    right.set_ylabel("RMSE of rotations [deg]")
    right.set_title("how well the laxity is reproduced", fontsize=10)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def _dots(axes: Axes, fits: Sequence[StartFits], quantity: str) -> None:
    starts = list(dict.fromkeys(x.start for x in fits))
    methods = list(dict.fromkeys(x.method for x in fits))
    for k, method in enumerate(methods):
        own = [x for x in fits if x.method == method]
        places = np.repeat([starts.index(x.start) for x in own], [x.n_runs for x in own])
        across = places + 0.16 * (k - 0.5 * (len(methods) - 1))
        values = np.concatenate([getattr(x, quantity) for x in own])
        axes.plot(
            across,
            np.maximum(values, FLOOR),
            MARKERS[k],
            label=method,
            color=COLOURS[k],
            alpha=0.75,
        )
    axes.set_yscale("log")
    axes.set_ylim(0.7 * FLOOR, None)
    # The label of the floor stands to the right of the last start.
    axes.set_xlim(-0.5, len(starts) + 0.15)
    axes.set_xticks(range(len(starts)), starts)
    axes.axhline(FLOOR, color="0.8", linewidth=0.8, zorder=0)
    axes.annotate(
        f"{FLOOR:g} or less",
        (1.0, FLOOR),
        xycoords=("axes fraction", "data"),
        xytext=(-3, 3),
        textcoords="offset points",
        ha="right",
        fontsize=7,
        color="0.4",
    )
    axes.spines[["top", "right"]].set_visible(False)
