"""Figures like those of the paper: laxity, parameters and their errors, one function a figure."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from common.published import PublishedLaxity
from identknee.mechanics.ligament_tensions import line_tensions
from identknee.report.figures import BLACK, COLOURS, GREY, MARKERS, SMALL, STYLES
from identknee.runs.declare import Array

SPREAD_SEED = 0
JITTER = 0.11


def evaluation_figure(
    published: Sequence[PublishedLaxity], models: Mapping[str, ArrayLike]
) -> Figure:
    """Measured laxity with its standard deviation, the paper's model, and further models.

    Parameters
    ----------
    published
        Rows of the paper's Table 2.
    models
        By name, the response to each load [mm or deg], shape ``(len(published),)``; NaN where a
        model has none.
    """
    figure = Figure(figsize=(8.2, 6.2), layout="constrained")
    axes = figure.add_subplot()
    rows = np.arange(len(published))
    mean, sd = (np.array([getattr(x, name) for x in published]) for name in ("mean", "sd"))
    axes.errorbar(
        mean, rows, xerr=sd, fmt="o", color=BLACK, capsize=3, label="measured, mean and sd"
    )
    printed = np.array([x.paper_model for x in published])
    axes.plot(printed, rows - 0.24, "X", color=GREY, label="the paper's model")
    offsets = np.linspace(0.18, 0.36, len(models))
    for k, (name, values) in enumerate(models.items()):
        y = rows + offsets[k]
        axes.plot(np.asarray(values, float), y, MARKERS[k + 1], color=COLOURS[k], label=name)
    axes.set_yticks(rows, [_load_label(x) for x in published])
    axes.invert_yaxis()
    axes.axvline(0.0, color="0.8", linewidth=0.8, zorder=0)
    axes.grid(axis="x", color="0.92")
    axes.set_axisbelow(True)
    axes.set_xlabel("response along the load [mm for forces, deg for moments]")
    figure.legend(loc="outside lower center", ncols=2 + len(models), frameon=False, fontsize=9)
    _bare(axes)
    return figure


def profile_figure(profiles: Mapping[str, tuple[Array, Array, Array]]) -> Figure:
    """Rotation against moment at each flexion angle, varus above internal, a column a knee.

    Parameters
    ----------
    profiles
        By name of the knee: flexion angle [deg], shape ``(n,)``; varus and internal moment [N·m],
        shape ``(n, 2)``; varus and internal rotation [deg], shape ``(n, 2)``.
    """
    figure = Figure(figsize=(1.0 + 3.8 * len(profiles), 6.4), layout="constrained")
    grid = figure.subplots(2, len(profiles), squeeze=False, sharex=True, sharey="row")
    for column, (name, (flexion, moments, rotations)) in enumerate(profiles.items()):
        for row in range(2):
            axes = grid[row, column]
            _profile(axes, flexion, moments[:, [row, 1 - row]], rotations[:, row])
            axes.set_xlabel(f"{('varus', 'internal')[row]} moment [N·m]")
        grid[0, column].set_title(name, fontsize=10)
    grid[0, 0].set_ylabel("varus rotation [deg]")
    grid[1, 0].set_ylabel("internal rotation [deg]")
    grid[0, 0].legend(title="flexion", frameon=False, fontsize=SMALL, title_fontsize=SMALL)
    return figure


def parameters_figure(
    ligaments: Sequence[str],
    truth: ArrayLike,
    starts: Mapping[str, ArrayLike],
    ends: Mapping[str, Mapping[str, Array]],
) -> Figure:
    """Fitted parameters of every run, by start, with the start and the true value.

    Parameters
    ----------
    ligaments
        Names, in the order of theta.
    truth
        True theta [kN, %], shape ``(2 m,)``.
    starts
        Theta of each start by name.
    ends
        By name of the knee and then of the start, theta of each run, shape ``(n_runs, 2 m)``.
    """
    m = len(ligaments)
    figure = Figure(figsize=(0.9 + 2.3 * m, 6.0), layout="constrained")
    grid = figure.subplots(2, m, squeeze=False, sharex=True)
    generator = np.random.default_rng(SPREAD_SEED)
    for j in range(2 * m):
        axes = grid[j // m, j % m]
        axes.axhline(float(np.asarray(truth)[j]), color=BLACK, linewidth=1.2, zorder=1)
        for s, (start, theta) in enumerate(starts.items()):
            axes.plot(s, np.asarray(theta)[j], "*", color="#C8102E", markersize=10, zorder=4)
            for k, (knee, by_start) in enumerate(ends.items()):
                values = by_start[start][:, j]
                middle = s + 0.36 * (k - 0.5 * (len(ends) - 1))
                across = middle + generator.uniform(-JITTER, JITTER, len(values))
                axes.plot(across, values, MARKERS[k], color=COLOURS[k], **_dot(knee))
        axes.set_xticks(range(len(starts)), list(starts))
        axes.set_xlim(-0.6, len(starts) - 0.4)
        _bare(axes)
        if j < m:
            axes.set_title(ligaments[j], fontsize=10)
    grid[0, 0].set_ylabel("stiffness [kN]")
    grid[1, 0].set_ylabel("reference strain [%]")
    handles = [
        *(
            Line2D([], [], linestyle="", marker=MARKERS[k], color=COLOURS[k], label=knee)
            for k, knee in enumerate(ends)
        ),
        Line2D([], [], linestyle="", marker="*", color="#C8102E", markersize=10, label="start"),
        Line2D([], [], color=BLACK, label="true value"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def error_figure(
    errors: Mapping[str, Mapping[str, Array]], printed: Mapping[str, tuple[float, float]]
) -> Figure:
    """Mean absolute error of every run by start: stiffness on the left, strain on the right.

    Parameters
    ----------
    errors
        By name of the knee and then of the start: errors [kN] and [%], shape ``(n_runs, 2)``.
    printed
        By start, the paper's one run [kN, %].
    """
    figure = Figure(figsize=(8.6, 3.9), layout="constrained")
    panels = figure.subplots(1, 2)
    generator = np.random.default_rng(SPREAD_SEED)
    for column, axes in enumerate(panels):
        for s, (start, paper) in enumerate(printed.items()):
            for k, (knee, by_start) in enumerate(errors.items()):
                values = by_start[start][:, column]
                middle = s + 0.36 * (k - 0.5 * (len(errors) - 1))
                across = middle + generator.uniform(-JITTER, JITTER, len(values))
                axes.plot(across, values, MARKERS[k], color=COLOURS[k], **_dot(knee))
                median = float(np.median(values))
                axes.plot([middle - 0.15, middle + 0.15], [median] * 2, color=BLACK, linewidth=1.4)
            axes.plot(s, paper[column], "X", color="#C8102E", markersize=9, zorder=4)
        axes.set_xticks(range(len(printed)), list(printed))
        axes.set_ylim(bottom=0.0)
        _bare(axes)
    panels[0].set_ylabel("mean absolute error of stiffness [kN]")
    panels[1].set_ylabel("mean absolute error of reference strain [%]")
    handles = [
        *(
            Line2D([], [], linestyle="", marker=MARKERS[k], color=COLOURS[k], label=knee)
            for k, knee in enumerate(errors)
        ),
        Line2D([], [], color=BLACK, label="median"),
        Line2D([], [], linestyle="", marker="X", color="#C8102E", markersize=9, label="the paper"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def force_strain_figure(
    ligaments: Sequence[str],
    truth: ArrayLike,
    ends: Mapping[str, Mapping[str, Array]],
    *,
    limits_pct: tuple[float, float] = (-10.0, 14.0),
) -> Figure:
    """Tension against elongation from the scanned pose: true, and the band of all runs by start.

    Elongation is counted from the length in the scanned pose, so that a curve shows both of a
    ligament's parameters: its reference strain moves it sideways, its stiffness is its slope.

    Parameters
    ----------
    ligaments
        Names, in the order of theta.
    truth
        True theta [kN, %], shape ``(2 m,)``.
    ends
        By name of the knee and then of the start, theta of each run, shape ``(n_runs, 2 m)``.
    limits_pct
        Range of elongation drawn [%].
    """
    m = len(ligaments)
    elongation = np.linspace(*limits_pct, 121)
    figure = Figure(figsize=(0.9 + 2.3 * m, 0.8 + 2.6 * len(ends)), layout="constrained")
    grid = figure.subplots(len(ends), m, squeeze=False, sharex=True, sharey="col")
    for row, (knee, by_start) in enumerate(ends.items()):
        for j, ligament in enumerate(ligaments):
            axes = grid[row, j]
            for k, (start, thetas) in enumerate(by_start.items()):
                curves = [_tension(elongation, theta[[j, m + j]]) for theta in thetas]
                low, middle, high = np.quantile(curves, [0.0, 0.5, 1.0], axis=0)
                axes.fill_between(elongation, low, high, color=COLOURS[k], alpha=0.22, linewidth=0)
                style = STYLES[k % len(STYLES)]
                axes.plot(elongation, middle, style, color=COLOURS[k], linewidth=1.5, label=start)
            true = _tension(elongation, np.asarray(truth, float)[[j, m + j]])
            axes.plot(elongation, true, color=BLACK, linewidth=1.2, label="true")
            if row == 0:
                axes.set_title(ligament, fontsize=10)
            _bare(axes)
        grid[row, 0].set_ylabel(f"{knee}\ntension [N]")
    figure.supxlabel("elongation from the scanned pose [%]", fontsize=10)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=len(labels), frameon=False, fontsize=9
    )
    return figure


def margin_figure(
    ramps: Sequence[tuple[str, Mapping[str, tuple[Array, Array, Array]]]], *, unit: str = "N·m"
) -> Figure:
    """Rotation and stability margin along ramps of load, a column a flexion angle.

    Parameters
    ----------
    ramps
        For each column its title, and by name of the knee: load, ascending; rotation [deg]; margin
        [N/mm]; shape ``(n,)`` each. Where the last two are NaN there is no equilibrium.
    unit
        Unit of the loads.
    """
    figure = Figure(figsize=(1.0 + 3.1 * len(ramps), 6.0), layout="constrained")
    grid = figure.subplots(2, len(ramps), squeeze=False, sharex=True, sharey="row")
    for column, (title, by_knee) in enumerate(ramps):
        upper, lower = grid[0, column], grid[1, column]
        for k, (knee, (load, rotation, margin)) in enumerate(by_knee.items()):
            for axes, values in ((upper, rotation), (lower, margin)):
                style = STYLES[k % len(STYLES)]
                axes.plot(load, values, style, color=COLOURS[k], label=knee, linewidth=1.6)
                for end in _inner_ends(values):
                    axes.plot(load[end], values[end], "X", color=COLOURS[k], markersize=8)
        upper.set_title(title, fontsize=10)
        lower.axhline(0.0, color=GREY, linewidth=0.8)
        lower.set_xlabel(f"internal moment [{unit}]")
        _bare(upper)
        _bare(lower)
    grid[0, 0].set_ylabel("internal rotation [deg]")
    grid[1, 0].set_ylabel("stability margin [N/mm]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    ends = Line2D([], [], linestyle="", marker="X", color=GREY, label="last converged load")
    figure.legend(
        handles=[*handles, ends],
        labels=[*labels, "last converged load"],
        loc="outside lower center",
        ncols=len(labels) + 1,
        frameon=False,
        fontsize=9,
    )
    return figure


def _inner_ends(values: Array) -> list[int]:
    """Where a curve ends before the axis does."""
    known = np.isfinite(values)
    pairs = enumerate(pairwise(known))
    return [i if before else i + 1 for i, (before, after) in pairs if before != after]


def _profile(axes: Axes, flexion: Array, moments: Array, rotation: Array) -> None:
    """`moments`: the one along the rotation, and the other, which must be zero."""
    for k, angle in enumerate(np.unique(flexion)):
        chosen = np.flatnonzero((flexion == angle) & (moments[:, 1] == 0.0))
        chosen = chosen[np.argsort(moments[chosen, 0])]
        axes.plot(
            moments[chosen, 0],
            rotation[chosen],
            marker=MARKERS[k],
            markersize=4,
            color=COLOURS[k],
            label=f"{angle:g} deg",
        )
    axes.xaxis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10], integer=True))
    axes.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
    axes.axvline(0.0, color="0.8", linewidth=0.8, zorder=0)
    _bare(axes)


def _tension(elongation_pct: Array, parameters: Array) -> Array:
    """Tension [N] of a ligament (stiffness [kN], reference strain [%]) so much longer."""
    stretch = (1.0 + elongation_pct / 100.0) * (1.0 + parameters[1] / 100.0)
    return line_tensions(stretch - 1.0, np.full(len(stretch), 1000.0 * parameters[0]))[0]


def _load_label(row: PublishedLaxity) -> str:
    unit = "N" if row.column.endswith("_N") else "N·m"
    return f"{row.load} {row.magnitude:g} {unit}, {row.flexion_deg:g} deg"


def _dot(label: str) -> dict[str, object]:
    return {"markersize": 3.6, "alpha": 0.7, "linestyle": "", "label": label, "zorder": 3}


def _bare(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
