"""Figures of sweeps: how low they end, and where starts and ends lie."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from identknee.report.figures import (
    BLACK,
    COLOURS,
    GREY,
    MARKERS,
    SMALL,
    STYLES,
    Figure,
    bare,
    legend_below,
    panel_grid,
    panel_rows,
)
from identknee.runs.declare import Array
from identknee.verbs.demo import StartFits

# Objectives below this share of the axis are rounding; they are drawn at its foot.
LOWEST = 1e-12
# More ends than these are a line without marks.
MOST_MARKED = 60
# Marker, colour and words of each end of a search.
KINDS = {
    "minimum": ("o", COLOURS[0], "minimum"),
    "valley": ("s", COLOURS[4], "optimizer stopped"),
    "cliff": ("^", COLOURS[1], "cliff"),
    "start_failed": ("x", GREY, "no prediction at the start"),
}


def waterfall_figure(panels: Mapping[str, Mapping[str, tuple[Array, Array]]]) -> Figure:
    """Objectives of all ends from low to high, a panel a sweep.

    Parameters
    ----------
    panels
        By title, and then by what is drawn (``"end"``, ``"polished"``): number of the end in their
        order, and its objective, shape ``(n,)``; infinite ones are left out.
    """
    figure, grid = panel_rows(len(panels), (2.6, 3.2), (0.7, 0.0), len(panels), sharey=True)
    drawn = [np.asarray(x[1]) for curves in panels.values() for x in curves.values()]
    lowest = max(LOWEST, min(float(np.min(x)) for x in drawn))
    for axes, (title, curves) in zip(grid, panels.items(), strict=True):
        for k, (name, (number, objective)) in enumerate(curves.items()):
            known = np.isfinite(objective)
            axes.plot(
                np.asarray(number)[known],
                np.maximum(np.asarray(objective)[known], LOWEST),
                STYLES[k] + MARKERS[k],
                color=COLOURS[k],
                fillstyle="none",
                markersize=7 - 3 * k if np.max(number) <= MOST_MARKED else 0,
                linewidth=1.0,
                label=name,
            )
            axes.set_xlim(0, float(np.max(number)) + 1.0)
        axes.set_yscale("log")
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("starts, by objective")
        bare(axes)
    # A limit stops autoscaling of all panels that share the axis.
    highest = max((float(np.max(x[np.isfinite(x)], initial=lowest)) for x in drawn), default=lowest)
    grid[0].set_ylim(0.3 * lowest, 3.0 * highest)
    grid[0].set_ylabel("objective" + " (below 1e-12 at 1e-12)" * (lowest <= LOWEST))
    grid[0].legend(frameon=False, fontsize=SMALL)
    return figure


def start_end_figure(
    panels: Mapping[str, tuple[Array, Array, Sequence[str]]],
    parameters: Sequence[str],
    truth: ArrayLike,
    *,
    mark: str = "truth",
) -> Figure:
    """Where starts lie and where they end, in the plane of each ligament's two parameters.

    Parameters
    ----------
    panels
        By title, a row each: starts and ends, shape ``(n, 2 m)``, and the kind of each end.
    parameters
        Names: m stiffnesses, then m reference strains.
    truth
        True theta, or another to mark, shape ``(2 m,)``.
    mark
        What it is.
    """
    m, size = len(parameters) // 2, (len(panels), len(parameters) // 2)
    figure, grid = panel_grid(
        0.9 + 2.5 * m, 0.8 + 2.5 * len(panels), *size, sharex="col", sharey="col"
    )
    for row, (title, (starts, ends, kinds)) in enumerate(panels.items()):
        for j in range(m):
            axes, pair = grid[row, j], [j, m + j]
            _start_end(axes, np.asarray(starts)[:, pair], np.asarray(ends)[:, pair], kinds)
            axes.plot(*np.asarray(truth, float)[pair], "+", color=BLACK, markersize=11, zorder=5)
            axes.set_xlabel("stiffness [kN]" if row == len(panels) - 1 else "")
            axes.set_title(parameters[j].rpartition(".")[0] if row == 0 else "", fontsize=10)
            bare(axes)
        grid[row, 0].set_ylabel(f"{title}\nreference strain [%]", fontsize=9)
    seen = [x for x in KINDS if any(x in kinds for _, _, kinds in panels.values())]
    marks = [_mark(*KINDS[x]) for x in seen]
    marks += [_mark(".", BLACK, "end"), _mark("+", BLACK, mark, markersize=11)]
    legend_below(figure, marks)
    return figure


def _start_end(axes: Axes, starts: Array, ends: Array, kinds: Sequence[str]) -> None:
    failed = np.array([kind == "start_failed" for kind in kinds])
    segments = np.stack([starts, ends], axis=1)[~failed]
    axes.add_collection(LineCollection(list(segments), colors="0.75", linewidths=0.4, zorder=1))
    for kind, (marker, colour, _) in KINDS.items():
        chosen = np.array([x == kind for x in kinds])
        axes.plot(
            *starts[chosen].T,
            marker,
            color=colour,
            markersize=3.5,
            linestyle="",
            alpha=0.8,
            zorder=2,
        )
    axes.plot(*ends[~failed].T, ".", color=BLACK, markersize=3.5, zorder=4)


def _mark(marker: str, colour: str, label: str, **how: Any) -> Line2D:
    return Line2D([], [], linestyle="", marker=marker, color=colour, label=label, **how)


# Smaller values are as good as exact and would stretch the axis.
FLOOR = 1e-3


def starts_figure(fits: Sequence[StartFits]) -> Figure:
    """Figure with parameter errors on the left and laxity errors on the right, one dot a run."""
    figure, panels = panel_rows(2, (4.5, 3.6), (0.0, 0.0), 2)
    for axes, quantity, unit, title in (
        (
            *(panels[0], "error_kN", "mean absolute error of stiffness [kN]"),
            "how far the parameters are from the truth",
        ),
        (panels[1], "rmse_deg", "RMSE of rotations [deg]", "how well the laxity is reproduced"),
    ):
        _dots(axes, fits, quantity)
        axes.set_ylabel(unit)
        axes.set_title(title, fontsize=10)
    handles, labels = panels[0].get_legend_handles_labels()
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
    bare(axes)
