"""What the cases amount to: how each ended, and the tables of the page."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import Any

import numpy as np
from common.page import table

import identknee as ik
from identknee.model.effects.facts import cause_label

NULLS, ONE, UNLISTED = "nothing hidden", "one", "unlisted"
SILENT = ("ADEQUATE", "NOT_TESTABLE")
WIDTH = 120  # of the page
Row = Mapping[str, Any]


class Ending(StrEnum):
    """How a diagnosis compares with the truth."""

    RIGHT = "right"
    GROUP = "in the group"
    OPEN = "not named, no wrong name"
    MISSED = "missed"
    WRONG = "wrong name"


def cases_of(record: Row) -> list[Row]:
    """All cases that could be drawn."""
    (knee,) = record["knees"].values()
    return [x for x in knee["cases"] if "error" not in x]


def ending(case: Row) -> Ending:
    """How a case ended; of a null an alarm without a name is neither right nor a wrong name."""
    if case["wrong"]:
        return Ending.WRONG
    if case["correct"]:
        return Ending.GROUP if case["verdict"] == "AMBIGUOUS" else Ending.RIGHT
    return Ending.MISSED if case["effects"] and case["verdict"] in SILENT else Ending.OPEN


def series_of(cases: Iterable[Row]) -> dict[str, list[Row]]:
    """Cases by what is hidden and how large."""
    found: dict[str, list[Row]] = {}
    for x in cases:
        size = "" if x["wanted"] is None else f", signal {x['wanted']:g}"
        found.setdefault(f"{x['series']}{size}", []).append(x)
    return found


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables by the mark of their place on the page."""
    cases = cases_of(record)
    return {
        "table 1": ending_table(cases),
        "table 2": parameter_table(cases),
        "table 3": fault_table(cases),
    }


def sentences(record: Row) -> dict[str, str]:
    """What the page says in numbers, by the mark of its place."""
    cases = cases_of(record)
    alone = [x for x in cases if x["series"] == ONE]
    by_signal = [_named(x, [y for y in alone if y["wanted"] == x]) for x in signals_of(alone)]
    misnamed = [x for x in cases if ending(x) is Ending.WRONG]
    wrong = ik.identify.share(len(misnamed), len(cases))
    unlisted = all(x["series"] == UNLISTED for x in misnamed)
    which = " All of these hide an effect that no library lists." if misnamed and unlisted else ""
    nulls = [x for x in cases if x["series"] == NULLS]
    alarms = sum(x["verdict"] not in SILENT for x in nulls)
    right = [x for x in cases if x["verdict"] == "NAMED" and ending(x) is Ending.RIGHT]
    errors = np.median(values_of(right, "stiffness_error_kN"), axis=0) if right else [np.nan] * 2
    held = 100 * values_of(right, "coverage").mean(axis=0) if right else [np.nan] * 2
    answer = (
        f"{' '.join(by_signal)} A wrong name is given in {wrong.count} of all {len(cases)} cases "
        f"(at most {100 * wrong.upper:.0f} % with 95 % confidence).{which} An alarm is raised "
        f"in {alarms} of the {len(nulls)} cases with nothing hidden. In the {len(right)} cases "
        f"named correctly the median error of the stiffnesses falls from {errors[0]:.2f} to "
        f"{errors[1]:.2f} kN, and {held[1]:.0f} % of the parameters' 95 % intervals contain the "
        f"true value instead of {held[0]:.0f} %."
    )
    seconds = [x["seconds"] for x in cases]
    cost = (
        f"A diagnosis took {np.median(seconds):.0f} s (median; the longest took "
        f"{np.max(seconds):.0f} s) on two cores that were also busy with other long runs. All "
        f"cases together took {np.sum(seconds) / 60:.0f} minutes."
    )
    return {"answer": _wrapped(f"**Answer.** {answer}"), "cost": _wrapped(cost)}


def signals_of(cases: Iterable[Row]) -> list[float]:
    """Sizes of the hidden effects, the largest first."""
    return sorted({x["wanted"] for x in cases}, reverse=True)


def _named(signal: float, own: Sequence[Row]) -> str:
    """How many of the cases of one signal were named, or are in the group."""
    kinds = [ending(x) for x in own]
    return (
        f"At a signal of {signal:g}, {kinds.count(Ending.RIGHT)} of {len(own)} single effects are "
        f"named correctly and {kinds.count(Ending.GROUP)} more are in the group of causes given "
        f"(missed: {kinds.count(Ending.MISSED)})."
    )


def _wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False))


def ending_table(cases: Sequence[Row]) -> ik.report.Table:
    """How the cases of each series ended."""
    rows = []
    for name, own in series_of(cases).items():
        counts = [sum(ending(x) is kind for x in own) for kind in Ending]
        right = ik.identify.share(counts[0] + counts[1], len(own))
        limits = f"{100 * right.lower:.0f} to {100 * right.upper:.0f}"
        sizes = [len(x["group"]) for x in own if x["verdict"] == "AMBIGUOUS"]
        typical = f"{np.median(sizes):g}" if sizes else "-"
        rows.append((name, str(len(own)), *(str(x) for x in counts), limits, typical))
    heads = (
        "hidden",
        "cases",
        *Ending,
        "right or in the group, 95 % interval [%]",
        "median size of the group",
    )
    return table("How the diagnoses ended", heads, rows)


def parameter_table(cases: Sequence[Row]) -> ik.report.Table:
    """Errors of the ligament parameters without and with the causes, by how the case ended."""
    rows = []
    for kind in Ending:
        own = [x for x in cases if x["effects"] and ending(x) is kind]
        known = [x for x in own if x["causes"] and None not in x["stiffness_error_kN"]]
        if known:
            rows.append(
                (
                    str(kind),
                    str(len(known)),
                    *_before_after(known, "stiffness_error_kN"),
                    *_before_after(known, "strain_error_pct"),
                    *(f"{100 * float(x):.0f}" for x in values_of(known, "coverage").mean(axis=0)),
                )
            )
    heads = (
        "diagnosis",
        "cases with a cause",
        *("stiffness error before [kN]", "after [kN]"),
        *("strain error before [%]", "after [%]"),
        *("intervals with the truth before [%]", "after [%]"),
    )
    return table("Mean error of the ligament parameters, median over the cases", heads, rows)


def fault_table(cases: Sequence[Row]) -> ik.report.Table:
    """Every case that ended with neither the truth nor a group that holds it."""
    rows = tuple(
        (
            " and ".join(map(cause_label, x["effects"])) or "nothing",
            f"{x['signal']:.1f}",
            str(x["seed"]),
            x["verdict"],
            ", ".join(map(cause_label, x["causes"] or x["group"])) or "-",
            str(ending(x)),
        )
        for x in cases
        if ending(x) not in (Ending.RIGHT, Ending.GROUP)
    )
    heads = ("hidden", "signal", "seed", "verdict", "named", "ending")
    return table("Cases in which the truth was not found", heads, rows)


def values_of(cases: Sequence[Row], name: str) -> ik.runs.Array:
    """A pair of numbers, before and after, of each case; NaN where unknown."""
    return np.array([x[name] for x in cases], dtype=np.float64).reshape(-1, 2)


def _before_after(cases: Sequence[Row], name: str) -> list[str]:
    return [f"{float(x):.2f}" for x in np.median(values_of(cases, name), axis=0)]
