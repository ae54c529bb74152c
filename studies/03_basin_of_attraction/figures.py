"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from basin_tables import tables
from common.page import draw_study
from matplotlib.figure import Figure

import identknee as ik
from identknee.report.sweep_figures import cliff_figure, plane_figure, recovery_figure

WELL_POSED = ("reference", "lenhart2015_stable")
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def figure_1(record: Row) -> Figure:
    """Recovery against the distance of the start."""
    panels = {}
    for knee in knees(record):
        parts = record["knees"][knee]["parts"]
        exact, box = parts["shells_least_squares"], parts["shells_complex"]
        panels[knee] = {
            "prediction at the start": drawn(exact["predicted"]),
            "least squares, to 0.5": drawn(exact["recovered"]["end within 0.5"]),
            "Complex, to 1.0": drawn(box["recovered"]["end within 1"]),
            "Complex, to 0.5": drawn(box["recovered"]["end within 0.5"]),
            "Complex, then least squares": drawn(box["recovered"]["polished within 0.5"]),
        }
    first = next(iter(record["knees"].values()))
    return recovery_figure(panels, first["guess_distances"])


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
    """Cliffs on the way from anywhere to the truth."""
    return cliff_figure(
        {
            knee: (numbers(row["cliffs"]["edge_distances"]), row["cliffs"]["n_ways"])
            for knee, row in record["knees"].items()
        },
        {knee: row["cliffs"]["trials_lost"] for knee, row in record["knees"].items()},
    )


def figure_5(record: Row) -> Figure:
    """Planes through the truth."""
    row = next(iter(record["knees"].values()))
    m = len(row["parameters"]) // 2
    names = [x.rpartition(".")[0] for x in row["parameters"][:m]]
    truth = {x: (row["truth"][i], row["truth"][m + i]) for i, x in enumerate(names)}
    planes = {
        knee: {
            ligament: (numbers(plane["values"]), numbers(plane["objectives"]))
            for ligament, plane in part["planes"].items()
        }
        for knee, part in record["knees"].items()
    }
    return plane_figure(planes, truth)


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


def drawn(shares: Row) -> tuple[list[float], list[list[float]]]:
    """Distances and rows of counts and limits."""
    return shares["distances"], shares["shares"]


def numbers(values: Any) -> ik.runs.Array:
    """An array; what JSON could not say is infinite."""
    array = np.array(values, dtype=np.float64)
    return np.where(np.isnan(array), np.inf, array)


if __name__ == "__main__":
    main()
