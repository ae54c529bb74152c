"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from basin_tables import tables
from common.page import draw_study
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import identknee as ik
from identknee.report.figures import (
    BLACK,
    COLOURS,
    GREY,
    MARKERS,
    SMALL,
    STYLES,
    bare,
    legend_below,
    panel_rows,
)

WELL_POSED = ("reference", "lenhart2015_stable")
# Powers of ten over which objectives are coloured, and the colour of no prediction.
LOG_RANGE, LOST = (-2.0, 5.0), "#BBBBBB"
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def figure_1(record: Row) -> Figure:
    """Share of starts that recover against their distance, with its limits, a panel a knee."""
    figure, grid = panel_rows(len(knees(record)), (3.9, 3.5), (0.7, 0.0), len(knees(record)))
    guesses = next(iter(record["knees"].values()))["guess_distances"]
    for axes, knee in zip(grid, knees(record), strict=True):
        parts = record["knees"][knee]["parts"]
        exact, box = parts["shells_least_squares"], parts["shells_complex"]
        curves = {
            "prediction at the start": exact["predicted"],
            "least squares, to 0.5": exact["recovered"]["end within 0.5"],
            "Complex, to 1.0": box["recovered"]["end within 1"],
            "Complex, to 0.5": box["recovered"]["end within 0.5"],
            "Complex, then least squares": box["recovered"]["polished within 0.5"],
        }
        for guess, at in guesses.items():
            axes.axvline(at, color="0.85", linewidth=1.0, zorder=0)
            axes.text(at, 1.03, guess, ha="center", fontsize=SMALL, color=GREY)
        for k, (name, curve) in enumerate(curves.items()):
            counts = np.array(curve["shares"], float)
            share = counts[:, 0] / counts[:, 1]
            axes.errorbar(
                np.array(curve["distances"], float) + 0.04 * (k - 0.5 * (len(curves) - 1)),
                share,
                yerr=np.abs(counts[:, 2:].T - share),
                fmt=MARKERS[k] + STYLES[k % len(STYLES)],
                color=COLOURS[k],
                markersize=4,
                linewidth=1.2,
                capsize=2,
                label=name,
            )
        axes.set_ylim(-0.02, 1.0)
        axes.set_title(knee, fontsize=10, pad=16)
        axes.set_xlabel("distance of the start from the truth [kN and %]")
        bare(axes)
    grid[0].set_ylabel("share of starts")
    legend_below(figure, *grid[0].get_legend_handles_labels(), columns=3)
    return figure


def figure_2(record: Row) -> Figure:
    """Waterfalls of the Complex and of the least-squares sweeps."""
    panels = {}
    for knee in knees(record):
        for name, words in (
            ("shells_least_squares", "least squares"),
            ("shells_complex", "Complex"),
        ):
            fall = record["knees"][knee]["parts"][name]["waterfall"]
            panels[f"{knee}, {words}"] = {
                "end": (numbers(fall["number"]), numbers(fall["end"])),
                "polished": (numbers(fall["number"]), numbers(fall["polished"])),
            }
    return ik.report.waterfall_figure(panels)


def figure_3(record: Row) -> Figure:
    """Starts and ends on the first knee."""
    row = record["knees"]["reference"]
    panels = {}
    for name, words in (
        ("bounds_least_squares", "least squares, bounds"),
        ("shells_complex", "Complex, shells"),
    ):
        first = row["parts"][name]["first"]
        panels[words] = (numbers(first["starts"]), numbers(first["ends"]), first["kinds"])
    return ik.report.start_end_figure(panels, row["parameters"], row["truth"])


def figure_4(record: Row) -> Figure:
    """How near the truth the first cliff is, and which trials are lost there."""
    found = {knee: row["cliffs"] for knee, row in record["knees"].items()}
    figure = Figure(figsize=(3.6 + 2.9 * len(found), 3.8), layout="constrained")
    widths = [1.1] + [0.55] * len(found)
    first, *bars = figure.subplots(1, 1 + len(found), width_ratios=widths)
    for k, (axes, (knee, cliffs)) in enumerate(zip(bars, found.items(), strict=True)):
        at, n = np.array(cliffs["edge_distances"], float), cliffs["n_ways"]
        first.plot(
            np.r_[0.0, at],
            np.arange(len(at) + 1) / n,
            STYLES[k % len(STYLES)],
            color=COLOURS[k],
            drawstyle="steps-post",
            label=f"{knee}, {n} paths",
        )
        lost = dict(list(cliffs["trials_lost"].items())[:8])
        axes.barh(range(len(lost)), list(lost.values()), color=COLOURS[k])
        axes.set_yticks(range(len(lost)), [trial_words(x) for x in lost], fontsize=SMALL)
        axes.invert_yaxis()
        axes.set_title(knee, fontsize=9)
        axes.set_xlabel("paths", fontsize=9)
        bare(axes)
    first.set_xlabel("distance from the truth [kN and %]")
    first.set_ylabel("share of straight paths that met a cliff")
    first.set_ylim(0.0, 1.0)
    first.set_xlim(left=0.0)
    first.legend(frameon=False, fontsize=SMALL)
    bare(first)
    return figure


def trial_words(name: str) -> str:
    """Flexion and load of a trial, for example ``"60 deg, internal-10Nm"``."""
    return name.replace("flexion", "").replace("_", " deg, ", 1)


def figure_5(record: Row) -> Figure:
    """Objective over the two parameters of each ligament, and where there is no prediction."""
    row = next(iter(record["knees"].values()))
    m = len(row["parameters"]) // 2
    size = (1.6 + 2.3 * m, 0.8 + 2.3 * len(record["knees"]))
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(record["knees"]), m, squeeze=False, sharex=True, sharey=True)
    for place, (knee, part) in enumerate(record["knees"].items()):
        for j, (axes, (ligament, plane)) in enumerate(
            zip(grid[place], part["planes"].items(), strict=True)
        ):
            height = np.log10(np.maximum(numbers(plane["objectives"]), 10.0 ** LOG_RANGE[0]))
            axes.set_facecolor(LOST)
            drawn = axes.pcolormesh(
                *numbers(plane["values"]),
                np.ma.masked_invalid(height),
                vmin=LOG_RANGE[0],
                vmax=LOG_RANGE[1],
                cmap="viridis",
                rasterized=True,
            )
            truth = row["truth"][j], row["truth"][m + j]
            axes.plot(*truth, "+", color="#FFFFFF", markersize=11, markeredgewidth=1.8)
            axes.set_title("" if place else ligament, fontsize=10)
            axes.set_xlabel("stiffness [kN]" if place == len(grid) - 1 else "")
        grid[place, 0].set_ylabel(f"{knee}\nreference strain [%]", fontsize=9)
    figure.colorbar(drawn, ax=grid, shrink=0.8).set_label("log10 of the objective")
    handles: list[Artist] = [
        Patch(color=LOST, label="a trial has no equilibrium"),
        Line2D([], [], label="truth", linestyle="", marker="+", color=BLACK, markersize=11),
    ]
    legend_below(figure, handles, [str(x.get_label()) for x in handles])
    return figure


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_recovery": figure_1,
    "figure_2_waterfall": figure_2,
    "figure_3_start_to_end": figure_3,
    "figure_4_cliffs": figure_4,
    "figure_5_planes": figure_5,
}


def knees(record: Row) -> list[str]:
    """The well-posed knees of the record."""
    return [x for x in WELL_POSED if x in record["knees"]]


def numbers(values: Any) -> ik.runs.Array:
    """An array; what JSON could not say is infinite."""
    array = np.array(values, dtype=np.float64)
    return np.where(np.isnan(array), np.inf, array)


if __name__ == "__main__":
    main()
