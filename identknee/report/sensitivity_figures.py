"""Figures of a global sensitivity analysis, one function a figure."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from identknee.report.figures import COLOURS, GREY, MARKERS, SMALL, bare
from identknee.runs import words
from identknee.runs.arrays import Array

# From nothing to everything: dark means much, and grey prints tell the same.
MAP = "viridis_r"
COLUMNS = 2


def effects_figure(
    panels: Mapping[str, tuple[Array, Array, Array]], parameters: Sequence[str]
) -> Figure:
    """Spread of elementary effects against their mean size, a panel a group of outputs.

    Parameters
    ----------
    panels
        By name of the group, mean absolute effect, the half-width of its confidence interval and
        the standard deviation of the effects, in the unit of the outputs, shape ``(p,)`` each.
    parameters
        Their names.
    """
    n = len(panels)
    rows = -(-n // COLUMNS)
    figure = Figure(figsize=(9.0, 0.6 + 3.2 * rows), layout="constrained")
    grid = list(figure.subplots(rows, COLUMNS, squeeze=False).ravel())
    for axes in grid[n:]:
        axes.set_axis_off()
    figure, grid = (figure, grid)
    for axes, (name, (size, half_width, spread)) in zip(grid, panels.items(), strict=False):
        # One trajectory has no spread and no interval.
        far = np.concatenate([size + np.nan_to_num(half_width), spread])
        top = 1.12 * float(far[np.isfinite(far)].max(initial=1e-12))
        axes.plot([0, top], [0, top], color=GREY, linewidth=0.8, linestyle=":")
        for i, parameter in enumerate(parameters):
            axes.errorbar(
                size[i],
                spread[i],
                xerr=half_width[i],
                fmt=MARKERS[i % len(MARKERS)],
                color=COLOURS[i % len(COLOURS)],
                fillstyle="full" if i < len(COLOURS) else "none",
                capsize=2,
                label=words.label(parameter),
            )
        axes.set_xlim(0, top)
        axes.set_ylim(0, top)
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("mean absolute effect, mu*")
        axes.set_ylabel("sd of effects, sigma")
        bare(axes)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=SMALL
    )
    return figure


def map_figure(
    tables: Mapping[str, tuple[Sequence[str], Array]], parameters: Sequence[str], label: str
) -> Figure:
    """An index of every group of outputs to every parameter, a panel a coordinate.

    Parameters
    ----------
    tables
        By name of the coordinate, names of its rows and the index, shape ``(n_rows, p)``; NaN
        stays white.
    parameters
        Their names.
    label
        Name of the index.
    """
    rows = max(len(names) for names, _ in tables.values())
    figure = Figure(figsize=(1.8 + 2.1 * len(tables), 1.6 + 0.24 * rows), layout="constrained")
    grid = figure.subplots(1, len(tables), squeeze=False)[0]
    top = max(1.0, float(np.nanmax([np.nanmax(values) for _, values in tables.values()])))
    for column, (axes, (name, (names, values))) in enumerate(
        zip(grid, tables.items(), strict=True)
    ):
        image = axes.imshow(values, aspect="auto", cmap=MAP, vmin=0.0, vmax=top)
        axes.set_xticks(
            range(len(parameters)), [_short(x) for x in parameters], rotation=90, fontsize=SMALL
        )
        axes.set_yticks(range(len(names)), list(names) if column == 0 else [], fontsize=SMALL)
        axes.set_title(name, fontsize=9)
    figure.colorbar(image, ax=list(grid), label=label, shrink=0.8)
    return figure


def _short(parameter: str) -> str:
    """Owner and kind of a parameter: ``ACL stiffness`` for ``ACL.stiffness_kN``."""
    owner, _, kind = parameter.rpartition(".")
    letters = {"stiffness_kN": "stiffness", "reference_strain_pct": "strain"}
    return f"{owner} {letters.get(kind, kind)}"
