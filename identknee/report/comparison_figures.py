"""Figures of results side by side: forest plots, and the deviance by its terms."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
from matplotlib.lines import Line2D

from identknee.report.comparison import ComparedMisfit, ComparedQuantity
from identknee.report.figures import (
    COLOURS,
    MARKERS,
    SMALL,
    Figure,
    bare,
    legend_below,
    one_panel,
    panel_grid,
    rows_down,
)
from identknee.runs.words import label_without_unit, unit_of

# Height of a row for each result, and of an axis beside its rows [inches].
ROW, AROUND = 0.17, 0.75
WIDTH = 7.2
# Share of the axis beyond all estimates and ends that an open end reaches.
BEYOND = 0.06


def forest_figure(quantities: Sequence[ComparedQuantity], names: Sequence[str]) -> Figure:
    """Estimates and sets of quantities, a colour and a marker for each result.

    Quantities of one unit share an axis. An open end is an arrow at the edge.

    Parameters
    ----------
    quantities
        Of any results.
    names
        Of the results, in their order.
    """
    units = list(dict.fromkeys(unit_of(x.name) for x in quantities))
    groups = [[x for x in quantities if unit_of(x.name) == unit] for unit in units]
    n = len(names)
    height = sum(AROUND + len(x) * (0.12 + ROW * n) for x in groups) + 0.4
    heights = [len(x) + 0.4 for x in groups]
    figure, grid = panel_grid(WIDTH, height, len(groups), 1, height_ratios=heights)
    for axes, unit, group in zip(grid[:, 0], units, groups, strict=True):
        ends = [
            y
            for x in group
            for z in x.stands
            for y in (z.estimate, z.lower, z.upper)
            if y is not None
        ]
        low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
        room = BEYOND * (high - low or 1.0)
        for row, quantity in enumerate(group):
            for stand in quantity.stands:
                k = names.index(stand.name)
                place = row + 0.7 * ((k + 0.5) / n - 0.5)
                colour = COLOURS[k % len(COLOURS)]
                if stand.has_set:
                    left = low - room if stand.lower is None else stand.lower
                    right = high + room if stand.upper is None else stand.upper
                    axes.plot([left, right], [place, place], color=colour, linewidth=1.6)
                    for end, at, shape in ((stand.lower, left, "<"), (stand.upper, right, ">")):
                        if end is None:
                            axes.plot(at, place, shape, color=colour, markersize=5)
                if stand.estimate is not None:
                    axes.plot(
                        stand.estimate, place, MARKERS[k % len(MARKERS)], color=colour,
                        markersize=5, markerfacecolor=colour if stand.has_set else "white",
                    )  # fmt: skip
        rows_down(axes, [label_without_unit(x.name) for x in group], 0.5)
        axes.set_xlim(low - 2.0 * room, high + 2.0 * room)
        axes.set_xlabel(f"[{unit}]" if unit else "", fontsize=SMALL)
        bare(axes, grid="x", labelsize=SMALL)
    handles = [
        Line2D([], [], color=colour, marker=marker, markersize=5, linewidth=1.6, label=name)
        for name, colour, marker in zip(names, cycle(COLOURS), cycle(MARKERS), strict=False)
    ]
    legend_below(figure, handles, columns=4)
    return figure


def misfit_figure(misfits: Sequence[ComparedMisfit]) -> Figure:
    """Deviance of results as bars of their terms, one on another.

    Parameters
    ----------
    misfits
        Of results with a deviance, of the same data.
    """
    figure, axes = one_panel(WIDTH, 1.3 + 0.35 * len(misfits))
    terms = list(dict.fromkeys(y.name for x in misfits for y in x.terms))
    rows, begun = np.arange(len(misfits)), np.zeros(len(misfits))
    for k, term in enumerate(terms):
        sizes = [sum(y.deviance for y in x.terms if y.name == term) for x in misfits]
        axes.barh(rows, sizes, 0.6, begun, color=COLOURS[k % len(COLOURS)], label=term)
        begun = begun + sizes
    rows_down(axes, [x.name for x in misfits])
    axes.set_xlabel("deviance", fontsize=SMALL + 1)
    bare(axes, grid="x", labelsize=SMALL)
    legend_below(figure, *axes.get_legend_handles_labels(), columns=3)
    return figure
