"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import draw_study
from design_tables import Row, cases, number, relative, tables
from matplotlib.figure import Figure

import identknee as ik
from identknee.report.design_figures import intervals_figure
from identknee.runs.words import label


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def figure_1(record: Row) -> Figure:
    """What each candidate alone would gain on the first knee after the trials of Table 2."""
    _, made, found = next(cases(record))
    best = found["advice"]["width"]
    candidates = ik.laxity.candidate_trials(ik.load_protocol(made))
    return ik.report.candidates_figure(
        candidates, number(best["gains"]), best["chosen"], "narrower [%]"
    )


def figure_2(record: Row) -> Figure:
    """Intervals before, predicted and achieved of all targets where one was open."""
    names, center = [], []
    rows: dict[str, list[np.ndarray]] = {"before": [], "predicted": [], "achieved": []}
    for knee, made, found in cases(record):
        best = found["advice"]["width"]
        if not np.isnan(number(best["before"])).any():
            continue
        for t, target in enumerate(best["targets"]):
            names.append(f"{knee}, {made}\n{label(target)}")
            center.append(best["best"][t])
            rows["before"].append(number(best["before"][t]))
            rows["predicted"].append(number(best["predicted"][-1][t]))
            rows["achieved"].append(number(best["after"][t]))
    return intervals_figure(names, center, rows)


def figure_3(record: Row) -> Figure:
    """Predicted length of every target's interval against the achieved one."""
    figure = Figure(figsize=(4.8, 4.4), layout="constrained")
    axes = figure.add_subplot()
    for k, (knee, part) in enumerate(record["knees"].items()):
        predicted, achieved = [], []
        for found in part["made"].values():
            for one in found["advice"].values():
                predicted += np.diff(number(one["predicted"][-1]))[:, 0].tolist()
                achieved += np.diff(number(one["after"]))[:, 0].tolist()
        axes.plot(
            predicted,
            achieved,
            ik.report.MARKERS[k],
            color=ik.report.COLOURS[k],
            fillstyle="none",
            label=knee,
        )
    axes.axline((1.0, 1.0), slope=1.0, color="0.8", linewidth=0.8, zorder=0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("predicted length of the interval [kN or %]")
    axes.set_ylabel("achieved by profile [kN or %]")
    axes.legend(frameon=False, fontsize=ik.report.SMALL)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def figure_4(record: Row) -> Figure:
    """The five criteria beside trials drawn at random: length left, on geometric mean."""
    found = list(cases(record))
    figure = Figure(figsize=(1.6 + 1.35 * len(found), 4.2), layout="constrained")
    axes = figure.add_subplot()
    for x, (_, _, case) in enumerate(found):
        before = case["advice"]["width"]["lengths_before"]
        drawn = [relative(row["lengths"], before) for row in case["random"]]
        spread = np.linspace(-0.32, 0.32, len(drawn)) if len(drawn) > 1 else [0.0]
        label = "drawn at random" if x == 0 else None
        axes.plot(x + np.array(spread), sorted(drawn), ".", color=ik.report.GREY, label=label)
        for k, (criterion, one) in enumerate(case["advice"].items()):
            axes.plot(
                x + 0.12 * (k - 2),
                relative(one["lengths"], before),
                ik.report.MARKERS[k % len(ik.report.MARKERS)],
                color=ik.report.COLOURS[k % len(ik.report.COLOURS)],
                markeredgecolor=ik.report.BLACK,
                label=criterion if x == 0 else None,
            )
    axes.axhline(1.0, color="0.8", linewidth=0.8, zorder=0)
    axes.set_xticks(range(len(found)), [f"{knee}\n{made}" for knee, made, _ in found], fontsize=7)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("relative length of the targets' intervals")
    axes.legend(frameon=False, fontsize=ik.report.SMALL, ncols=3)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def figure_5(record: Row) -> Figure:
    """Length of the targets' intervals on new noisy data, with the added trials and without."""
    found = list(cases(record))
    figure = Figure(figsize=(1.6 + 1.35 * len(found), 4.0), layout="constrained")
    axes = figure.add_subplot()
    for x, (_, _, case) in enumerate(found):
        before = case["advice"]["width"]["lengths_before"]
        for k, name in enumerate(("without", "with")):
            values = sorted(relative(row[name]["lengths"], before) for row in case["redone"])
            spread = np.linspace(-0.14, 0.14, len(values)) if len(values) > 1 else [0.0]
            place = x + 0.36 * (k - 0.5) + np.array(spread)
            label = ("as measured", "with the trials added")[k] if x == 0 else None
            axes.plot(
                place,
                values,
                ik.report.MARKERS[k],
                color=ik.report.COLOURS[k],
                markersize=4,
                label=label,
            )
        predicted = relative(case["advice"]["width"]["lengths"], before)
        label = "expected" if x == 0 else None
        axes.plot([x - 0.05, x + 0.4], [predicted] * 2, "-", color=ik.report.BLACK, label=label)
    axes.set_xticks(range(len(found)), [f"{knee}\n{made}" for knee, made, _ in found], fontsize=7)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("relative length of the targets' intervals")
    axes.legend(frameon=False, fontsize=ik.report.SMALL)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


FIGURE_OF = {
    "figure_1_candidates": figure_1,
    "figure_2_intervals": figure_2,
    "figure_3_predicted": figure_3,
    "figure_4_criteria": figure_4,
    "figure_5_new_data": figure_5,
}


if __name__ == "__main__":
    main()
