"""The tables of the page, from the record."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from common.page import Cell, table
from common.spreads import median_range, spread

import identknee as ik

Row = Mapping[str, Any]

SWEEPS = {
    "shells_least_squares": "least squares, shells",
    "bounds_least_squares": "least squares, bounds",
    "shells_complex": "Complex, shells",
    "guesses_complex": "Complex, IG1-IG4",
}
CRITERIA = {
    "shells_least_squares": ("end within 0.5",),
    "shells_complex": (
        *("end within 0.25", "end within 0.5", "end within 1", "polished within 0.5"),
    ),
}
KINDS = ("minimum", "valley", "cliff", "start_failed")
# Ends of polishing that are the truth differ from it by rounding, in kN and %.
AT_TRUTH = 1e-3
# The paper's Table 3, as printed: mean error of stiffness [kN] and of reference strain [%].
PAPER = {"IG1": (0.15, 0.08), "IG2": (0.48, 0.35), "IG3": (1.05, 1.16), "IG4": (3.67, 1.25)}


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables of the page by the name of their place in it."""
    return {
        "guesses": guess_table(record),
        "ends": end_table(record),
        "radii": radius_table(record),
        "basins": basin_table(record),
        "cliffs": cliff_table(record),
        "cost": cost_table(record),
    }


def guess_table(record: Row) -> ik.report.Table:
    """What is at the ends from the paper's guesses."""
    body: list[tuple[Cell, ...]] = []
    for guess, (stiffness, strain) in PAPER.items():
        body.append((guess, "the paper, one run", stiffness, strain, *[None] * 5))
        for knee, part in record["knees"].items():
            row = part["parts"]["guesses_complex"]["guesses"][guess]
            n = len(row["objective"])
            body.append(
                (
                    guess,
                    f"{knee}, {n} runs",
                    median_range(spread(row["error_kN"])),
                    median_range(spread(row["error_pct"])),
                    *(row["kinds"].get(kind, 0) for kind in KINDS[:3]),
                    row["polished"].get("minimum", 0),
                    sum(x < AT_TRUTH for x in row["polished_error"]),
                )
            )
    return table(
        "Ends of Complex from the paper's guesses, and where exact derivatives lead",
        "guess; knee; stiffness error [kN]; reference strain error [%]; minima; stopped; cliffs; "
        "polished to a minimum; to the truth",
        body,
    )


def end_table(record: Row) -> ik.report.Table:
    """What is at the ends of all sweeps."""
    body: list[tuple[Cell, ...]] = []
    for knee, part, name, row in sweeps(record):
        polished = row["polished_outcomes"].get("minimum", 0)
        at_truth = sum(x["n_starts"] for x in row["basins"] if is_truth(part, x))
        body.append(
            (
                knee,
                SWEEPS[name],
                row["n_starts"],
                *(row["kinds"].get(kind, 0) for kind in KINDS),
                at_truth,
                polished - at_truth,
            )
        )
    return table(
        "What is at the ends of the searches",
        "knee; sweep; starts; minima; stopped; cliffs; no prediction at the start; "
        "polished to the truth; to another minimum",
        body,
    )


def radius_table(record: Row) -> ik.report.Table:
    """How close a start must be."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for name, criteria in CRITERIA.items():
            for criterion in criteria:
                row = part["parts"][name]["recovered"][criterion]["radii"]
                cells = (limits(row["0.9"]), limits(row["0.5"]))
                body.append((knee, SWEEPS[name].split(",")[0], criterion, *cells))
    return table(
        "How close to the truth a start must be, in kN and % (95 % limits)",
        "knee; optimizer; recovered means; nine of ten recover within; every second within",
        body,
    )


def basin_table(record: Row) -> ik.report.Table:
    """Basins of the sweeps over the bounds and what no start has shown."""
    body: list[tuple[Cell, ...]] = []
    for knee, part, name, row in sweeps(record):
        if name == "guesses_complex":
            continue
        unseen = row["unseen_mass"]
        for i, basin in enumerate(row["basins"][:5]):
            low, high = (100 * basin[f"share_{x}"] for x in ("lower", "upper"))
            body.append(
                (
                    knee,
                    SWEEPS[name],
                    f"{i + 1} of {row['n_basins']}{', the truth' if is_truth(part, basin) else ''}",
                    f"{basin['objective']:.3g}",
                    basin["n_starts"],
                    f"{100 * basin['share']:.2f} ({low:.2f} to {high:.2f})",
                    f"{percent(unseen['estimate'])} (at most {percent(unseen['upper'])})",
                )
            )
    return table(
        "Basins, with 95 % limits",
        "knee; sweep; basin; objective; starts; volume [%]; unseen mass [%]",
        body,
    )


def cliff_table(record: Row) -> ik.report.Table:
    """Cliffs on the straight paths to the truth."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        row = part["cliffs"]
        at = np.array(row["edge_distances"], dtype=np.float64)
        body.append(
            (
                knee,
                row["n_ways"],
                row["n_with_cliff"],
                f"{100 * row['share_lost']:.0f} %",
                *(f"{q:.2f}" for q in quantiles(at)),
                row["n_trials_lost"],
                ", ".join(list(row["trials_lost"])[:3]),
            )
        )
    return table(
        "Cliffs on straight paths from the truth to Sobol points of the bounds",
        "knee; paths; with a cliff; length without prediction; nearest [kN and %]; "
        "median [kN and %]; trials lost; most often",
        body,
    )


def cost_table(record: Row) -> ik.report.Table:
    """Time and simulations."""
    body: list[tuple[Cell, ...]] = []
    for knee, _, name, row in sweeps(record):
        tenths = row["seconds_per_start"]["by_tenth_of_starts"]
        body.append(
            (
                knee,
                SWEEPS[name],
                row["n_starts"],
                row["n_simulations"] + row["n_polishing"],
                f"{row['busy_s'] / 60:.1f}",
                f"{row['busy_s'] / row['n_starts']:.3g}",
                f"{min(tenths):.3g} to {max(tenths):.3g}",
                f"{row['longest_s']:.3g}",
            )
        )
    return table(
        "Time: of one worker, summed; by tenths of the starts in their order",
        "knee; sweep; starts; simulations; all [min]; a start [s]; a start, by tenths [s]; "
        "longest [s]",
        body,
    )


def sweeps(record: Row) -> list[tuple[str, Row, str, Row]]:
    """Knee, its part of the record, name of the sweep and its part."""
    return [
        (knee, part, name, part["parts"][name])
        for knee, part in record["knees"].items()
        for name in SWEEPS
        if name in part["parts"]
    ]


def is_truth(part: Row, basin: Row) -> bool:
    """Whether the minimum of a basin is the truth."""
    theta = [basin["parameters"][name] for name in part["parameters"]]
    return bool(np.abs(np.array(theta) - part["truth"]).max() < AT_TRUTH)


def limits(radius: list[float | None]) -> str:
    """A radius with its limits as text."""
    value, low, high = ("all tried" if x is None else f"{x:.2f}" for x in radius)
    return f"{value} ({low} to {high})"


def percent(share: float | None) -> str:
    """A share as text, in %."""
    return "-" if share is None else f"{100 * share:.2g}"


def quantiles(values: Any) -> tuple[float, float]:
    """Smallest and median; NaN without values."""
    return (float(values.min()), float(np.median(values))) if values.size else (np.nan, np.nan)
