"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import draw_study
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from score_card import (
    NULLS,
    ONE,
    SILENT,
    Ending,
    cases_of,
    ending,
    sentences,
    series_of,
    signals_of,
    tables,
    values_of,
)

import identknee as ik
from identknee.model.effects.facts import cause_label

TINY = 7
COLOUR_OF = {
    Ending.RIGHT: ik.report.COLOURS[0],
    Ending.GROUP: ik.report.COLOURS[5],
    Ending.OPEN: ik.report.COLOURS[4],
    Ending.MISSED: "0.8",
    Ending.WRONG: ik.report.COLOURS[1],
}
# So that the card reads without colours too.
SIGN_OF = {
    Ending.RIGHT: "right",
    Ending.GROUP: "group",
    Ending.OPEN: "not named",
    Ending.MISSED: "missed",
    Ending.WRONG: "WRONG",
}
MOST_RATIO = 3.0
# Of an interval that the data leave open.
NO_END = (-np.inf, np.inf)
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(
        __file__,
        {name: of_cases(draw) for name, draw in FIGURE_OF.items()},
        lambda record: {**tables(record), **sentences(record)},
    )


def of_cases(draw: Callable[[Sequence[Row]], Figure]) -> Callable[[Row], Figure]:
    """What draws the same from the whole record."""
    return lambda record: draw(cases_of(record))


def score_card_figure(cases: Sequence[Row]) -> Figure:
    """Every single effect by signal, and all series as shares."""
    alone = [x for x in cases if x["series"] == ONE]
    signals = signals_of(alone)[::-1]
    names = list(ik.blind.LISTED)
    figure = Figure(figsize=(10.4, 6.6), layout="constrained")
    card, shares = figure.subplots(1, 2, width_ratios=[1.0, 1.5])
    kinds = list(Ending)
    for column, signal in enumerate(signals):
        for row, name in enumerate(names):
            own = [x for x in alone if x["wanted"] == signal and x["effects"] == [name]]
            _draw_cell(card, column, row, own)
    card.set_xlim(-0.5, len(signals) - 0.5)
    card.set_ylim(len(names) - 0.5, -0.5)
    card.set_xticks(
        range(len(signals)), [f"signal {x:g}" for x in signals], fontsize=ik.report.SMALL
    )
    card.xaxis.tick_top()
    card.set_yticks(range(len(names)), [*map(cause_label, names)], fontsize=ik.report.SMALL)
    card.tick_params(length=0)
    card.spines[:].set_visible(False)
    series = series_of(cases)
    for row, own in enumerate(series.values()):
        left = 0.0
        for kind in kinds:
            count = sum(ending(x) is kind for x in own)
            width = count / len(own)
            shares.barh(row, width, 0.7, left=left, color=COLOUR_OF[kind], edgecolor="white")
            if count:
                place, colour = left + 0.5 * width, _ink(kind)
                shares.text(place, row, str(count), ha="center", va="center", color=colour)
            left += width
    shares.set_yticks(range(len(series)), [_series_label(*x) for x in series.items()], fontsize=9)
    shares.set_ylim(len(series) - 0.4, -0.6)
    shares.set_xlabel("share of the cases (numbers count cases)")
    shares.spines[["top", "right"]].set_visible(False)
    handles = [Patch(color=COLOUR_OF[x], label=f"{x}") for x in kinds]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    return figure


def confusion_figure(cases: Sequence[Row]) -> Figure:
    """What was diagnosed of what was hidden, one effect at a time or none."""
    shown = [x for x in cases if len(x["effects"]) < 2]
    truths = [*ik.blind.LISTED, *ik.blind.UNLISTED, NULLS]
    last = ("missing_line", "unexplained", "adequate", "not testable")
    # Some causes that a diagnosis knows are hidden in no case of this study.
    named = dict.fromkeys([*ik.blind.LISTED, *(x for case in shown for x in _answers(case))])
    answers = [*(x for x in named if x not in last), *last]
    values = np.zeros((len(truths), len(answers)))
    for x in shown:
        row = truths.index(x["effects"][0] if x["effects"] else NULLS)
        given = _answers(x)
        for name in given:
            values[row, answers.index(name)] += 1.0 / len(given)
    totals = values.sum(axis=1, keepdims=True)
    values = np.divide(values, totals, out=np.zeros_like(values), where=totals > 0.0)
    figure = Figure(figsize=(9.6, 8.8), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(np.where(values > 0.0, values, np.nan), cmap="cividis_r", vmin=0, vmax=1)
    figure.colorbar(
        image, ax=axes, shrink=0.6, label="share of the cases (members of a group in equal parts)"
    )
    axes.set_xticks(range(len(answers)), [*map(cause_label, answers)], rotation=90, fontsize=TINY)
    axes.set_yticks(range(len(truths)), [*map(cause_label, truths)], fontsize=TINY)
    axes.set_xlabel("diagnosed")
    axes.set_ylabel("hidden")
    for row, name in enumerate(truths):
        right = {NULLS: "adequate"}.get(name, name if name in answers else "unexplained")
        place = answers.index(right)
        axes.plot(
            np.array([-0.5, 0.5, 0.5, -0.5, -0.5]) + place,
            np.array([-0.5, -0.5, 0.5, 0.5, -0.5]) + row,
            color=ik.report.BLACK,
            linewidth=0.9,
        )
    axes.set_xticks(np.arange(len(answers)) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(truths)) - 0.5, minor=True)
    axes.grid(which="minor", color="0.93", linewidth=0.5)
    axes.tick_params(which="minor", length=0)
    return figure


def parameters_figure(cases: Sequence[Row]) -> Figure:
    """Error of the ligament parameters without and with the causes."""
    figure = Figure(figsize=(9.4, 4.8), layout="constrained")
    labels = {"stiffness_error_kN": "stiffness error [kN]", "strain_error_pct": "strain error [%]"}
    for axes, (name, label) in zip(figure.subplots(1, 2), labels.items(), strict=True):
        known = [x for x in cases if x["effects"] and x["causes"] and None not in x[name]]
        for k, kind in enumerate(Ending):
            own = values_of([x for x in known if ending(x) is kind], name)
            if len(own):
                axes.plot(
                    *own.T,
                    ik.report.MARKERS[k],
                    color=COLOUR_OF[kind],
                    markeredgecolor=ik.report.BLACK,
                    markeredgewidth=0.4,
                    markersize=5,
                    label=f"{kind}, {len(own)}",
                )
        values = values_of(known, name)
        ends = np.array([0.8 * values.min(), 1.25 * values.max()])
        axes.plot(ends, ends, color=ik.report.GREY, linewidth=0.8)
        axes.plot(ends, 0.5 * ends, ":", color=ik.report.GREY, linewidth=0.9)
        axes.set(xscale="log", yscale="log", xlabel=f"{label} before", ylabel="after")
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(fontsize=ik.report.SMALL, frameon=False, loc="upper left")
    figure.suptitle(
        "Below the full line the cause reduced the error; below the dotted line it halved it.",
        fontsize=9,
    )
    return figure


def amplitudes_figure(cases: Sequence[Row]) -> Figure:
    """Amplitude found over true, with its 95 % interval, of every true cause named."""
    names = [*ik.blind.LISTED, "missing_line"]
    figure = Figure(figsize=(6.8, 7.2), layout="constrained")
    axes = figure.add_subplot()
    axes.axvline(1.0, color=ik.report.GREY, linewidth=0.9)
    for row, name in enumerate(names):
        found = [(x, a) for x in cases for a in x["amplitudes"] if a["name"] == name]
        for k, (x, a) in enumerate(found):
            kind = ending(x)
            ends = (y if y is not None else z for y, z in zip(a["ci95"], NO_END, strict=True))
            low, high = sorted(y / a["true"] for y in ends)
            value = a["found"] / a["true"]
            place = row + 0.6 * ((k + 0.5) / len(found) - 0.5)
            axes.plot(np.clip([low, high], 0.0, MOST_RATIO), [place] * 2, color=COLOUR_OF[kind])
            axes.plot(
                np.clip(value, 0.0, MOST_RATIO),
                place,
                ik.report.MARKERS[list(Ending).index(kind)],
                color=COLOUR_OF[kind],
                markersize=4,
                markeredgecolor=ik.report.BLACK,
                markeredgewidth=0.4,
            )
    axes.set_yticks(range(len(names)), [*map(cause_label, names)], fontsize=ik.report.SMALL)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(-0.05, MOST_RATIO + 0.05)
    axes.set_xlabel(f"amplitude found over true, 95 % intervals, cut at 0 and {MOST_RATIO:g}")
    axes.spines[["top", "right"]].set_visible(False)
    handles = [
        axes.plot([], [], ik.report.MARKERS[k], color=COLOUR_OF[x], label=str(x), markersize=5)[0]
        for k, x in enumerate(Ending)
        if x is not Ending.MISSED
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def _draw_cell(axes: Axes, column: int, row: int, own: Sequence[Row]) -> None:
    """The cases of one effect and signal beside each other."""
    width = 0.96 / max(len(own), 1)
    for k, x in enumerate(own):
        kind = ending(x)
        left = column - 0.48 + k * width
        axes.barh(row, width, 0.92, left=left, color=COLOUR_OF[kind], edgecolor="white")
        text = SIGN_OF[kind] + ("*" if x["is_largest"] else "")
        axes.text(
            left + 0.5 * width,
            row,
            text,
            ha="center",
            va="center",
            fontsize=TINY,
            color=_ink(kind),
        )


def _ink(kind: Ending) -> str:
    """What can be read on the colour of an ending."""
    return "white" if kind in (Ending.RIGHT, Ending.WRONG) else ik.report.BLACK


def _series_label(name: str, cases: Sequence[Row]) -> str:
    return f"{name}\n{len(cases)} cases"


def _answers(case: Row) -> list[str]:
    """What a diagnosis says, the members of a group each."""
    verdict = case["verdict"]
    if verdict in SILENT:
        return [verdict.lower().replace("_", " ")]
    if verdict == "UNEXPLAINED":
        return case["causes"] or ["unexplained"]
    return list(dict.fromkeys([*case["causes"], *case["group"]]))


FIGURE_OF: Mapping[str, Callable[[Sequence[Row]], Figure]] = {
    "figure_1_score_card": score_card_figure,
    "figure_2_confusion": confusion_figure,
    "figure_3_parameters": parameters_figure,
    "figure_4_amplitudes": amplitudes_figure,
}


if __name__ == "__main__":
    main()
