"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import draw_study
from gap_tables import SHOWN_KNEES, SHOWN_SD, gaps, tables
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import identknee as ik
from identknee.model.effects.facts import cause_label

LEVEL = 0.05
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def gap_figure(record: Row) -> Figure:
    """Every model less the measured mean, in the printed sds, a row a load."""
    rows = record["rows"]
    figure = Figure(figsize=(8.6, 5.6), layout="constrained")
    axes = figure.add_subplot()
    axes.axvspan(-2, 2, color="0.93")
    axes.axvspan(-1, 1, color="0.86")
    axes.axvline(0.0, color=ik.report.GREY, linewidth=0.8)
    models = gaps(record)
    for k, (name, values) in enumerate(models.items()):
        heights = np.arange(len(rows)) + 0.13 * (k - 0.5 * (len(models) - 1))
        axes.plot(
            values,
            heights,
            ik.report.MARKERS[k],
            color=ik.report.COLOURS[k],
            markersize=5,
            linestyle="none",
            label=name,
        )
    labels = [f"{x['load']}, {x['flexion_deg']:g} deg" for x in rows]
    axes.set_yticks(range(len(rows)), labels, fontsize=ik.report.SMALL)
    axes.invert_yaxis()
    axes.set_xlabel("model minus measured mean, in between-subject sds")
    axes.legend(
        fontsize=ik.report.SMALL, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False
    )
    return figure


def verdict_figure(record: Row) -> Figure:
    """Misfit and leave-one-out error against the assumed sd of the measured means."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    chance, held = figure.subplots(1, 2)
    for k, (name, found) in enumerate(diagnosed(record).items()):
        known = [x for x in found if x["assumed_sd"] is not None]
        sds = [x["assumed_sd"] for x in known]
        colour, marker = ik.report.COLOURS[k + 1], ik.report.MARKERS[k + 1]
        chance.plot(sds, [x["p_value"] for x in known], marker=marker, color=colour, label=name)
        for i, x in enumerate(known):
            chance.annotate(
                x["verdict"].replace("_", " ").lower(),
                (x["assumed_sd"], x["p_value"]),
                xytext=(0, 8 if k == 0 else -24 + 10 * (i % 2)),
                ha="center",
                textcoords="offset points",
                fontsize=ik.report.SMALL - 1,
                annotation_clip=True,
                bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"},
            )
        left = [x["left_out"]["rmse_deg"] for x in known]
        held.plot(sds, left, marker=marker, color=colour, label=f"{name}, no cause")
        extended = [
            (x["assumed_sd"], x["extensions"][0])
            for x in known
            if x["extensions"] and x["extensions"][0]["left_out"]["n_scored"] > 0
        ]
        if not extended:
            continue
        held.plot(
            [sd for sd, _ in extended],
            [x["left_out"]["rmse_deg"] for _, x in extended],
            marker=marker,
            markerfacecolor="white",
            linestyle=ik.report.STYLES[1],
            color=colour,
            label=f"{name}, likeliest cause added",
        )
    chance.axhline(LEVEL, color=ik.report.BLACK, linewidth=0.8, linestyle=ik.report.STYLES[3])
    chance.set_yscale("log")
    chance.set_ylim(1e-12, 20.0)
    chance.set_xlim(0.2, 4.4)
    chance.set_ylabel("probability of such a misfit from noise alone")
    held.set_ylim(bottom=0.0)
    held.set_ylabel("RMSE of the angle left out [deg]")
    for axes in (chance, held):
        axes.set_xlabel("assumed sd of a measured mean [mm, deg]")
        axes.legend(fontsize=ik.report.SMALL)
    return figure


def visible_figure(record: Row) -> Figure:
    """Amplitude that would be found, over the one worth knowing, for every effect."""
    figure = Figure(figsize=(7.6, 5.6), layout="constrained")
    axes = figure.add_subplot()
    names: list[str] = []
    for k, (knee, found) in enumerate(diagnosed(record).items()):
        shown = next(x for x in found if x["assumed_sd"] == SHOWN_SD)["visible"]
        names = names or [x["name"] for x in shown]
        _draw_visible(axes, {x["name"]: x for x in shown}, names, (k, knee))
    axes.axvline(1.0, color=ik.report.BLACK, linewidth=0.8, linestyle=ik.report.STYLES[3])
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), [*map(cause_label, names)], fontsize=ik.report.SMALL)
    axes.invert_yaxis()
    axes.set_xlabel("amplitude found in 9 of 10 data sets, over the smallest relevant")
    figure.legend(fontsize=ik.report.SMALL, loc="outside upper center", ncols=2, frameon=False)
    axes.grid(axis="y", color="0.9")
    return figure


def _draw_visible(
    axes: Axes, shown: Mapping[str, Row], names: list[str], place: tuple[int, str]
) -> None:
    k, knee = place
    ratio = np.array(
        [
            np.nan
            if shown[x]["detectable"] is None
            else shown[x]["detectable"] / shown[x]["relevant"]
            for x in names
        ]
    )
    axes.plot(
        ratio,
        np.arange(len(names)),
        ik.report.MARKERS[k + 1],
        color=ik.report.COLOURS[k + 1],
        linestyle="none",
        label=knee,
    )


def diagnosed(record: Row) -> dict[str, list[Row]]:
    """The diagnoses of the knees drawn."""
    return {k: record["knees"][k]["diagnoses"] for k in SHOWN_KNEES if k in record["knees"]}


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_gap": gap_figure,
    "figure_2_verdict": verdict_figure,
    "figure_3_visible": visible_figure,
}


if __name__ == "__main__":
    main()
