"""Fast part of the study: draws the figure and fills the tables of the page from the record."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import draw_study, table
from matplotlib.figure import Figure

import identknee as ik

Row = Mapping[str, Any]
# The colour of an interval that was open and is closed is that of so small a share.
CLOSED = 0.08


def main() -> None:
    """Draw the figure and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def widths(part: Row) -> tuple[list[str], list[str], ik.runs.Array]:
    """Names of plans and parameters, and widths of the intervals, NaN where one is open."""
    plans, names = [x["plan"] for x in part["plans"]], list(part["plans"][0]["ends"])
    found = [
        [np.nan if None in (ends := x["ends"][name]) else ends[1] - ends[0] for name in names]
        for x in part["plans"]
    ]
    return plans, names, np.array(found, dtype=np.float64)


def figure_1(record: Row) -> Figure:
    """Width of each interval by plan, as a share of that of the intact plan."""
    figure = Figure(figsize=(9.0, 7.2), layout="constrained")
    panels = figure.subplots(len(record["knees"]), 1, squeeze=False)[:, 0]
    for axes, (knee, part) in zip(panels, record["knees"].items(), strict=True):
        plans, names, found = widths(part)
        image = np.where(np.isnan(found), np.nan, found / found[0])
        closes = np.isfinite(found) & np.isnan(image)
        axes.imshow(
            np.where(closes, CLOSED, image), cmap="viridis_r", vmin=0.0, vmax=1.0, aspect="auto"
        )
        for i, row in enumerate(found):
            for j, width in enumerate(row):
                share = image[i, j]
                text = (
                    "open" if np.isnan(width) else "closed" if np.isnan(share) else f"{share:.2f}"
                )
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
        axes.set_xticks(
            range(len(names)), list(map(short, names)), rotation=40, ha="right", fontsize=8
        )
        axes.set_title(knee, fontsize=10)
    return figure


FIGURE_OF = {"figure_1_widths": figure_1}


def tables(record: Row) -> Mapping[str, ik.report.Table]:
    """The tables of the page by name."""
    return {name: ends_table(name, part) for name, part in record["knees"].items()}


def ends_table(knee: str, part: Row) -> ik.report.Table:
    """Intervals of every parameter by plan."""
    plans = [f"{x['plan']} ({x['n_trials']} trials)" for x in part["plans"]]
    names = list(part["plans"][0]["ends"])
    return table(
        f"95 % intervals, {knee}",
        ["parameter", *plans],
        [(name_with_unit(x), *(words(y["ends"][x]) for y in part["plans"])) for x in names],
    )


def words(ends: list[float | None]) -> str:
    """An interval in words."""
    if ends == [None, None]:
        return "open"
    low, high = ("open" if x is None else f"{x:.3g}" for x in ends)
    return f"{low} to {high}"


def short(parameter: str) -> str:
    """Owner and kind of a parameter."""
    owner, _, kind = parameter.rpartition(".")
    return f"{owner} {'stiffness' if kind.endswith('_kN') else 'strain'}"


def name_with_unit(parameter: str) -> str:
    """The same with its unit."""
    return f"{short(parameter)} [{'kN' if parameter.endswith('_kN') else '%'}]"


if __name__ == "__main__":
    main()
