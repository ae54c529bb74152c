"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import draw_study
from common.paper_figures import (
    error_figure,
    force_strain_figure,
    parameters_figure,
    profile_figure,
)
from common.records import study_knee
from matplotlib.figure import Figure
from paper_tables import PAPER_TABLE3, rows, tables

import identknee as ik

Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def figure_1(record: Row) -> Figure:
    """The knees in their scanned pose."""
    knees = [study_knee(name) for name in record["knees"]]
    figure = Figure(figsize=(5.4 * len(knees), 5.8), layout="constrained")
    for axes, knee in zip(figure.subplots(1, len(knees), squeeze=False)[0], knees, strict=True):
        ik.report.draw_scene(axes, knee, ik.report.view_from(215.0, 12.0))
        axes.set_title(knee.name, fontsize=10)
    return figure


def figure_2(record: Row) -> Figure:
    """The laxity profile of the synthetic data."""
    moments = [
        ik.laxity.LOADS.index("varus_moment_Nm"),
        ik.laxity.LOADS.index("internal_moment_Nm"),
    ]
    rotations = [
        ik.laxity.COORDINATES.index("varus_deg"),
        ik.laxity.COORDINATES.index("internal_deg"),
    ]
    profiles = {}
    for name, part in record["knees"].items():
        profile = part["profile"]
        loads = np.array(profile["loads"])
        chosen = ~np.delete(loads, moments, axis=1).any(axis=1)
        profiles[name] = (
            np.array(profile["flexion_deg"])[chosen],
            loads[chosen][:, moments],
            np.array(profile["at_truth"])[chosen][:, rotations],
        )
    return profile_figure(profiles)


def figure_3(record: Row) -> Figure:
    """Optimised parameters of every Complex run."""
    profile = next(iter(record["knees"].values()))["profile"]
    return parameters_figure(
        profile["ligaments"], profile["truth"], profile["starts"], ends(record)
    )


def figure_4(record: Row) -> Figure:
    """Force against elongation with the optimised parameters."""
    profile = next(iter(record["knees"].values()))["profile"]
    return force_strain_figure(profile["ligaments"], profile["truth"], ends(record))


def figure_5(record: Row) -> Figure:
    """Errors of every Complex run beside the paper's one run."""
    errors = {
        knee: {start: mean_errors(rows(part, start)) for start in PAPER_TABLE3}
        for knee, part in record["knees"].items()
    }
    return error_figure(errors, {x: (k[0], eps[0]) for x, (k, eps) in PAPER_TABLE3.items()})


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_knees": figure_1,
    "figure_2_laxity_profile": figure_2,
    "figure_3_optimised_parameters": figure_3,
    "figure_4_force_strain": figure_4,
    "figure_5_parameter_errors": figure_5,
}


def ends(record: Row) -> dict[str, dict[str, ik.runs.Array]]:
    """Theta of every Complex run, by knee and start."""
    return {
        knee: {
            start: np.array([row["theta"] for row in rows(part, start)]) for start in PAPER_TABLE3
        }
        for knee, part in record["knees"].items()
    }


def mean_errors(runs: list[Row]) -> ik.runs.Array:
    """Mean absolute errors [kN], [%] of each run, shape ``(n_runs, 2)``."""
    return np.array([[np.mean(row["error_kN"]), np.mean(row["error_pct"])] for row in runs])


if __name__ == "__main__":
    main()
