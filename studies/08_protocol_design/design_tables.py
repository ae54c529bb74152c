"""The record's numbers, and the tables of the page."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from common.page import Cell, table

import identknee as ik
from identknee.runs.words import label

Row = Mapping[str, Any]


def tables(record: Row) -> dict[str, ik.report.Table]:
    """All tables of the page by the name of their place in it."""
    return {
        "trials": trials_table(record),
        "criteria": criteria_table(record),
        "data": data_table(record),
    }


def cases(record: Row) -> Iterator[tuple[str, str, Row]]:
    """Knee, trials made, and what was found for them."""
    for knee, part in record["knees"].items():
        for made, found in part["made"].items():
            yield knee, made, found


def number(values: object) -> np.ndarray:
    """As numbers, NaN for what is open."""
    return np.array(values, dtype=float)


def relative(lengths: Sequence[float], before: Sequence[float]) -> float:
    """Geometric mean of the lengths over those before."""
    return float(np.exp(np.mean(np.log(number(lengths) / number(before)))))


def trials_table(record: Row) -> ik.report.Table:
    """What was chosen, and the targets before, predicted and achieved."""
    body: list[tuple[Cell, ...]] = []
    for knee, made, found in cases(record):
        best = found["advice"]["width"]
        chosen = "<br>".join(f"`{name}`" for name in best["trials"])
        for t, target in enumerate(best["targets"]):
            first = (f"{knee}, {made} ({best['n_made']})", chosen) if t == 0 else ("", "")
            shown = (best["before"][t], best["predicted"][-1][t], best["after"][t])
            body.append((*first, label(target), *(_interval(x) for x in shown)))
    heads = (
        "knee, trials already made",
        "trials to add, the most helpful first",
        "target",
        "before",
        "predicted",
        "achieved",
    )
    return table("Trials chosen by predicted width, and the 95 % intervals", heads, body)


def criteria_table(record: Row) -> ik.report.Table:
    """Length left by criterion and by chance, and the candidates left out."""
    body: list[tuple[Cell, ...]] = []
    names = list(next(cases(record))[2]["advice"])
    for knee, made, found in cases(record):
        best = found["advice"]["width"]
        before = best["lengths_before"]
        drawn = [relative(row["lengths"], before) for row in found["random"]]
        body.append(
            (
                f"{knee}, {made}",
                *(_percent(relative(one["lengths"], before)) for one in found["advice"].values()),
                _range(drawn),
                f"{len(best['excluded'])} of {best['n_candidates']}",
                str(len(best["at_fit"])),
            )
        )
    heads = (
        "knee, trials already made",
        *names,
        "at random",
        "not offered",
        "no prediction at best fit",
    )
    return table(
        "Interval length left, by criterion; for random sets the median (smallest to largest)",
        heads,
        body,
    )


def data_table(record: Row) -> ik.report.Table:
    """New data: length left, open ends, and how often the truth lies inside."""
    body: list[tuple[Cell, ...]] = []
    for knee, made, found in cases(record):
        part, best = record["knees"][knee], found["advice"]["width"]
        truth = dict(zip(part["parameters"], part["truth"], strict=True))
        targets = np.array([truth[name] for name in best["targets"]])
        rows = found["redone"]
        left = [relative(x["with"]["lengths"], x["without"]["lengths"]) for x in rows]
        without, added = (number([x[name]["ends"] for x in rows]) for name in ("without", "with"))
        low, high = np.where(np.isnan(added), [-np.inf, np.inf], added).transpose(2, 0, 1)
        inside = (low <= targets) & (targets <= high)
        body.append(
            (
                f"{knee}, {made}",
                str(len(rows)),
                _range(left),
                f"{int(np.isnan(without).sum())} of {without.size}",
                f"{int(np.isnan(added).sum())} of {added.size}",
                f"{int(inside.sum())} of {inside.size}",
            )
        )
    heads = (
        "knee, trials already made",
        "data sets",
        "length left",
        "open ends before",
        "open ends after",
        "truth inside after",
    )
    return table(
        "New noisy data with the trials chosen by width; interval length left as median (range)",
        heads,
        body,
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _range(shares: Sequence[float]) -> str:
    middle = _percent(float(np.median(shares)))
    return f"{middle} ({_percent(min(shares))} to {_percent(max(shares))})"


def _interval(ends: Sequence[float | None]) -> str:
    low, high = ("open" if x is None else f"{x:.3g}" for x in ends)
    return f"{low} to {high}"
