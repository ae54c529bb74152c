"""The tables of the page: ours from the record, beside the paper's as printed."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from common import published
from common.page import Cell, table
from common.rows_of_paper import error_table, start_table
from common.spreads import median_range, spread

import identknee as ik

Row = Mapping[str, Any]

# The paper's Tables 3, 4, 6 and 7, as printed.
PAPER_TABLE3 = {
    "IG1": ((0.15, 0.09), (0.08, 0.04)),
    "IG2": ((0.48, 0.23), (0.35, 0.19)),
    "IG3": ((1.05, 0.67), (1.16, 0.90)),
    "IG4": ((3.67, 2.46), (1.25, 0.76)),
}
PAPER_TABLE4 = {
    "anterior_drawer_mm": ((0.0, 0.2, 0.0), (0.2, 0.4, 0.3), (1.0, 0.8, 0.7), (1.0, 0.7, 0.5)),
    "internal_deg": ((0.1, 0.1, 0.1), (0.2, 0.1, 0.1), (0.6, 1.0, 1.1), (0.9, 1.0, 0.4)),
    "varus_deg": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), (0.5, 0.4, 0.2), (0.6, 0.5, 0.5)),
}
# By row; within it ACL, PCL, MCL, LCL; within these IG1, IG4 [N].
PAPER_TABLE6 = {
    "0 deg": ((278, 238), (32, 20), (155, 242), (384, 400)),
    "30 deg": ((237, 183), (63, 40), (160, 244), (293, 262)),
    "60 deg": ((409, 350), (263, 201), (141, 228), (191, 166)),
}
PAPER_TABLE7 = {
    "anterior force": ((373, 322), (65, 40), (95, 176), (63, 55)),
    "posterior force": ((153, 142), (212, 241), (99, 182), (42, 29)),
    "varus moment": ((271, 247), (124, 165), (88, 161), (85, 93)),
    "valgus moment": ((126, 93), (151, 124), (127, 210), (91, 85)),
    "external moment": ((237, 183), (263, 201), (114, 193), (67, 70)),
    "internal moment": ((409, 350), (53, 88), (141, 228), (293, 262)),
}
PAPER_LIGAMENTS = ("ACL", "PCL", "MCL", "LCL")
FORCE_STARTS = ("IG1", "IG4")


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables of the page by the name of their place in it."""
    profile = next(iter(record["knees"].values()))["profile"]
    return {
        "table 1": start_table(profile["ligaments"], profile["starts"], profile["truth"]),
        "table 3": table_3(record),
        "table 4": table_4(record),
        "table 5": table_5(record),
        "table 6": force_table(
            record,
            "tension_by_flexion_N",
            PAPER_TABLE6,
            "Largest differences of tension by flexion",
        ),
        "table 7": force_table(
            record,
            "tension_by_scenario_N",
            PAPER_TABLE7,
            "Largest differences of tension by load scenario",
        ),
        "tension": tension_table(record),
        "cost": cost_table(record),
        "least squares": least_squares_table(record),
        "branches": branch_table(record),
    }


def table_3(record: Row) -> ik.report.Table:
    """Mean absolute error and its standard deviation over the ligaments."""
    body: list[tuple[Cell, ...]] = []
    for start, (k, eps) in PAPER_TABLE3.items():
        body.append((start, "the paper, one run", *k, *eps, None, None))
        for knee, part in record["knees"].items():
            runs = rows(part, start)
            stiffness = np.array([row["error_kN"] for row in runs])
            strain = np.array([row["error_pct"] for row in runs])
            middles = [spread(x.mean(axis=1)) for x in (stiffness, strain)]
            scatters = [spread(x.std(axis=1, ddof=1)) for x in (stiffness, strain)]
            body.append(
                (
                    start,
                    f"{knee}, {len(runs)} runs",
                    median_range(middles[0]),
                    median_range(scatters[0]),
                    median_range(middles[1]),
                    median_range(scatters[1]),
                    f"{middles[0].ci_low:.2f} to {middles[0].ci_high:.2f}",
                    f"{middles[1].ci_low:.2f} to {middles[1].ci_high:.2f}",
                )
            )
    return table(
        "Table 3. Error of the parameters over the four ligaments: median [range] over runs",
        "start; knee; k mean [kN]; k sd [kN]; eps_r mean [%]; eps_r sd [%]; "
        "95 % of median k [kN]; 95 % of median eps_r [%]",
        body,
    )


def table_4(record: Row) -> ik.report.Table:
    """Kinematic error by start, coordinate and flexion angle."""
    body: list[tuple[Cell, ...]] = []
    for s, start in enumerate(PAPER_TABLE3):
        paper = [f"{x:.1f}" for by_start in PAPER_TABLE4.values() for x in by_start[s]]
        body.append((start, "the paper", *paper))
        for knee, part in record["knees"].items():
            errors = np.array([row["rmse_by_flexion"] for row in rows(part, start)])
            cells = [
                median_range(spread(errors[:, angle, ik.laxity.COORDINATES.index(coordinate)]))
                for coordinate in PAPER_TABLE4
                for angle in range(errors.shape[1])
            ]
            body.append((start, knee, *cells))
    heads = (("drawer", "mm"), ("internal", "deg"), ("varus", "deg"))
    return ik.report.Table(
        title="Table 4. Kinematic error (RMSE) by flexion angle: median [range] over runs",
        columns=(
            ik.report.Column(name="start"),
            ik.report.Column(name="knee"),
            *(
                ik.report.Column(name=f"{name} at {angle}", unit=unit)
                for name, unit in heads
                for angle in (0, 30, 60)
            ),
        ),
        rows=tuple(body),
    )


def table_5(record: Row) -> ik.report.Table:
    """Published kinematic errors and ours from IG4, medians over the runs."""
    chosen = [
        ik.laxity.COORDINATES.index(x) for x in ("internal_deg", "varus_deg", "anterior_drawer_mm")
    ]
    own: dict[str, ik.runs.Array] = {}
    for knee, part in record["knees"].items():
        errors = np.median([row["rmse_by_flexion"] for row in rows(part, "IG4")], axis=0)
        for angle, row in zip(part["profile"]["flexion_angles_deg"], errors, strict=True):
            own[f"{knee}, Complex from IG4, {angle:g} deg"] = row[chosen]
    return error_table(published.TABLE5, own)


def force_table(record: Row, key: str, paper: Row, title: str) -> ik.report.Table:
    """Largest differences of tension, a row a knee and angle or scenario [N]."""
    body: list[tuple[Cell, ...]] = []
    for i, (label, printed) in enumerate(paper.items()):
        body.append((label, "the paper", *(str(x) for pair in printed for x in pair)))
        for knee, part in record["knees"].items():
            ligaments = part["profile"]["ligaments"]
            cells = [
                median_range(
                    spread([row[key][i][ligaments.index(name)] for row in rows(part, start)]),
                    0,
                )
                for name in PAPER_LIGAMENTS
                for start in FORCE_STARTS
            ]
            body.append((label, knee, *cells))
    return table(
        f"{title}: median [range] over runs",
        [
            "trials",
            "knee",
            *(f"{name}, {start} [N]" for name in PAPER_LIGAMENTS for start in FORCE_STARTS),
        ],
        body,
    )


def tension_table(record: Row) -> ik.report.Table:
    """Largest tension itself at the truth, beside what the paper prints as differences."""
    body: list[tuple[Cell, ...]] = []
    for by, paper in (("flexion", PAPER_TABLE6), ("scenario", PAPER_TABLE7)):
        for i, (label, printed) in enumerate(paper.items()):
            body.append((label, "the paper, difference, IG1", *(pair[0] for pair in printed)))
            for knee, part in record["knees"].items():
                profile = part["profile"]
                largest = profile[f"largest_tension_by_{by}_N"][i]
                ligaments = profile["ligaments"]
                cells = [f"{largest[ligaments.index(name)]:.0f}" for name in PAPER_LIGAMENTS]
                body.append((label, f"{knee}, tension at the truth", *cells))
    return table(
        "Largest tension at the true parameters, beside the paper's differences",
        ["trials", "knee", *(f"{name} [N] | 0" for name in PAPER_LIGAMENTS)],
        body,
    )


def cost_table(record: Row) -> ik.report.Table:
    """How the Complex runs ended and what they cost."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for start in PAPER_TABLE3:
            runs = rows(part, start)
            ended = [row["outcome"] for row in runs]
            body.append(
                (
                    knee,
                    start,
                    ", ".join(f"{x} {ended.count(x)}" for x in sorted(set(ended))),
                    median_range(spread([row["n_simulations"] for row in runs]), 0),
                    median_range(spread([row["seconds"] for row in runs]), 1),
                    median_range(spread([row["rmse_mm"] for row in runs]), 3),
                    median_range(spread([row["rmse_deg"] for row in runs]), 3),
                )
            )
    return table(
        "How the Complex runs ended: median [range] over runs",
        "knee; start; outcomes; simulations; time [s]; RMSE [mm]; RMSE [deg]",
        body,
    )


def least_squares_table(record: Row) -> ik.report.Table:
    """Bounded least squares from the same starts, and from where the Complex runs ended."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        body += [(knee, row["start"], *_worst([row])) for row in part["least-squares"]]
        body.append(
            (
                knee,
                f"the {len(part['complex'])} ends of Complex",
                *_worst([row["polished"] for row in part["complex"]]),
            )
        )
    return table(
        "Least squares with the exact Jacobian: largest error of any parameter",
        "knee; from; outcomes; stiffness [kN] | g; reference strain [%] | g; most simulations; "
        "longest [s]",
        body,
    )


def branch_table(record: Row) -> ik.report.Table:
    """Trials that a single step puts elsewhere."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for name, counts in part["branches"].items():
            body.append(
                (
                    knee,
                    name,
                    counts["n_thetas"],
                    counts["n_trials"],
                    counts["other_branch"],
                    counts["single_step_failed"],
                    counts["canonical_failed"],
                    counts["both_failed"],
                    counts["thetas_with_another_branch"],
                )
            )
    return table(
        "Single step beside continuation, in trials",
        "knee; parameters; vectors; trials; another branch; only the single step failed; "
        "only continuation failed; both failed; vectors with another branch",
        body,
    )


def rows(part: Row, start: str) -> list[Row]:
    """Complex runs of a knee from one start."""
    return [row for row in part["complex"] if row["start"] == start]


def _worst(runs: list[Row]) -> tuple[Cell, ...]:
    ended = [row["outcome"] for row in runs]
    return (
        ", ".join(f"{x} {ended.count(x)}" for x in sorted(set(ended))),
        max(max(row["error_kN"]) for row in runs),
        max(max(row["error_pct"]) for row in runs),
        max(row["n_simulations"] for row in runs),
        max(row["seconds"] for row in runs),
    )
