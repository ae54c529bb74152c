"""The tables of the page, from the record."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from common.page import Cell, table

import identknee as ik
from identknee.runs.words import label

Row = Mapping[str, Any]
STIFFNESS = "stiffness_kN"


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables of the page by the name of their place in it."""
    return {
        "parameters": parameter_table(record),
        "noises": noise_table(record),
        "forces": force_table(record),
        "untested": untested_table(record),
        "cost": cost_table(record),
    }


def parameter_table(record: Row) -> ik.report.Table:
    """The 95 % set of every parameter at the study's noise."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for row, truth in zip(part["profiles"], part["truth"], strict=True):
            body.append(
                (
                    knee,
                    label(row["name"]),
                    truth,
                    row["optimum_value"],
                    _end(row["intervals"][0][0]),
                    _end(row["intervals"][-1][1]),
                    row["verdict"].replace("_", " "),
                    str(row["n_simulations"]),
                )
            )
    return table(
        "95 % sets of the parameters, one data set, 0.5 mm and 0.5 deg",
        "knee; parameter; truth | 1; best; lower; upper; verdict; simulations",
        body,
    )


def noise_table(record: Row) -> ik.report.Table:
    """Share of data sets in which a parameter has an open end, and its median width elsewhere."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for i, name in enumerate(part["parameters"]):
            cells = [
                _open_or_wide([x for x in part["noises"] if x["noise"] == noise], i)
                for noise in record["head"]["settings"]["noises_mm_deg"]
            ]
            body.append((knee, label(name), *cells))
    return table(
        "Half-width of the 95 % set (median over data sets), and the data sets in which it is open",
        [
            "knee",
            "parameter",
            *(f"{x:g} mm, deg" for x in record["head"]["settings"]["noises_mm_deg"]),
        ],
        body,
    )


def force_table(record: Row) -> ik.report.Table:
    """How well forces are known where their parameters are not."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for ligament in dict.fromkeys(x["ligament"] for x in part["forces"]):
            rows = [x for x in part["forces"] if x["ligament"] == ligament]
            loaded = [x for x in rows if x["value"] > 0 and None not in (x["lower"], x["upper"])]
            half = [0.5 * (x["upper"] - x["lower"]) for x in loaded]
            share = [100 * h / x["value"] for h, x in zip(half, loaded, strict=True)]
            stiffness = _stiffness_share(part, ligament)
            body.append(
                (
                    knee,
                    ligament,
                    str(len(rows)),
                    str(sum(x["value"] == 0 for x in rows)),
                    str(sum(None in (x["lower"], x["upper"]) for x in rows)),
                    float(np.median(half)) if half else None,
                    float(np.median(share)) if share else None,
                    stiffness,
                )
            )
    return table(
        "95 % sets of ligament forces in the tested trials",
        "knee; ligament; trials; slack; open; median half-width [N] | 1; "
        "share of the force [%] | 1; half-width of the stiffness [%] | 0",
        body,
    )


def untested_table(record: Row) -> ik.report.Table:
    """Laxity under loads that the data lack."""
    body: list[tuple[Cell, ...]] = [
        (knee, row["trial"], row["truth"], row["value"], _end(row["lower"]), _end(row["upper"]))
        for knee, part in record["knees"].items()
        for row in part["untested"]
    ]
    return table(
        "95 % sets of the anterior drawer under forces that were not tested [mm]",
        "knee; trial; truth; best; lower; upper",
        body,
    )


def cost_table(record: Row) -> ik.report.Table:
    """Simulations a profile takes, by noise."""
    body: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for noise in record["head"]["settings"]["noises_mm_deg"]:
            rows = [x for x in part["noises"] if x["noise"] == noise]
            costs = np.concatenate([x["n_simulations"] for x in rows])
            points = np.concatenate([x["n_points"] for x in rows])
            body.append(
                (
                    knee,
                    f"{noise:g}",
                    str(len(costs)),
                    f"{np.mean(costs):.0f}",
                    f"{np.min(costs)} to {np.max(costs)}",
                    f"{np.median(points):.0f}",
                )
            )
    return table(
        "Simulations of a full profile, each with its exact Jacobian",
        "knee; noise [mm, deg]; profiles; mean; range; points (median)",
        body,
    )


def _open_or_wide(rows: list[Row], i: int) -> str:
    ends = [(x["lower"][i], x["upper"][i]) for x in rows]
    closed = [0.5 * (high - low) for low, high in ends if low is not None and high is not None]
    n_open = len(ends) - len(closed)
    width = f"{np.median(closed):.2f}" if closed else "-"
    return f"{width}, open in {n_open} of {len(ends)}" if n_open else width


def _stiffness_share(part: Row, ligament: str) -> float | None:
    for row in part["profiles"]:
        if row["name"] == f"{ligament}.{STIFFNESS}":
            low, high = row["intervals"][0]
            if low is None or high is None:
                return None
            return float(100 * 0.5 * (high - low) / row["optimum_value"])
    return None


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.2f}"
