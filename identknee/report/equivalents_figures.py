"""Figures of equivalent parameter sets, one function a figure."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from identknee.report.figures import BLACK, COLOURS, GREY, SMALL, bare
from identknee.runs.arrays import Array

MAP = "cividis"


def sets_figure(
    parameters: Sequence[str],
    sets: Array,
    fit: Array,
    laxity: Mapping[str, Array],
    *,
    origin: str = "the fit",
) -> Figure:
    """Parameter sets as lines over their axes, and below how little their laxity differs.

    Parameters
    ----------
    parameters
        Their names.
    sets
        Shape ``(n_sets, n)``. The two first, the farthest apart, are drawn bold.
    fit
        Shape ``(n,)``.
    laxity
        By name with unit, a coordinate's difference from the fit in every trial, shape
        ``(n, n_trials)``: of the same sets, or of these two and the band of all.
    origin
        What the laxity is compared with, where it is not the fit's.
    """
    figure = Figure(figsize=(8.6, 6.4), layout="constrained")
    grid = figure.add_gridspec(2, len(laxity), height_ratios=(1.25, 1.0))
    _parallel(figure.add_subplot(grid[0, :]), parameters, sets, fit)
    panels = [figure.add_subplot(grid[1, k]) for k in range(len(laxity))]
    for axes, (name, values) in zip(panels, laxity.items(), strict=True):
        trials = np.arange(1, values.shape[1] + 1)
        low, high = values.min(axis=0), values.max(axis=0)
        axes.fill_between(
            trials, low, high, step="mid", color=COLOURS[5], alpha=0.5, linewidth=0, label="all"
        )
        for k, values_of_set in enumerate(values[:2]):
            axes.plot(trials, values_of_set, color=COLOURS[k], linewidth=1.0)
        axes.axhline(0.0, color=BLACK, linewidth=0.8)
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        axes.set_xlabel("trial")
        axes.set_title(f"{name}\nminus {origin}", fontsize=SMALL + 1)
        bare(axes)
    handles = [
        Line2D([], [], color=COLOURS[0], linewidth=2, label="one of the two sets farthest apart"),
        Line2D([], [], color=COLOURS[1], linewidth=2, label="the other"),
        Line2D([], [], color=BLACK, marker="o", label="fit"),
        Line2D([], [], color=COLOURS[5], alpha=0.5, linewidth=6, label="all sets"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def ranges_figure(
    names: Sequence[str], at_fit: Array, ranges: Mapping[str, Array], *, unit: str
) -> Figure:
    """Smallest and largest value of quantities over regions, a bar each.

    Parameters
    ----------
    names
        Names of the quantities.
    at_fit
        Their values at the fit, shape ``(n,)``.
    ranges
        By name of the region, smallest and largest value, shape ``(n, 2)``.
    unit
        Unit of the quantities.
    """
    n = len(names)
    figure = Figure(figsize=(7.6, 1.4 + n * (0.16 + 0.13 * len(ranges))), layout="constrained")
    axes = figure.subplots()
    rows = np.arange(n)
    thickness = 0.8 / len(ranges)
    for k, (name, values) in enumerate(ranges.items()):
        y = rows - 0.4 + (k + 0.5) * thickness
        widths = values[:, 1] - values[:, 0]
        # Bars would pin the axis to their ends, and hide a mark that stands there.
        axes.use_sticky_edges = False
        axes.barh(y, widths, 0.86 * thickness, values[:, 0], color=COLOURS[k], label=name)
    for row, value in zip(rows, at_fit, strict=True):
        axes.plot([value, value], [row - 0.42, row + 0.42], color=BLACK, linewidth=1.4)
    axes.set_yticks(rows, list(names), fontsize=SMALL)
    axes.set_ylim(n - 0.4, -0.6)
    axes.grid(axis="x", color="0.92")
    axes.set_axisbelow(True)
    axes.set_xlabel(unit)
    handles, _ = axes.get_legend_handles_labels()
    handles.append(Line2D([], [], color=BLACK, linewidth=1.4, label="fit"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    bare(axes)
    return figure


def _parallel(axes: Axes, parameters: Sequence[str], sets: Array, fit: Array) -> None:
    """Each parameter scaled from its smallest to its largest value among the sets."""
    low, high = sets.min(axis=0), sets.max(axis=0)
    width = np.where(high > low, high - low, 1.0)
    places = np.arange(len(parameters))
    shades = colormaps[MAP](np.linspace(0.15, 0.9, len(sets)))
    # Ordered by the first parameter, so that its axis reads as a colour scale.
    ranks = np.argsort(np.argsort(sets[:, 0]))
    for rank, theta in zip(ranks[2:], sets[2:], strict=True):
        axes.plot(places, (theta - low) / width, color=shades[rank], linewidth=0.6, alpha=0.6)
    for k, theta in enumerate(sets[:2]):
        axes.plot(places, (theta - low) / width, color=COLOURS[k], linewidth=2.2)
    axes.plot(places, (fit - low) / width, color=BLACK, marker="o", markersize=4)
    for place, smallest, largest in zip(places.tolist(), low, high, strict=True):
        axes.axvline(place, color=GREY, linewidth=0.6, zorder=0)
        axes.text(place, -0.04, f"{smallest:.3g}", ha="center", va="top", fontsize=SMALL)
        axes.text(place, 1.03, f"{largest:.3g}", ha="center", va="bottom", fontsize=SMALL)
    axes.set_xticks(places, [_on_lines(name) for name in parameters], fontsize=SMALL)
    axes.tick_params(axis="x", pad=14, length=0)
    axes.set_yticks([])
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlim(-0.4, len(parameters) - 0.6)
    axes.spines[["top", "right", "bottom", "left"]].set_visible(False)


def _on_lines(name: str) -> str:
    owner, _, quantity = name.rpartition(".")
    words, _, unit = quantity.rpartition("_")
    return f"{owner}\n{words.replace('_', ' ')}\n[{'%' if unit == 'pct' else unit}]"
