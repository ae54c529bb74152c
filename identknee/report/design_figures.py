"""Figures of trials to add, one function a figure, in the style of `identknee.report.figures`."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from identknee.laxity.protocol import Protocol
from identknee.laxity.trial_words import UNLOADED, loads_words
from identknee.report.figures import (
    BLACK,
    COLOURS,
    GREY,
    MARKERS,
    SMALL,
    STYLES,
    Figure,
    bare,
    one_panel,
    panel_rows,
    rows_down,
)
from identknee.runs.declare import Array

# Panels side by side.
ACROSS = 4


def intervals_figure(
    targets: Sequence[str], best: ArrayLike, intervals: Mapping[str, ArrayLike]
) -> Figure:
    """Intervals of each target before trials are added, as predicted and as achieved, a panel each.

    Parameters
    ----------
    targets
        Names, with their units.
    best
        The best fit of each, shape ``(t,)``.
    intervals
        By kind, ends of each, shape ``(t, 2)``; NaN for an open end, drawn as an arrow.
    """
    figure, panels = panel_rows(len(targets), (2.5, 1.5), (0.8, 0.5), ACROSS)
    ends = {kind: np.asarray(values, float) for kind, values in intervals.items()}
    for t, (axes, name) in enumerate(zip(panels, targets, strict=True)):
        center = float(np.asarray(best)[t])
        known = np.array([x[t] for x in ends.values()])
        reach = float(np.nanmax(np.abs(known - center), initial=0.0)) or 1.0
        for k, values in enumerate(ends.values()):
            _bar(axes, values[t], (center, reach), k)
        axes.axvline(center, color="0.8", linewidth=0.8, zorder=0)
        rows_down(axes, list(ends) if t % ACROSS == 0 else [""] * len(ends), 0.5)
        axes.set_title(name, fontsize=SMALL + 1)
        axes.tick_params(axis="x", labelsize=SMALL)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.tick_params(axis="y", length=0)
    return figure


def candidates_figure(
    candidates: Protocol, gains: ArrayLike, chosen: Sequence[int], label: str
) -> Figure:
    """What each candidate alone would gain, by load and flexion angle, with the order of choice.

    Parameters
    ----------
    candidates
        The trials.
    gains
        Gain of each, shape ``(k,)``; NaN for those excluded, drawn as crosses.
    chosen
        Places of those chosen, the most helpful first; one may come more than once. Loads that
        candidates have at less than half of the angles are left out where none is chosen.
    label
        What a gain is, with its unit.
    """
    gains = np.asarray(gains, float)
    angles = np.unique(candidates.flexion_deg)
    pattern = "{what} {size:g} {unit}"
    loads = [loads_words(x, pattern) for x in candidates.loads]
    labels = [" + ".join(x) or UNLOADED for x in loads]
    is_chosen = {labels[k] for k in chosen}
    counts = Counter(labels)
    # No load, then single loads, then pairs.
    n_loads = {text: len(x) for text, x in zip(labels, loads, strict=True)}
    rows = sorted(
        (x for x in n_loads if x in is_chosen or 2 * counts[x] >= len(angles)),
        key=lambda text: (n_loads[text], text),
    )
    table = np.full((len(rows), len(angles)), np.nan)
    lost: list[tuple[int, int]] = []
    places: dict[int, tuple[int, int]] = {}
    for k, text in enumerate(labels):
        if text in rows:
            i, j = rows.index(text), int(np.searchsorted(angles, candidates.flexion_deg[k]))
            places[k], table[i, j] = (j, i), gains[k]
            lost += [(j, i)] if np.isnan(gains[k]) else []
    figure, axes = one_panel(4.6 + 0.5 * len(angles), 1.8 + 0.22 * len(rows))
    image = axes.imshow(table, cmap="cividis", aspect="auto", vmin=0.0)
    for place in lost:
        axes.plot(*place, "x", color=GREY, markersize=4)
    for k, n in Counter(chosen).items():
        order = f"{list(chosen).index(k) + 1}{f' x{n}' if n > 1 else ''}"
        axes.plot(*places[k], "o", color="white", markersize=19, markeredgecolor=BLACK)
        axes.annotate(order, places[k], ha="center", va="center", fontsize=7)
    axes.set_xticks(range(len(angles)), [f"{x:g}" for x in angles])
    axes.set_yticks(range(len(rows)), rows, fontsize=SMALL)
    axes.set_xlabel("flexion [deg]; cross: no prediction at some parameters that the data allow")
    figure.colorbar(image, ax=axes, label=label)
    return figure


def steps_figure(widths: Mapping[str, ArrayLike], achieved: Mapping[str, float]) -> Figure:
    """Predicted width of each target's interval by the number of trials added.

    Parameters
    ----------
    widths
        By target, relative to its width before, shape ``(n_trials + 1,)``; NaN while it is open.
    achieved
        By target the same with all trials added, by profile.
    """
    figure, axes = one_panel(5.4, 3.8)
    for k, (name, values) in enumerate(widths.items()):
        steps = np.arange(len(np.asarray(values)))
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(
            steps,
            np.asarray(values, float),
            color=colour,
            linestyle=STYLES[k // len(COLOURS) % len(STYLES)],
            marker=MARKERS[k % len(MARKERS)],
            markersize=4,
            label=name,
        )
        axes.plot(steps[-1], achieved[name], "D", color=colour, fillstyle="none", markersize=8)
    axes.plot([], [], "D", color=GREY, fillstyle="none", label="achieved")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="trials added", ylabel="relative width of the 95 % interval")
    axes.set_ylim(bottom=0.0)
    axes.grid(color="0.92")
    axes.legend(frameon=False, fontsize=SMALL, ncols=2)
    bare(axes)
    return figure


def _bar(axes: Axes, ends: Array, around: tuple[float, float], row: int) -> None:
    """One interval; an open end reaches beyond all known ones and has an arrow."""
    center, reach = around
    low, high = np.where(np.isnan(ends), center + reach * np.array([-1.25, 1.25]), ends)
    axes.plot([low, high], [row, row], "-", color=COLOURS[row], linewidth=5, solid_capstyle="butt")
    for end, place, marker in zip(ends, (low, high), ("<", ">"), strict=True):
        if np.isnan(end):
            axes.plot(place, row, marker, color=COLOURS[row], markersize=9)
