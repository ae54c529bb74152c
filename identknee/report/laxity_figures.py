"""Figures of laxity along load curves: measured, simulated, and bands around it."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from identknee.checks.data_noise import Curve, load_curves
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES
from identknee.laxity.trial_words import series_words
from identknee.report.canvas import Figure
from identknee.report.figures import BLACK, COLOURS, MARKERS, SMALL, STYLES, bare, legend_below
from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import declared, entry
from identknee.runs.words import label

# The coordinate that moves along each load.
ALONG = {
    "internal_moment_Nm": "internal_deg",
    "varus_moment_Nm": "varus_deg",
    "anterior_force_N": "anterior_drawer_mm",
    "distraction_force_N": "distraction_mm",
    "lateral_force_N": "lateral_shift_mm",
}


@declared
class LaxityCurves:
    """Laxity of n trials by its sources, in `COORDINATES` [mm, deg]."""

    protocol: Protocol = entry("The trials")
    simulated: Mapping[str, Array] = entry(
        "Simulated laxity by name of the model, shape ``(n, 5)``; NaN where it has no equilibrium"
    )
    measured: Array | None = entry(
        "Measured laxity, shape ``(n, 5)``; NaN where nothing was measured. None without data",
        default=None,
    )
    sd: Array | None = entry(
        "Standard deviation of the measurement, in the same shape; None where it is not stated",
        default=None,
    )
    band: tuple[str, Array] | None = entry(
        "Name of a band, and the lowest and highest prediction, shape ``(2, n, 5)``; None without "
        "one",
        default=None,
    )

    def __post_init__(self) -> None:
        shape = (self.protocol.n, len(COORDINATES))
        checked = {name: frozen(x, *shape, name=name) for name, x in self.simulated.items()}
        object.__setattr__(self, "simulated", checked)
        for name in ("measured", "sd"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name), *shape, name=name))


def along_load_figure(curves: LaxityCurves) -> Figure | None:
    """The coordinate along each load against that load, a row a load and a column an angle.

    Dots are measured, their bars two standard deviations; None where no angle has three loads of
    one kind.
    """
    cells = _least_combined(curves.protocol)
    if not cells:
        return None
    rows = sorted({axis for axis, _ in cells})
    settings = sorted({x for _, x in cells})
    size = (1.0 + 2.7 * len(settings), 0.7 + 2.5 * len(rows))
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(rows), len(settings), squeeze=False, sharex="row", sharey="row")
    for row, axis in enumerate(rows):
        coordinate = COORDINATES.index(ALONG[LOADS[axis]])
        for column, setting in enumerate(settings):
            axes = grid[row, column]
            if (axis, setting) not in cells:
                axes.set_visible(False)
                continue
            _draw(axes, curves, cells[axis, setting], coordinate)
            axes.set_xlabel(label(LOADS[axis]), fontsize=SMALL + 1)
            if row == 0:
                axes.set_title(_title(curves.protocol, setting), fontsize=10)
        grid[row, 0].set_ylabel(label(COORDINATES[coordinate]), fontsize=SMALL + 1)
    shown = next(x for x in grid.flat if x.get_visible())
    legend_below(figure, *shown.get_legend_handles_labels(), columns=9)
    return figure


def all_coordinates_figure(curves: LaxityCurves) -> Figure | None:
    """Every coordinate along every load curve, a column a curve; None where there is none."""
    cells = _least_combined(curves.protocol)
    if not cells:
        return None
    figure = Figure(figsize=(1.2 + 1.9 * len(cells), 1.0 + 8.0), layout="constrained")
    grid = figure.subplots(len(COORDINATES), len(cells), squeeze=False, sharex="col", sharey="row")
    for column, ((axis, setting), curve) in enumerate(sorted(cells.items(), key=lambda x: x[0])):
        for row in range(len(COORDINATES)):
            _draw(grid[row, column], curves, curve, row)
        grid[0, column].set_title(_title(curves.protocol, setting), fontsize=SMALL + 1)
        grid[-1, column].set_xlabel(label(LOADS[axis]), fontsize=SMALL)
    for row, coordinate in enumerate(COORDINATES):
        grid[row, 0].set_ylabel(label(coordinate), fontsize=SMALL)
    legend_below(figure, *grid[0, 0].get_legend_handles_labels(), columns=9)
    return figure


def by_flexion_figure(curves: LaxityCurves) -> Figure:
    """Every coordinate of every trial against flexion, for trials that make up no load curves.

    Lines join what was measured to what a model has for the same trial.
    """
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    grid = figure.subplots(2, 3, sharex=True)
    flexion = curves.protocol.flexion_deg
    for i, (axes, coordinate) in enumerate(zip(grid.flat, COORDINATES, strict=False)):
        for k, (name, values) in enumerate(curves.simulated.items()):
            axes.plot(
                flexion, values[:, i], MARKERS[k], color=COLOURS[k], markersize=5.0,
                markerfacecolor="none", label=name,
            )  # fmt: skip
            if curves.measured is not None:
                ends = curves.measured[:, i], values[:, i]
                axes.vlines(flexion, *ends, color=COLOURS[k], linewidth=0.7)
        if curves.measured is not None:
            axes.plot(
                flexion, curves.measured[:, i], "o", color=BLACK, markersize=3.0, label="measured"
            )
        axes.set_ylabel(label(coordinate), fontsize=SMALL + 1)
        axes.set_xlabel("flexion [deg]", fontsize=SMALL + 1)
        axes.tick_params(labelsize=SMALL, labelbottom=True)
        bare(axes)
    grid.flat[-1].remove()
    legend_below(figure, *grid.flat[0].get_legend_handles_labels(), columns=9)
    return figure


# Number of the experiment and state of trials, and their flexion angle.
Setting = tuple[int, float]


def _title(protocol: Protocol, setting: Setting) -> str:
    """Angle of the trials of a panel, and where there are several their experiment and state."""
    number, angle = setting
    trial = int(np.flatnonzero(protocol.series == number)[0])
    return "\n".join([f"{angle:g} deg flexion", *series_words(protocol, trial)])


def _least_combined(protocol: Protocol) -> dict[tuple[int, Setting], Curve]:
    """By load and setting its curve; of several the one with the least of the other loads."""
    cells: dict[tuple[int, Setting], tuple[float, Curve]] = {}
    series = protocol.series
    for curve in load_curves(protocol):
        loads = protocol.loads[curve.trials]
        axis = int(np.argmax(np.ptp(loads, axis=0)))
        first = curve.trials[0]
        key = axis, (int(series[first]), float(protocol.flexion_deg[first]))
        others = float(np.abs(np.delete(loads, axis, axis=1)).max(initial=0.0))
        if key not in cells or others < cells[key][0]:
            cells[key] = others, curve
    return {key: curve for key, (_, curve) in cells.items()}


def _draw(axes: Axes, curves: LaxityCurves, curve: Curve, i: int) -> None:
    trials = curve.trials
    if curves.band is not None:
        name, (low, high) = curves.band
        axes.fill_between(
            curve.load, low[trials, i], high[trials, i], color=COLOURS[5], alpha=0.4,
            linewidth=0, label=name,
        )  # fmt: skip
    for k, (name, values) in enumerate(curves.simulated.items()):
        axes.plot(
            curve.load, values[trials, i], STYLES[k], color=COLOURS[k], linewidth=1.6, label=name
        )
    if curves.measured is not None:
        bars = None if curves.sd is None else 2.0 * curves.sd[trials, i]
        axes.errorbar(
            curve.load, curves.measured[trials, i], yerr=bars, fmt="o", color=BLACK,
            markersize=3.0, elinewidth=0.8, label="measured",
        )  # fmt: skip
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.tick_params(labelsize=SMALL)
    bare(axes)
