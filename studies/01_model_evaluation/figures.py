"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import published
from common.page import draw_study, table
from common.paper_figures import evaluation_figure, margin_figure
from common.rows_of_paper import laxity_table
from matplotlib.figure import Figure

import identknee as ik

WELL_POSED = ("reference", "lenhart2015_stable")
INTERNAL = ik.laxity.COORDINATES.index("internal_deg")
UNITS = {"N": "N", "Nm": "N·m"}
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def figure_1(record: Row) -> Figure:
    """Table 2: the measurements, the paper's model and the well-posed knees."""
    return evaluation_figure(published.TABLE2, responses(record, WELL_POSED))


def figure_2(record: Row) -> Figure:
    """Rotation and stability margin under internal and external moments."""
    columns = []
    for flexion in (0.0, 30.0, 60.0):
        by_knee = {
            name: whole_ramp(part["ramps"], flexion) for name, part in record["knees"].items()
        }
        columns.append((f"{flexion:g} deg flexion", by_knee))
    return margin_figure(columns)


def whole_ramp(
    ramps: list[Row], flexion: float
) -> tuple[ik.runs.Array, ik.runs.Array, ik.runs.Array]:
    """Internal moment, ascending, with internal rotation and margin."""
    parts = []
    for ramp in ramps:
        if ramp["load"] == "internal_moment_Nm" and ramp["flexion_deg"] == flexion:
            load = np.array(ramp["load_values"])
            rotation = np.array(ramp["coordinates"], float)[:, INTERNAL]
            parts.append(np.stack([load, rotation, np.array(ramp["margin_N_per_mm"], float)]))
    joined = np.concatenate(parts, axis=1)
    # Both ramps begin unloaded.
    _, first = np.unique(joined[0], return_index=True)
    load, rotation, margin = joined[:, first]
    return load, rotation, margin


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_table_2": figure_1,
    "figure_2_internal_rotation_folds": figure_2,
}


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables of the page by the name of their place in it."""
    return {
        "table 2": laxity_table(published.TABLE2, responses(record, WELL_POSED)),
        "raw centroids": raw_table(record),
        "ends": ends_table(record),
        "single step": single_step_table(record),
    }


def responses(record: Row, names: tuple[str, ...]) -> dict[str, ik.runs.Array]:
    """Response to each load of Table 2 by knee, NaN where there is none."""
    knees = record["knees"]
    return {x: np.array(knees[x]["table2"]["response"], float) for x in names if x in knees}


def raw_table(record: Row) -> ik.report.Table:
    """How the 63 trials end, a row a knee."""
    return table(
        "How the 63 trials of seed63 end",
        "knee; outcomes; lowest margin of a converged trial [N/mm]; "
        "lowest margin along the fine ramps [N/mm]; "
        "largest change of Table 2 with all vertices [mm or deg] | 3",
        (
            (
                name,
                ", ".join(f"{key} {n}" for key, n in part["seed63"]["outcomes"].items()),
                part["seed63"]["lowest_margin_N_per_mm"],
                min(np.nanmin(np.array(x["margin_N_per_mm"], float)) for x in part["ramps"]),
                vertex_change(part),
            )
            for name, part in record["knees"].items()
        ),
    )


def vertex_change(part: Row) -> float:
    """Largest change of the response to Table 2 when every vertex is a contact point."""
    default = np.array(part["table2"]["response"], float)
    whole = np.array(part["contact_points"]["response_all_vertices"], float)
    return float(np.nanmax(np.abs(default - whole)))


def ends_table(record: Row) -> ik.report.Table:
    """Ramps that do not reach their full load, with the last stable pose of each."""
    rows = tuple(
        (
            name,
            ramp["load"].rsplit("_", 1)[0].replace("_", " "),
            ramp["flexion_deg"],
            ramp["outcome"],
            ramp["first_failing_trial"],
            f"{ramp['last_stable_load']:.2f} {UNITS[ramp['load'].rsplit('_', 1)[1]]}",
            ramp["last_stable_margin_N_per_mm"],
            *ramp["last_stable_pose"],
        )
        for name, part in record["knees"].items()
        for ramp in part["ramps"]
        if ramp["outcome"] != "converged"
    )
    return ik.report.Table(
        title="Ramps that end before their full load, and their last stable pose",
        columns=(
            ik.report.Column(name="knee"),
            ik.report.Column(name="load"),
            ik.report.Column(name="flexion", unit="deg", decimals=0),
            ik.report.Column(name="outcome"),
            ik.report.Column(name="first trial lost"),
            ik.report.Column(name="last stable load"),
            ik.report.Column(name="margin there", unit="N/mm"),
            *(
                ik.report.Column(
                    name=name.rsplit("_", 1)[0].replace("_", " "), unit=name.rsplit("_", 1)[1]
                )
                for name in ik.laxity.COORDINATES
            ),
        ),
        rows=rows,
    )


def single_step_table(record: Row) -> ik.report.Table:
    """Trials of seed63 that continuation loses, and what a single step makes of them."""
    rows = tuple(
        (
            name,
            row["trial"],
            row["outcome"],
            row["single_step_outcome"],
            row["single_step_coordinates"][INTERNAL],
            row["single_step_coordinates"][ik.laxity.COORDINATES.index("varus_deg")],
        )
        for name, part in record["knees"].items()
        for row in part["seed63"]["not_converged"]
    )
    return table(
        "Trials of seed63 that continuation loses, and the pose a single step finds",
        "knee; trial; by continuation; in a single step; internal rotation then [deg] | 1; "
        "varus then [deg] | 1",
        rows,
    )


if __name__ == "__main__":
    main()
