"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from common.spreads import median_range, spread
from matplotlib.figure import Figure

import identknee as ik
from identknee.report.figures import BLACK, COLOURS, MARKERS, bare, legend_below, panel_rows

COUNTS = (1, 3, 5, 7, 10, 15, 20, 40, 70, 100, 150, 200, 300, 400, 600, 800, 1000, 1500, 2000, 2500)
KINDS = ("minimum", "valley", "cliff", "start_failed")
# The paper's Table 3, as printed: mean error of stiffness [kN] and of reference strain [%].
PAPER = {"IG1": (0.15, 0.08), "IG2": (0.48, 0.35), "IG3": (1.05, 1.16), "IG4": (3.67, 1.25)}
# Ends of polishing that are the truth differ from it by rounding, in kN and %.
AT_TRUTH = 1e-3
# Objectives below this are rounding; they are drawn at the foot of the axis.
LOWEST = 1e-12
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def figure_1(record: Row) -> Figure:
    """Best objective so far against simulations, a panel a knee: median and the middle half."""
    n = len(record["knees"])
    figure, grid = panel_rows(n, (4.2, 3.9), (0.7, 0.0), n, sharey=True)
    for axes, (knee, part) in zip(grid, record["knees"].items(), strict=True):
        for k, (method, rows) in enumerate(part["methods"].items()):
            best = np.array([row["best_after"] for row in rows], dtype=np.float64)
            # Sorted and not interpolated: half of them may be infinite.
            ordered = np.sort(np.maximum(best, LOWEST), axis=0)
            low, middle, high = (ordered[int(q * (len(best) - 1))] for q in (0.25, 0.5, 0.75))
            known = np.isfinite(middle)
            at, top = np.array(COUNTS, float)[known], np.minimum(high[known], 1e9)
            colour = COLOURS[k]
            axes.fill_between(at, low[known], top, color=colour, alpha=0.15, linewidth=0)
            style = MARKERS[k] + "-"
            axes.plot(at, middle[known], style, color=colour, markersize=3.5, label=method)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(0.3 * LOWEST, 1e5)
        axes.set_title(knee, fontsize=10)
        axes.set_xlabel("simulations")
        bare(axes)
    grid[0].set_ylabel("best objective so far (floor at 1e-12)")
    legend_below(figure, *grid[0].get_legend_handles_labels(), columns=6)
    return figure


def figure_2(record: Row) -> Figure:
    """Errors of all methods from the paper's guesses, on the first knee."""
    methods = next(iter(record["knees"].values()))["methods"]
    figure, grid = panel_rows(2, (4.6, 3.9), (0.7, 0.0), 2)
    offsets = np.linspace(-0.36, 0.36, len(methods))
    for column, (axes, error) in enumerate(zip(grid, ("error_kN", "error_pct"), strict=True)):
        for k, (method, rows) in enumerate(methods.items()):
            for place, guess in enumerate(PAPER):
                values = [x[error] for x in rows if x["start"] == guess]
                at = np.full(len(values), place + offsets[k])
                (points,) = axes.plot(at, values, MARKERS[k], color=COLOURS[k], label=method)
                points.set(markersize=4, alpha=0.8, clip_on=False)
        for place, paper in enumerate(PAPER.values()):
            ends = [place - 0.45, place + 0.45]
            axes.plot(ends, [paper[column]] * 2, color=BLACK, label="the paper")
            axes.axvline(place + 0.5, color="0.9", linewidth=0.8)
        axes.set_xticks(range(len(PAPER)), list(PAPER))
        axes.set_ylim(bottom=0.0)
        bare(axes)
    grid[0].set_ylabel("mean absolute error of stiffness [kN]")
    grid[1].set_ylabel("mean absolute error of reference strain [%]")
    handles, labels = grid[0].get_legend_handles_labels()
    first = {label: handle for handle, label in reversed(list(zip(handles, labels, strict=True)))}
    names = [*methods, "the paper"]
    legend_below(figure, [first[x] for x in names], names, columns=4)
    return figure


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_descent": figure_1,
    "figure_2_errors": figure_2,
}


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables of the page by the name of their place in it."""
    return {"methods": method_table(record), "guesses": guess_table(record)}


def method_table(record: Row) -> ik.report.Table:
    """All starts of a knee together, a row a method."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for method, rows in part["methods"].items():
            kinds = [row["kind"] for row in rows]
            at_truth = sum(row["polished_error"] < AT_TRUTH for row in rows)
            body.append(
                (
                    knee,
                    method,
                    len(rows),
                    *(kinds.count(kind) for kind in KINDS),
                    at_truth,
                    median_range(spread([row["error_kN"] for row in rows])),
                    median_range(spread([row["error_pct"] for row in rows])),
                    median_range(spread(np.array([row["rmse_deg"] for row in rows], float)), 3),
                    median_range(spread([row["n_simulations"] for row in rows]), 0),
                    median_range(spread([row["seconds"] for row in rows])),
                )
            )
    return table(
        "All optimizers from the same starts, 2,500 simulations each: median [range]",
        [
            *("knee", "optimizer", "starts", "minima", "stopped"),
            *("cliffs", "no prediction", "polished to the truth"),
            "k error [kN]",
            "reference strain error [%]",
            "RMSE [deg]",
            "simulations",
            "time [s]",
        ],
        body,
    )


def guess_table(record: Row) -> ik.report.Table:
    """Errors by guess, beside the paper's."""
    body: list[tuple[Cell, ...]] = [
        ("the paper, Complex, one run", "-", *(f"{k:.2f}, {eps:.2f}" for k, eps in PAPER.values()))
    ]
    for knee, part in record["knees"].items():
        for method, rows in part["methods"].items():
            cells = []
            for guess in PAPER:
                of_guess = [row for row in rows if row["start"] == guess]
                fields = ("error_kN", "error_pct")
                middle = [np.median([row[field] for row in of_guess]) for field in fields]
                cells.append(f"{middle[0]:.2f}, {middle[1]:.2f}")
            body.append((method, knee, *cells))
    return table(
        "Mean error from the paper's guesses, kN and %: median over seeds",
        ["optimizer", "knee", *PAPER],
        body,
    )


if __name__ == "__main__":
    main()
