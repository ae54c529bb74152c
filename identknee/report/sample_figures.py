"""Figures of samples of the posterior, one function a figure."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.stats import gaussian_kde

from identknee.report.figures import BLACK, COLOURS, GREY, SMALL, STYLES
from identknee.runs.arrays import Array

COLUMNS = 4
BINS = 20
GRID = 200
# Shares of the draws inside the contours of a pair.
SHARES = (0.5, 0.95)


def prior_posterior_figure(
    names: Sequence[str],
    prior: Array,
    posteriors: "dict[str, Array]",
    *,
    truth: ArrayLike | None = None,
) -> Figure:
    """Density of each parameter before and after the data.

    Parameters
    ----------
    names
        Parameters.
    prior
        Draws of the prior, shape ``(k, n)``.
    posteriors
        Draws of one or more posteriors by name, shape ``(k, n)`` each.
    truth
        Known theta, shape ``(n,)``.
    """
    figure, panels = _panels(len(names), 2.2)
    for i, (axes, name) in enumerate(zip(panels, names, strict=True)):
        grid = np.linspace(*_range(prior[:, i], *(x[:, i] for x in posteriors.values())), GRID)
        before = gaussian_kde(prior[:, i])(grid)
        axes.fill_between(grid, before, color="0.85", linewidth=0, label="prior")
        for k, (label, draws) in enumerate(posteriors.items()):
            after = gaussian_kde(draws[:, i])(grid)
            axes.plot(grid, after, STYLES[k], color=COLOURS[k], linewidth=1.6, label=label)
        if truth is not None:
            axes.axvline(
                float(np.asarray(truth)[i]), color=BLACK, linewidth=1.0, label="true value"
            )
        axes.set_xlabel(_label(name), fontsize=SMALL)
        axes.set_yticks([])
        axes.set_ylim(bottom=0.0)
        axes.tick_params(labelsize=SMALL)
        axes.spines[["top", "right", "left"]].set_visible(False)
    _shared_legend(figure, panels[0])
    return figure


def corner_figure(names: Sequence[str], draws: Array, *, truth: ArrayLike | None = None) -> Figure:
    """Every pair of parameters with regions of 50 and 95 % of the draws, each on the diagonal.

    Parameters
    ----------
    names
        Parameters.
    draws
        Draws as good as independent, shape ``(k, n)``.
    truth
        Known theta, shape ``(n,)``.
    """
    n = len(names)
    known = None if truth is None else np.asarray(truth, float)
    figure = Figure(figsize=(1.0 + 1.06 * n, 1.0 + 0.96 * n), layout="constrained")
    grid = figure.subplots(n, n, squeeze=False, sharex="col")
    for row in range(n):
        for column in range(n):
            axes = grid[row, column]
            if column > row:
                axes.set_visible(False)
                continue
            if column == row:
                axes.hist(draws[:, row], BINS, color=COLOURS[0], alpha=0.5)
                axes.set_yticks([])
            else:
                across = draws[:, column]
                up = draws[:, row]
                points = np.vstack([across, up])
                estimate = gaussian_kde(points)
                levels = np.quantile(
                    estimate(points), [1.0 - share for share in sorted(SHARES, reverse=True)]
                )
                x, y = np.linspace(*_range(across), 50), np.linspace(*_range(up), 50)
                density = estimate(np.array(np.meshgrid(x, y)).reshape(2, -1)).reshape(50, 50)
                axes.plot(across, up, ".", color=GREY, markersize=1.0, alpha=0.5)
                axes.contour(x, y, density, levels=levels, colors=COLOURS[0], linewidths=0.9)
            if known is not None:
                axes.axvline(known[column], color=BLACK, linewidth=0.8)
                if column < row:
                    axes.axhline(known[row], color=BLACK, linewidth=0.8)
            axes.tick_params(labelsize=6)
            if row == n - 1:
                axes.set_xlabel(_stacked(names[column]), fontsize=7)
            if column == 0 and row > 0:
                axes.set_ylabel(_stacked(names[row]), fontsize=7)
            elif column < row:
                axes.set_yticklabels([])
    return figure


def forces_figure(
    trials: Sequence[str], ligaments: Sequence[str], quantiles: Array, *, truth: Array | None = None
) -> Figure:
    """How far each tension may be from its median: half and 95 % of the posterior, by trial.

    Parameters
    ----------
    trials
        Names.
    ligaments
        Names.
    quantiles
        Tension [N] at 2.5, 25, 50, 75 and 97.5 %, shape ``(trials, ligaments, 5)``. The medians
        stand beside their bars.
    truth
        Known tension [N], shape ``(trials, ligaments)``.
    """
    n = len(ligaments)
    figure = Figure(figsize=(1.6 + 2.3 * n, 1.4 + 0.28 * len(trials)), layout="constrained")
    panels = figure.subplots(1, n, squeeze=False, sharey=True, sharex=True)[0]
    rows = np.arange(len(trials))
    for j, axes in enumerate(panels):
        middle = quantiles[:, j, 2]
        low, first, _, third, high = (quantiles[:, j] - middle[:, None]).T
        axes.hlines(rows, low, high, color=COLOURS[0], linewidth=1.2, label="95 %")
        axes.hlines(rows, first, third, color=COLOURS[0], linewidth=4.5, label="50 %")
        if truth is not None:
            known = truth[:, j] - middle
            axes.plot(known, rows, "x", color=BLACK, markersize=5, label="true value")
        for row, median in zip(rows, middle, strict=True):
            axes.annotate(
                f"{median:.0f} N",
                (1.0, row),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="center",
                fontsize=7,
                color=GREY,
            )
        axes.set_title(ligaments[j], fontsize=10)
        axes.set_xlabel("tension minus median [N]", fontsize=SMALL)
        axes.tick_params(labelsize=SMALL)
        axes.grid(axis="y", color="0.93")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    largest = float(np.max(np.abs(quantiles - quantiles[..., 2:3])))
    # Room for the medians on the right.
    panels[0].set_xlim(-1.1 * largest, 1.8 * largest)
    panels[0].set_ylim(len(trials) - 0.4, -0.6)
    panels[0].set_yticks(rows, trials)
    _shared_legend(figure, panels[0])
    return figure


def _range(*samples: Array) -> tuple[float, float]:
    low = min(float(np.quantile(x, 0.001)) for x in samples)
    high = max(float(np.quantile(x, 0.999)) for x in samples)
    margin = 0.04 * (high - low)
    return low - margin, high + margin


def _panels(n: int, height: float) -> tuple[Figure, list[Axes]]:
    columns = min(COLUMNS, n)
    rows = -(-n // columns)
    figure = Figure(figsize=(0.6 + 2.2 * columns, 0.6 + height * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axes in grid[n:]:
        axes.set_visible(False)
    return figure, grid[:n]


def _shared_legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=len(labels), frameon=False, fontsize=9
    )


def _label(name: str) -> str:
    """A parameter's name with its unit in brackets."""
    words, _, unit = name.rpartition("_")
    units = {"kN": "kN", "pct": "%"}
    return f"{words.replace('.', ' ').replace('_', ' ')} [{units[unit]}]" if unit in units else name


def _stacked(name: str) -> str:
    """The same on two lines."""
    owner, _, rest = _label(name).partition(" ")
    return f"{owner}\n{rest}"
