"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from common.records import BUNDLES
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import identknee as ik
from identknee.runs.declare import Array

Row = Mapping[str, Any]
CAPSULE_KNEES = ("reference", "lenhart2015_stable", "s192803_bundles")
MEASURED = "s192803"
HALF_WIDTH = 1.96
# Ways to calibrate as the record names them, and on two lines.
WAYS_IN_ORDER = {
    "laxity": "laxity",
    "laxity and ACL force": "laxity and\nACL force",
    "insertions exact": "insertions\nexact",
    "insertions wrong, taken as exact": "insertions wrong,\ntaken as exact",
    "stiffness wrong, taken as known": "stiffness wrong,\ntaken as known",
    "stiffness wrong, fitted too": "stiffness wrong,\nfitted too",
}
SHOWN_WAYS = {
    "laxity": ("o", ik.report.COLOURS[0]),
    "laxity and ACL force": ("s", ik.report.COLOURS[1]),
    "insertions exact": ("D", ik.report.COLOURS[2]),
}
PREDICTED = {
    "ACL, tested": "ACL, trials tested",
    "ACL, not tested": "ACL, other trials",
    "others, tested": "others, trials tested",
    "others, not tested": "others, other trials",
}
# Of the loads of a protocol in their order; compression is held in all trials.
DIRECTIONS = (
    (("external", "internal"), "N·m"),
    (("valgus", "varus"), "N·m"),
    (("posterior", "anterior"), "N"),
)
KINDS = {
    "stiffness_kN": ("stiffness", "kN"),
    "reference_strain_pct": ("strain", "%"),
    "tension_N": ("force", "N"),
}
# The colour of an interval that was open and is closed is that of so small a share.
CLOSED = 0.08


def main() -> None:
    """Draw the figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def widths(rows: Sequence[Row]) -> tuple[list[str], list[str], Array]:
    """Names of plans and quantities, and widths of the intervals, NaN where one is open."""
    plans, names = [x["plan"] for x in rows], list(all_ends(rows[0]))
    found = [[width(all_ends(x)[name]) for name in names] for x in rows]
    return plans, names, np.array(found, dtype=np.float64)


def all_ends(row: Row) -> dict[str, Sequence[float | None]]:
    """Ends of the interval of every parameter, then of every force."""
    forces = {name: x[1:] for name, x in row.get("forces", {}).items()}
    return {**row["ends"], **forces}


def width(ends: Sequence[float | None]) -> float:
    """Width of an interval, NaN where one end is open."""
    low, high = ends
    return float("nan") if low is None or high is None else high - low


def figure_1(record: Row) -> Figure:
    """Width of each interval by plan, as a share of that of the intact plan."""
    figure = Figure(figsize=(9.6, 11.4), layout="constrained")
    panels = figure.subplots(len(CAPSULE_KNEES), 1, squeeze=False)[:, 0]
    for axes, knee in zip(panels, CAPSULE_KNEES, strict=True):
        draw_shares(axes, record["knees"][knee]["plans"])
        axes.set_title(knee, fontsize=10)
    return figure


def draw_shares(axes: Axes, rows: Sequence[Row]) -> None:
    """Width of each interval by plan as a share of that of the first plan."""
    plans, names, found = widths(rows)
    image = np.where(np.isnan(found), np.nan, found / found[0])
    closes = np.isfinite(found) & np.isnan(image)
    axes.imshow(
        np.where(closes, CLOSED, image), cmap="viridis_r", vmin=0.0, vmax=1.0, aspect="auto"
    )
    for i, row in enumerate(found):
        for j, size in enumerate(row):
            share = image[i, j]
            text = "open" if np.isnan(size) else "closed" if np.isnan(share) else f"{share:.2f}"
            is_dark = np.isfinite(share) and share > 0.6
            axes.text(
                j,
                i,
                text,
                ha="center",
                va="center",
                fontsize=ik.report.SMALL,
                color="white" if is_dark else ik.report.BLACK,
            )
    axes.set_yticks(range(len(plans)), plans)
    axes.set_xticks(range(len(names)), list(map(short, names)), rotation=40, ha="right", fontsize=8)


def figure_2(record: Row) -> Figure:
    """What calibrations know of each reference strain, and how well they predict forces."""
    rows = record["knees"][BUNDLES]["calibrations"]
    figure = Figure(figsize=(9.6, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    names = list(rows[0]["strain_pct"])
    for way, (marker, colour) in SHOWN_WAYS.items():
        share = [mean_share(rows, way, x) for x in names]
        left.plot(share, range(len(names)), marker, color=colour, label=way, markersize=6)
    left.axvline(1.0, color=ik.report.GREY, linewidth=1.0)
    left.set_yticks(range(len(names)), names)
    left.invert_yaxis()
    left.set_xlim(0.0, 1.15)
    left.set_xlabel(
        "width of the interval of reference strain,\nas a share of that before any test"
    )
    left.legend(loc="lower left", fontsize=ik.report.SMALL)
    labels = ["before any test", *WAYS_IN_ORDER.values()]
    for i, (key, label) in enumerate(PREDICTED.items()):
        own = {x: [y["forces_N"][key] for y in of_way(rows, x)] for x in WAYS_IN_ORDER}
        before = mean_square_root(next(iter(own.values())), "rms_before")
        found = [before, *(mean_square_root(x, "rms") for x in own.values())]
        colour = ik.report.COLOURS[i // 2]
        right.plot(found, range(len(labels)), "os"[i % 2], color=colour, label=label, markersize=6)
    right.set_yticks(range(len(labels)), labels)
    right.invert_yaxis()
    right.set_xlim(0.0, None)
    right.set_xlabel("error of predicted forces [N], root mean square")
    right.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=2, fontsize=ik.report.SMALL)
    return figure


def figure_3(record: Row) -> Figure:
    """The measured knee: width of each interval by plan, as a share of that of the intact plan."""
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    draw_shares(figure.subplots(), record["knees"][MEASURED]["plans"])
    return figure


FIGURE_OF = {
    "figure_1_widths": figure_1,
    "figure_2_slack_lengths": figure_2,
    "figure_3_laboratory": figure_3,
}


def tables(record: Row) -> Mapping[str, ik.report.Table]:
    """The tables of the page by name."""
    rows, measured = record["knees"][BUNDLES]["calibrations"], record["knees"][MEASURED]
    return {
        **{x: ends_table(x, record["knees"][x]["plans"]) for x in CAPSULE_KNEES},
        "slack lengths": slack_table(rows),
        "ligaments": ligament_table(rows),
        "forces": force_table(rows),
        "laboratory": ends_table(MEASURED, measured["plans"]),
        "advice": advice_table(measured),
    }


def of_way(rows: Sequence[Row], way: str) -> list[Row]:
    """All calibrations of one way."""
    return [x for x in rows if x["way"] == way]


def mean_share(rows: Sequence[Row], way: str, ligament: str) -> float:
    """Mean of the deviation of a strain after the tests over that before."""
    found = [x["strain_pct"][ligament] for x in of_way(rows, way)]
    return float(np.mean([x[2] / x[3] for x in found]))


def mean_square_root(found: Sequence[Row], name: str) -> float:
    """Root of the mean square of all knees, each with its number of forces."""
    n = np.array([x["n"] for x in found], float)
    return float(np.sqrt(np.average([x[name] ** 2 for x in found], weights=n)))


def slack_table(rows: Sequence[Row]) -> ik.report.Table:
    """How well strains and slack lengths come back, by way."""
    made = []
    for way in WAYS_IN_ORDER:
        own = of_way(rows, way)
        cells: list[Cell] = [way]
        for kind in ("strain_pct", "slack_length_mm"):
            true, found, sd, before = (
                np.array([list(x[kind].values()) for x in own]).reshape(-1, 4).T
            )
            off = np.abs(found - true)
            cells += [
                float(np.sqrt(np.mean((found - true) ** 2))),
                HALF_WIDTH * float(np.mean(before)),
                HALF_WIDTH * float(np.mean(sd)),
                f"{100.0 * np.mean(off <= HALF_WIDTH * sd):.0f}",
            ]
        minima = sum(x["outcome"] == "minimum" for x in own)
        made.append((*cells, f"{minima} of {len(own)}"))
    return table(
        f"Reference strain and slack length of 18 ligaments, {len(of_way(rows, way))} knees",
        "measured and known; strain: error [%] | 1; interval before, +- [%] | 1; "
        "interval, +- [%] | 1; within it [%]; slack length: error [mm] | 1; "
        "interval before, +- [mm] | 1; interval, +- [mm] | 1; within it [%]; ended at a minimum",
        made,
    )


def ligament_table(rows: Sequence[Row]) -> ik.report.Table:
    """Half of the interval of each strain, by way."""
    ways = list(SHOWN_WAYS)
    return table(
        "95 % interval of each reference strain, +- [%], mean of the knees",
        ["ligament", *(f"{x} | 1" for x in ways)],
        [
            (
                name,
                *(
                    HALF_WIDTH * float(np.mean([x["strain_pct"][name][2] for x in of_way(rows, y)]))
                    for y in ways
                ),
            )
            for name in rows[0]["strain_pct"]
        ],
    )


def force_table(rows: Sequence[Row]) -> ik.report.Table:
    """How well forces are predicted, by way and where."""
    made: list[tuple[Cell, ...]] = []
    for way in WAYS_IN_ORDER:
        for key, label in PREDICTED.items():
            own = [x["forces_N"][key] for x in of_way(rows, way)]
            n = sum(x["n"] for x in own)
            made.append(
                (
                    way,
                    label,
                    n,
                    mean_square_root(own, "rms_true"),
                    mean_square_root(own, "rms_before"),
                    mean_square_root(own, "rms"),
                    max(x["largest"] for x in own),
                    100.0 * sum(x["n_within"] for x in own) / n,
                )
            )
    return table(
        "Forces predicted, in N",
        "measured and known; forces; how many | 0; size (rms) | 0; error before any test (rms) "
        "| 0; error (rms) | 1; largest error | 0; within their 95 % intervals [%] | 0",
        made,
    )


def ends_table(knee: str, rows: Sequence[Row]) -> ik.report.Table:
    """Intervals of every parameter and force by plan."""
    plans = [f"{x['plan']} ({x['n_trials']} trials)" for x in rows]
    return table(
        f"95 % intervals, {knee}",
        ["quantity" if "forces" in rows[0] else "parameter", *plans],
        [
            (name_with_unit(x), *(words(list(all_ends(y)[x])) for y in rows))
            for x in all_ends(rows[0])
        ],
    )


def advice_table(part: Row) -> ik.report.Table:
    """The best single step of each kind: what it was said to narrow, and what it narrows."""
    base, *steps = part["steps"]
    return table(
        "The best single step of each kind after one pass of the trials",
        "step; narrows by, forecast [%] | 0; got [%] | 0; intervals closed before and after | 0",
        [
            (
                step_words(said),
                100.0 * said["narrowing"],
                *narrowed(base["ends"], got["ends"]),
            )
            for said, got in zip(part["advice"]["steps"], steps, strict=True)
        ],
    )


def narrowed(before: Row, after: Row) -> tuple[float, int]:
    """Narrowing [%] by the geometric mean of the intervals closed in both, and their number."""
    pairs = [(width(before[x]), width(after[x])) for x in before]
    shares = [y / x for x, y in pairs if np.isfinite(x) and np.isfinite(y)]
    return 100.0 * float(1.0 - np.exp(np.mean(np.log(shares)))), len(shares)


def step_words(step: Row) -> str:
    """A step in words."""
    if step["kind"] == "error":
        kind, _, place = str(step["name"]).partition(".")
        return f"{kind} of {place.replace('_', ', ')} known twice as well"
    loads = [
        f"{words[x > 0.0]} {abs(x):.3g} {unit}"
        for x, (words, unit) in zip(step["loads"], DIRECTIONS, strict=False)
        if x
    ]
    trial = f"{' and '.join(loads)} at {step['flexion_deg']:.0f} deg"
    return {
        "cut": f"{step['structure']} cut, {trial}",
        "force": f"{step['structure']} force, {trial}",
        "contact": f"contact forces, {trial}",
        "trial": f"one more trial, {trial}",
    }[step["kind"]]


def words(ends: list[float | None]) -> str:
    """An interval in words."""
    if ends == [None, None]:
        return "open"
    low, high = ("open" if x is None else f"{x:.3g}" for x in ends)
    return f"{low} to {high}"


def short(name: str) -> str:
    """Owner and kind of a parameter, or of a force."""
    owner, _, kind = name.partition("@")[0].rpartition(".")
    return f"{owner} {KINDS[kind][0]}"


def name_with_unit(name: str) -> str:
    """The same with its unit, of a force also the trial."""
    trial = name.partition("@")[2].partition(",")[0]
    kind = name.partition("@")[0].rpartition(".")[2]
    return f"{short(name)}{f' in {trial}' if trial else ''} [{KINDS[kind][1]}]"


if __name__ == "__main__":
    main()
