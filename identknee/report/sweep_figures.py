"""Figures of sweeps: how low they end, from where they recover, where basins and cliffs are."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

from identknee.report.figures import BLACK, COLOURS, GREY, MARKERS, SMALL, STYLES
from identknee.runs.arrays import Array

# Objectives below this share of the axis are rounding; they are drawn at its foot.
LOWEST = 1e-12
LOST = "#BBBBBB"
LOG_RANGE = (-2.0, 5.0)
# More ends than these are a line without marks.
MOST_MARKED = 60
KIND_COLOURS = {
    "minimum": COLOURS[0],
    "valley": COLOURS[4],
    "cliff": COLOURS[1],
    "start_failed": GREY,
}
KIND_MARKERS = {"minimum": "o", "valley": "s", "cliff": "^", "start_failed": "x"}
KIND_WORDS = {
    "minimum": "minimum",
    "valley": "optimizer stopped",
    "cliff": "cliff",
    "start_failed": "no prediction at the start",
}


def waterfall_figure(panels: Mapping[str, Mapping[str, tuple[Array, Array]]]) -> Figure:
    """Objectives of all ends from low to high, a panel a sweep.

    Parameters
    ----------
    panels
        By title, and then by what is drawn (``"end"``, ``"polished"``): number of the end in their
        order, and its objective, shape ``(n,)``; infinite ones are left out.
    """
    figure, grid = _row(len(panels), width=2.6, height=3.2, sharey=True)
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
        _bare(axes)
    # A limit ends the scaling of all panels that share the axis.
    highest = max((float(np.max(x[np.isfinite(x)], initial=lowest)) for x in drawn), default=lowest)
    grid[0].set_ylim(0.3 * lowest, 3.0 * highest)
    grid[0].set_ylabel("objective" + " (below 1e-12 at 1e-12)" * (lowest <= LOWEST))
    grid[0].legend(frameon=False, fontsize=SMALL)
    return figure


def recovery_figure(
    panels: Mapping[str, Mapping[str, tuple[ArrayLike, ArrayLike]]],
    guesses: Mapping[str, float],
) -> Figure:
    """Share of starts that recover against their distance, with its limits, a panel a knee.

    Parameters
    ----------
    panels
        By title, and then by what is drawn: distances, shape ``(k,)``, and counts, numbers, lower
        and upper limits, shape ``(k, 4)``.
    guesses
        Distances to mark, by name.
    """
    figure, grid = _row(len(panels), width=3.9, height=3.5)
    for axes, (title, curves) in zip(grid, panels.items(), strict=True):
        for guess, at in guesses.items():
            axes.axvline(at, color="0.85", linewidth=1.0, zorder=0)
            axes.text(at, 1.03, guess, ha="center", fontsize=SMALL, color=GREY)
        for k, (name, (distances, rows)) in enumerate(curves.items()):
            counts = np.asarray(rows, float)
            share = counts[:, 0] / counts[:, 1]
            error = np.abs(counts[:, 2:].T - share)
            beside = np.asarray(distances, float) + 0.04 * (k - 0.5 * (len(curves) - 1))
            axes.errorbar(
                beside,
                share,
                yerr=error,
                fmt=MARKERS[k] + STYLES[k % len(STYLES)],
                color=COLOURS[k],
                markersize=4,
                linewidth=1.2,
                capsize=2,
                label=name,
            )
        axes.set_ylim(-0.02, 1.0)
        axes.set_title(title, fontsize=10, pad=16)
        axes.set_xlabel("distance of the start from the truth [kN and %]")
        _bare(axes)
    grid[0].set_ylabel("share of starts")
    _legend_below(figure, *grid[0].get_legend_handles_labels(), columns=3)
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
    m = len(parameters) // 2
    figure = Figure(figsize=(0.9 + 2.5 * m, 0.8 + 2.5 * len(panels)), layout="constrained")
    grid = figure.subplots(len(panels), m, squeeze=False, sharex="col", sharey="col")
    for row, (title, (starts, ends, kinds)) in enumerate(panels.items()):
        for j in range(m):
            axes, pair = grid[row, j], [j, m + j]
            _start_end(axes, np.asarray(starts)[:, pair], np.asarray(ends)[:, pair], kinds)
            axes.plot(*np.asarray(truth, float)[pair], "+", color=BLACK, markersize=11, zorder=5)
            axes.set_xlabel("stiffness [kN]" if row == len(panels) - 1 else "")
            axes.set_title(parameters[j].rpartition(".")[0] if row == 0 else "", fontsize=10)
            _bare(axes)
        grid[row, 0].set_ylabel(f"{title}\nreference strain [%]", fontsize=9)
    seen = [x for x in KIND_WORDS if any(x in kinds for _, _, kinds in panels.values())]
    marks = [_mark(KIND_MARKERS[x], KIND_COLOURS[x], KIND_WORDS[x]) for x in seen]
    ends_at = [
        _mark(".", BLACK, "end"),
        Line2D([], [], linestyle="", marker="+", color=BLACK, markersize=11, label=mark),
    ]
    handles: list[Artist] = [*marks, *ends_at]
    _legend_below(figure, handles, [str(x.get_label()) for x in handles])
    return figure


def cliff_figure(
    distances: Mapping[str, tuple[Array, int]], lost: Mapping[str, Mapping[str, int]]
) -> Figure:
    """How near the truth the first cliff is, and which trials are lost there.

    Parameters
    ----------
    distances
        By knee, distances of the nearest cliff on the ways that have one, ascending, shape
        ``(k,)``, and how many ways there are.
    lost
        By knee, on how many ways each trial is lost at that cliff, most first.
    """
    figure = Figure(figsize=(3.6 + 2.9 * len(lost), 3.8), layout="constrained")
    widths = [1.1] + [0.55] * len(lost)
    first, *bars = figure.subplots(1, 1 + len(lost), width_ratios=widths)
    for k, (knee, (at, n)) in enumerate(distances.items()):
        count = np.arange(1, len(at) + 1) / n
        style = STYLES[k % len(STYLES)]
        first.plot(
            np.r_[0.0, at], np.r_[0.0, count], style, color=COLOURS[k], drawstyle="steps-post",
            label=f"{knee}, {n} ways",
        )  # fmt: skip
    first.set_xlabel("distance from the truth [kN and %]")
    first.set_ylabel("share of straight ways that met a cliff")
    first.set_ylim(0.0, 1.0)
    first.set_xlim(left=0.0)
    first.legend(frameon=False, fontsize=SMALL)
    _bare(first)
    for k, (axes, (knee, trials)) in enumerate(zip(bars, lost.items(), strict=True)):
        names = list(trials)[:8]
        axes.barh(range(len(names)), [trials[x] for x in names], color=COLOURS[k])
        axes.set_yticks(range(len(names)), [_trial(x) for x in names], fontsize=SMALL)
        axes.invert_yaxis()
        axes.set_title(knee, fontsize=9)
        axes.set_xlabel("ways", fontsize=9)
        _bare(axes)
    return figure


def descent_figure(panels: Mapping[str, Mapping[str, Array]], counts: Sequence[int]) -> Figure:
    """Best objective so far against simulations, a panel a knee: median and the middle half.

    Parameters
    ----------
    panels
        By title, and then by optimizer: best objective of each search after so many simulations,
        shape ``(n_searches, k)``; infinite before the first prediction.
    counts
        The numbers of simulations, ascending, k of them.
    """
    figure, grid = _row(len(panels), width=4.2, height=3.9, sharey=True)
    for axes, (title, searches) in zip(grid, panels.items(), strict=True):
        for k, (name, best) in enumerate(searches.items()):
            # Sorted and not interpolated: half of them may be infinite.
            ordered = np.sort(np.maximum(best, LOWEST), axis=0)
            n = len(ordered)
            low, middle, high = (ordered[int(q * (n - 1))] for q in (0.25, 0.5, 0.75))
            known = np.isfinite(middle)
            at = np.asarray(counts, float)[known]
            axes.fill_between(
                at,
                low[known],
                np.minimum(high[known], 1e9),
                color=COLOURS[k],
                alpha=0.15,
                linewidth=0,
            )
            axes.plot(
                at, middle[known], MARKERS[k] + "-", color=COLOURS[k], markersize=3.5, label=name
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(0.3 * LOWEST, 1e5)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("simulations")
        _bare(axes)
    grid[0].set_ylabel("best objective so far (below 1e-12 at 1e-12)")
    _legend_below(figure, *grid[0].get_legend_handles_labels(), columns=6)
    return figure


def methods_figure(
    errors: Mapping[str, Mapping[str, Array]], printed: Mapping[str, tuple[float, float]]
) -> Figure:
    """Mean absolute errors by start and optimizer: stiffness on the left, strain on the right.

    Parameters
    ----------
    errors
        By optimizer and then by start: errors [kN] and [%], shape ``(n_runs, 2)``.
    printed
        By start, the paper's one run [kN, %].
    """
    figure, grid = _row(2, width=4.6, height=3.9)
    offsets = np.linspace(-0.36, 0.36, len(errors))
    for column, axes in enumerate(grid):
        for k, (method, by_start) in enumerate(errors.items()):
            for place, start in enumerate(printed):
                values = by_start[start][:, column]
                at = np.full(len(values), place + offsets[k])
                (points,) = axes.plot(at, values, MARKERS[k], color=COLOURS[k], label=method)
                points.set(markersize=4, alpha=0.8, clip_on=False)
        for place, paper in enumerate(printed.values()):
            axes.plot(
                [place - 0.45, place + 0.45], [paper[column]] * 2, color=BLACK, label="the paper"
            )
            axes.axvline(place + 0.5, color="0.9", linewidth=0.8)
        axes.set_xticks(range(len(printed)), list(printed))
        axes.set_ylim(bottom=0.0)
        _bare(axes)
    grid[0].set_ylabel("mean absolute error of stiffness [kN]")
    grid[1].set_ylabel("mean absolute error of reference strain [%]")
    handles, labels = grid[0].get_legend_handles_labels()
    first = {label: handle for handle, label in reversed(list(zip(handles, labels, strict=True)))}
    names = [*errors, "the paper"]
    _legend_below(figure, [first[x] for x in names], names, columns=4)
    return figure


def plane_figure(
    panels: Mapping[str, Mapping[str, tuple[Array, Array]]],
    truth: Mapping[str, tuple[float, float]],
) -> Figure:
    """Objective over the two parameters of each ligament, and where there is no prediction.

    Parameters
    ----------
    panels
        By title, a row each, and then by ligament: values of stiffness [kN] and reference strain
        [%], shape ``(2, n)``, and objectives, strain first, shape ``(n, n)``; not finite without a
        prediction.
    truth
        Stiffness and reference strain of each ligament.
    """
    m = len(truth)
    figure = Figure(figsize=(1.6 + 2.3 * m, 0.8 + 2.3 * len(panels)), layout="constrained")
    grid = figure.subplots(len(panels), m, squeeze=False, sharex=True, sharey=True)
    drawn = None
    for row, (title, planes) in enumerate(panels.items()):
        for axes, (ligament, (values, objectives)) in zip(grid[row], planes.items(), strict=True):
            height = np.log10(np.maximum(objectives, 10.0 ** LOG_RANGE[0]))
            known = np.ma.masked_invalid(height)
            axes.set_facecolor(LOST)
            drawn = axes.pcolormesh(
                *values,
                known,
                vmin=LOG_RANGE[0],
                vmax=LOG_RANGE[1],
                cmap="viridis",
                rasterized=True,
            )
            axes.plot(*truth[ligament], "+", color="#FFFFFF", markersize=11, markeredgewidth=1.8)
            axes.set_title(ligament if row == 0 else "", fontsize=10)
            axes.set_xlabel("stiffness [kN]" if row == len(panels) - 1 else "")
        grid[row, 0].set_ylabel(f"{title}\nreference strain [%]", fontsize=9)
    if drawn is not None:
        bar = figure.colorbar(drawn, ax=grid, shrink=0.8)
        bar.set_label("log10 of the objective")
    handles: list[Artist] = [
        Patch(color=LOST, label="a trial has no equilibrium"),
        Line2D([], [], linestyle="", marker="+", color=BLACK, markersize=11, label="truth"),
    ]
    _legend_below(figure, handles, [str(x.get_label()) for x in handles])
    return figure


def _start_end(axes: Axes, starts: Array, ends: Array, kinds: Sequence[str]) -> None:
    failed = np.array([kind == "start_failed" for kind in kinds])
    segments = np.stack([starts, ends], axis=1)[~failed]
    axes.add_collection(LineCollection(list(segments), colors="0.75", linewidths=0.4, zorder=1))
    for kind, marker in KIND_MARKERS.items():
        chosen = np.array([x == kind for x in kinds])
        axes.plot(
            *starts[chosen].T,
            marker,
            color=KIND_COLOURS[kind],
            markersize=3.5,
            linestyle="",
            alpha=0.8,
            zorder=2,
        )
    axes.plot(*ends[~failed].T, ".", color=BLACK, markersize=3.5, zorder=4)


def _trial(name: str) -> str:
    return name.replace("flexion", "").replace("_", " deg, ", 1)


def _mark(marker: str, colour: str, label: str) -> Line2D:
    return Line2D([], [], linestyle="", marker=marker, color=colour, label=label)


def _row(n: int, *, width: float, height: float, sharey: bool = False) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(0.7 + width * n, height), layout="constrained")
    return figure, list(figure.subplots(1, n, squeeze=False, sharey=sharey)[0])


def _legend_below(
    figure: Figure, handles: Sequence[Artist], labels: Sequence[str], columns: int = 5
) -> None:
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=min(len(labels), columns),
        frameon=False,
        fontsize=9,
    )


def _bare(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
