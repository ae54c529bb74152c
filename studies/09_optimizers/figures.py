"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from matplotlib.figure import Figure

import identknee as ik
from identknee.report.sweep_figures import descent_figure, methods_figure

COUNTS = (1, 3, 5, 7, 10, 15, 20, 40, 70, 100, 150, 200, 300, 400, 600, 800, 1000, 1500, 2000, 2500)
KINDS = ("minimum", "valley", "cliff", "start_failed")
# The paper's Table 3, as printed: mean error of stiffness [kN] and of reference strain [%].
PAPER = {"IG1": (0.15, 0.08), "IG2": (0.48, 0.35), "IG3": (1.05, 1.16), "IG4": (3.67, 1.25)}
# Ends of polishing that are the truth differ from it by rounding, in kN and %.
AT_TRUTH = 1e-3
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def figure_1(record: Row) -> Figure:
    """Descent of all methods."""
    return descent_figure(
        {
            knee: {
                method: np.array([row["best_after"] for row in rows], dtype=np.float64)
                for method, rows in part["methods"].items()
            }
            for knee, part in record["knees"].items()
        },
        COUNTS,
    )


def figure_2(record: Row) -> Figure:
    """Errors of all methods from the paper's guesses, on the first knee."""
    part = next(iter(record["knees"].values()))
    errors = {
        method: {
            guess: np.array(
                [[x["error_kN"], x["error_pct"]] for x in rows if x["start"] == guess], float
            )
            for guess in PAPER
        }
        for method, rows in part["methods"].items()
    }
    return methods_figure(errors, PAPER)


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
                    ik.report.median_range(ik.report.spread([row["error_kN"] for row in rows])),
                    ik.report.median_range(ik.report.spread([row["error_pct"] for row in rows])),
                    ik.report.median_range(
                        ik.report.spread(np.array([row["rmse_deg"] for row in rows], float)), 3
                    ),
                    ik.report.median_range(
                        ik.report.spread([row["n_simulations"] for row in rows]), 0
                    ),
                    ik.report.median_range(ik.report.spread([row["seconds"] for row in rows])),
                )
            )
    return table(
        "All optimizers from the same starts, 2,500 simulations each: median [range]",
        [
            *("knee", "optimizer", "starts", "minima", "stopped"),
            *("cliffs", "no prediction", "polished to the truth"),
            "k error [kN]",
            "eps_r error [%]",
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
