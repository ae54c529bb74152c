"""The tables of the page's last part: what the paper could not know, from the records."""

from collections.abc import Callable, Mapping
from typing import Any

from common.page import table
from other_studies import module_of
from page_tables import (
    BASINS,
    CHECKS,
    EQUIVALENTS,
    EVALUATION,
    GAP,
    OPTIMIZERS,
    PROFILES,
    Found,
    not_yet,
)

import identknee as ik
from identknee.runs.words import label

# Ends of polishing that are the truth differ from it by rounding, in kN and %.
AT_TRUTH = 1e-3
SHELLS = {"least squares": "shells_least_squares", "Complex": "shells_complex"}
CRITERION = "end within 0.5"
NOISE = "0.5 mm, 0.5 deg"
MARKS = {"bound": "\\*", "cliff": "†", "budget": "‡"}
Row = Mapping[str, Any]


def beyond(found: Found) -> dict[str, ik.report.Table | str]:
    """All tables of that part by the name of their place in it."""
    made: dict[str, ik.report.Table | str] = {}
    for name, (study, draw) in TABLE_OF.items():
        record = found[study]
        made[name] = not_yet(study) if record is None else draw(record)
    return made


def end_table(record: Row) -> ik.report.Table:
    """What is at the ends of the Complex method, and where exact derivatives lead from there."""
    body = []
    for knee, part in record["knees"].items():
        for name, row in part["parts"].items():
            if not name.endswith("_complex"):
                continue
            kinds, polished = row["kinds"], row["polished_outcomes"].get("minimum", 0)
            n = row["n_starts"] - kinds.get("start_failed", 0)
            at_truth = sum(x["n_starts"] for x in row["basins"] if is_truth(part, x))
            counts = [kinds.get(x, 0) for x in ("minimum", "valley", "cliff")]
            body.append((knee, STARTS[name], n, *counts, at_truth, polished - at_truth))
    heads = ("knee", "starts", "ends", "minima", "open slope", "cliffs")
    return table(
        "Ends of the Complex method, as left and after least squares went on from there",
        [*heads, "polished to the truth", "polished to another minimum"],
        body,
    )


def radius_table(record: Row) -> ik.report.Table:
    """How close a start must be."""
    body = []
    for knee, part in record["knees"].items():
        for method, name in SHELLS.items():
            if name in part["parts"]:
                radii = part["parts"][name]["recovered"][CRITERION]["radii"]
                body.append((knee, method, limits(radii["0.9"]), limits(radii["0.5"])))
    return table(
        "How close a start must be to end within 0.5 kN and 0.5 % of the truth (95 % limits)",
        "knee; optimizer; nine of ten do from within [kN and %]; "
        "every second does from within [kN and %]",
        body,
    )


def equivalent_table(record: Row) -> ik.report.Table:
    """Smallest to largest value of each parameter among equivalent sets."""
    setting = next(iter(record["knees"].values()))["setting"]
    columns = [
        (f"{knee}, {'the paper' if case == 'paper' else case}", part["cases"][case])
        for knee, part in record["knees"].items()
        for case in (NOISE, "paper")
        if case in part["cases"]
    ]
    body = [
        (label(name), f"{truth:g}", *(span(case["parameters"][name]) for _, case in columns))
        for name, truth in zip(setting["parameters"], setting["truth"], strict=True)
    ]
    return table(
        "Parameters of sets equivalent within noise, or by the paper's criterion",
        ["parameter", "truth", *(name for name, _ in columns)],
        body,
    )


def contact_table(record: Row) -> ik.report.Table:
    """What half the contact stiffness does, before and after the parameters compensate for it."""
    body = []
    for knee, part in record["knees"].items():
        before, fitted = part["one_way"]["before"], part["one_way"]["fitted"]
        errors = [sum(fitted[x]) / len(fitted[x]) for x in ("error_kN", "error_pct")]
        body.append((knee, "true parameters", *kinematics(before), "0", "0"))
        sizes = (
            f"{errors[0]:.2f} ({max(fitted['error_kN']):.2f})",
            f"{errors[1]:.2f} ({max(fitted['error_pct']):.2f})",
        )
        body.append((knee, f"fitted, {fitted['outcome']}", *kinematics(fitted), *sizes))
    return table(
        "A model with half the contact pressure, fitted to data made with all of it",
        [
            "knee",
            "parameters",
            *(f"{x} [{unit}]" for x in ("RMSE", "largest") for unit in ("mm", "deg")),
            "stiffness error, mean (largest) [kN]",
            "reference strain error, mean (largest) [%]",
        ],
        body,
    )


def fold_table(record: Row) -> ik.report.Table:
    """How the 63 trials end on knees with chosen and with raw insertions."""
    body = []
    for knee, part in record["knees"].items():
        lost = part["seed63"]["not_converged"]
        outcomes = ", ".join(f"{x} {n}" for x, n in part["seed63"]["outcomes"].items())
        posed = [abs(x["single_step_coordinates"][4]) for x in lost]
        loads = [abs(x["last_stable_load"]) for x in part["ramps"] if x["outcome"] == "fold"]
        body.append((knee, outcomes, low_high(loads, "N·m"), low_high(posed, "deg")))
    return table(
        "How the 63 trials end",
        "knee; outcomes; folds at; internal rotation that a single step returns there",
        body,
    )


STARTS = {"guesses_complex": "IG1 to IG4", "shells_complex": "shells around the truth"}


def is_truth(part: Row, basin: Row) -> bool:
    """Whether the minimum of a basin is the truth."""
    theta = [basin["parameters"][name] for name in part["parameters"]]
    return bool(max(abs(x - y) for x, y in zip(theta, part["truth"], strict=True)) < AT_TRUTH)


def limits(radius: list[float | None]) -> str:
    """A radius with its limits as text."""
    value, low, high = ("all tried" if x is None else f"{x:.2f}" for x in radius)
    return f"{value} ({low} to {high})"


def span(of: Row) -> str:
    """A range, its ends marked where something cuts it."""
    ends = zip(of["range"], of["ends"], strict=True)
    return " to ".join(f"{value:.3g}{MARKS.get(end, '')}" for value, end in ends)


def kinematics(of: Row) -> tuple[str, ...]:
    """Errors of a row of the contact table."""
    return tuple(f"{of[x]:.2f}" for x in ("rmse_mm", "rmse_deg", "largest_mm", "largest_deg"))


def low_high(values: list[float], unit: str) -> str:
    """Smallest to largest."""
    return f"{min(values):.1f} to {max(values):.1f} {unit}" if values else "-"


def gap_table(record: Row) -> ik.report.Table:
    """How far off the models are before any fit, as study 11 has it."""
    table: ik.report.Table = module_of(GAP, "gap_tables").size_table(record)
    return table


def known_table(record: Row) -> ik.report.Table:
    """What noisy data tell of each parameter, as study 04 has it."""
    table: ik.report.Table = module_of(PROFILES, "profile_tables").parameter_table(record)
    return table


def optimizer_table(record: Row) -> ik.report.Table:
    """Errors of other optimizers from the paper's guesses, as study 09 has it."""
    table: ik.report.Table = module_of(OPTIMIZERS, "figures").guess_table(record)
    return table


TABLE_OF: Mapping[str, tuple[str, Callable[[Row], ik.report.Table]]] = {
    "ends": (BASINS, end_table),
    "radii": (BASINS, radius_table),
    "optimizers": (OPTIMIZERS, optimizer_table),
    "equivalents": (EQUIVALENTS, equivalent_table),
    "known": (PROFILES, known_table),
    "gap": (GAP, gap_table),
    "contact": (CHECKS, contact_table),
    "folds": (EVALUATION, fold_table),
}
