"""Fast part of the study: draws the figure and fills the tables of the page from the record."""

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import stdtrit

import identknee as ik
from identknee.model.effects.facts import cause_label

NAMES = {"s192803": "four lines", "s192803_bundles": "14 bundles in 4 groups"}
NAIVE, HONEST = "nothing", "frames and insertions"
FIRST_SPLIT = "loads and angles"
JUDGED = {
    "anterior_drawer_mm": "anterior drawer [mm]",
    "internal_deg": "internal rotation [deg]",
    "varus_deg": "varus [deg]",
}
COORDINATES = ik.laxity.COORDINATES
Row = Mapping[str, Any]


def main() -> None:
    """Draw the figure and fill the page."""
    draw_study(__file__, {"figure_1_held_out": held_out_figure}, tables)


def held_out_figure(record: Row) -> Figure:
    """Predicted against measured values of the first split, both fits of the bundles."""
    figure = Figure(figsize=(10.0, 3.9), layout="constrained")
    rows = {
        x["uncertain"]: x
        for x in record["knees"]["s192803_bundles"]["parts"]
        if x["part"] == "held out" and x["split"] == FIRST_SPLIT
    }
    for axes, (coordinate, label) in zip(
        np.atleast_1d(figure.subplots(1, len(JUDGED))), JUDGED.items(), strict=True
    ):
        for k, uncertain in enumerate((NAIVE, HONEST)):
            _points(axes, rows[uncertain], coordinate, k)
        low, high = axes.get_xlim()
        axes.plot([low, high], [low, high], color=ik.report.GREY, linewidth=0.8, zorder=0)
        axes.set_xlabel(f"measured {label}")
        axes.set_ylabel(f"predicted {label}")
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def tables(record: Row) -> Mapping[str, ik.report.Table | str]:
    """What stands at each mark of the page."""
    return {
        "before": before_table(record),
        "fits": fits_table(record),
        "diagnoses": diagnoses_table(record),
        "held out": held_out_table(record),
    }


def before_table(record: Row) -> ik.report.Table:
    """Trials with an equilibrium before any fit."""
    rows = [
        (NAMES[name], f"{x['with_equilibrium']} of {x['n_trials']}", _flagged(x))
        for name, x in _as_it_is(record)
    ]
    return table(
        "Before any fit",
        "model; trials with an equilibrium at the measured pose; rows that the table contradicts",
        rows,
    )


def fits_table(record: Row) -> ik.report.Table:
    """Errors in sample."""
    rows: list[tuple[Cell, ...]] = [
        (
            NAMES[x["knee"]],
            x["uncertain"],
            x.get("noise", "1mm,1deg").replace("mm,", " mm, ").replace("deg", " deg"),
            f"{x['n_parameters']} + {x['n_nuisances']}",
            f"{x['trials_used']} of 24",
            *(_of(x["rmse"], name) for name in JUDGED),
            x["outcome"],
            "yes" if x["one_sided_contact"] else "no",
        )
        for x in parts(record, "fit")
    ]
    return table(
        "Fits to 24 trials: root-mean-square errors over the trials used",
        "model; taken as uncertain; errors weighed as; parameters + errors; trials used; "
        "anterior drawer [mm]; internal rotation [deg]; varus [deg]; ended; "
        "contact on one side alone",
        rows,
    )


def diagnoses_table(record: Row) -> ik.report.Table:
    """What diagnoses name, and what it gains."""
    rows: list[tuple[Cell, ...]] = []
    for x in parts(record, "diagnosis"):
        before, after = x["misfit"]["chi_square"]
        gain = x["gain"] and "{:.1f} ± {:.1f}".format(*x["gain"]["elpd"])
        named = ", ".join(cause_label(cause[0]) for cause in x["causes"])
        rows.append(
            (
                NAMES[x["knee"]],
                x["noise"].replace("mm,", " mm, ").replace("deg", " deg"),
                x["verdict"],
                named or "none",
                len(x["open"]),
                f"{before:.1f} to {after:.1f} of {x['misfit']['n']}",
                gain or "none",
                len(x["advised"]),
            )
        )
    return table(
        "Diagnoses of 24 trials",
        "model; noise assumed; verdict; best cause; other causes open | 0; chi-square; "
        "gain in log predictive density ± standard error; trials advised | 0",
        rows,
    )


def held_out_table(record: Row) -> ik.report.Table:
    """Errors of what a fit did not see."""
    rows: list[tuple[Cell, ...]] = []
    for x in parts(record, "held out"):
        if "rmse_judged" not in x:
            rows.append((x["split"], NAMES[x["knee"]], x["uncertain"], "none", *[None] * 7))
            continue
        judged = (x["rmse_judged"].get(name, {}).get("rmse") for name in JUDGED)
        whole = (x["rmse_all"].get(name) for name in JUDGED)
        rows.append(
            (
                x["split"],
                NAMES[x["knee"]],
                x["uncertain"],
                f"{x['held_out'] - len(x['lost'])} of {x['held_out']}",
                *judged,
                *whole,
                round(100.0 * x["within_90"]),
            )
        )
    return table(
        "Trials held out: root-mean-square errors, and values in their 90 % intervals",
        "held out; model; taken as uncertain; predicted; AP under AP force [mm]; "
        "IE under IE moment [deg]; VV under VV moment [deg]; AP, all [mm]; IE, all [deg]; "
        "VV, all [deg]; in 90 % interval [%] | 0",
        rows,
    )


def parts(record: Row, part: str) -> Iterator[Row]:
    """Rows of all knees of one kind."""
    for knee in record["knees"].values():
        yield from (x for x in knee["parts"] if x["part"] == part)


def _as_it_is(record: Row) -> Iterator[tuple[str, Row]]:
    for name, knee in record["knees"].items():
        yield name, knee["as_it_is"]


def _flagged(row: Row) -> str:
    return ", ".join(x["where"] for x in row["flagged"]) or "none"


def _of(values: list[float], name: str) -> float:
    return values[COORDINATES.index(name)]


def _points(axes: Axes, row: Row, coordinate: str, k: int) -> None:
    own = [x for x in row["judged"] if x[1] == coordinate and x[3] is not None]
    measured, predicted, sd = np.array([x[2:] for x in own]).reshape(-1, 3).T
    label = "geometry exact" if k == 0 else "frames and insertions uncertain"
    axes.errorbar(
        measured,
        predicted,
        stdtrit(row["degrees_of_freedom"], 0.95) * sd,
        fmt=ik.report.MARKERS[k],
        color=ik.report.GREY if k == 0 else ik.report.COLOURS[0],
        markersize=5,
        linewidth=1.0,
        label=f"{label} (bars: 90 %)",
    )


if __name__ == "__main__":
    main()
