"""Fast part of the study: draws its two figures and fills the page of the paper from the records.

The page is ``docs/paper.md``, and its pictures are in ``docs/paper``.
"""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from beyond_tables import beyond
from common.page import filled
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from other_studies import STUDIES, record_of
from page_numbers import numbers
from page_tables import (
    CHECKS,
    GUESSES,
    PAPER,
    QUANTITIES,
    SOURCES,
    Found,
    course,
    forces,
    knees,
    paper_errors,
    tables,
)

import identknee as ik

DOCS = STUDIES.parent / "docs"
NUMBER = re.compile(r"(<!--=(\S+?)-->).*?(<!--/-->)", re.DOTALL)
COLOURS = {"IG1": "#0072B2", "IG2": "#009E73", "IG3": "#E69F00", "IG4": "#D55E00"}
LINES = ("-", "--", ":")
PANELS = ("stiffness [kN]", "reference strain [%]", *QUANTITIES.values())
MISTAKES = (
    ("errors as small as the paper's from IG1", "o"),
    ("Complex from IG1, worst run", "v"),
    ("Complex from IG4, worst run", "s"),
    ("IG4 itself, no fit", "D"),
    ("equivalent by the paper's criterion", "P"),
)
LEAST_N = 0.5  # what is smaller is drawn there


def main() -> None:
    """Draw all figures and fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=DOCS / "paper", help="folder of the figures")
    parser.add_argument("--page", type=Path, default=DOCS / "paper.md", help="page to fill")
    options = parser.parse_args()
    found = {study: record_of(study) for study in SOURCES}
    if found[GUESSES] is not None and found[CHECKS] is not None:
        ik.runs.prepare_folder(options.out)
        for name, draw in {"course": course_figure, "forces": force_figure}.items():
            ik.runs.write_atomically(options.out / f"{name}.png", ik.report.png(draw(found)))
    text = options.page.read_text(encoding="utf-8")
    text = filled(text, {**tables(found), **beyond(found)})
    ik.runs.write_atomically(options.page, with_numbers(text, numbers(found)))


def with_numbers(text: str, text_of: Callable[[str], str]) -> str:
    """`text` with each number between ``<!--=NAME-->`` and ``<!--/-->`` put in anew.

    Raises
    ------
    ValueError
        If a name is unknown, or if a line begins with a mark: Markdown would take the whole line
        for a comment.
    """
    for line in text.splitlines():
        if line.lstrip().startswith(("<!--=", "<!--/")):
            raise ValueError(f"a line must not begin with the mark of a number: {line[:40]}")
    return NUMBER.sub(lambda match: f"{match[1]}{text_of(match[2])}{match[3]}", text)


def course_figure(found: Found) -> Figure:
    """Errors along the searches, with the paper's at the right edge."""
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    panels[-1].axis("off")
    for i, (axes, title) in enumerate(zip(panels[:-1], PANELS, strict=True)):
        for start, colour in COLOURS.items():
            for line, name in zip(LINES, knees(found), strict=False):
                counts, errors = course(found, name, start)
                label = f"{start}, {name}" if i == 0 else None
                axes.plot(counts, errors[:, i], line, color=colour, marker=".", label=label)
            axes.axhline(paper_errors(start)[i], color=colour, linewidth=0.8, alpha=0.5)
            own = {"marker": "*", "markersize": 13, "markeredgecolor": "black", "clip_on": False}
            axes.plot(2600, paper_errors(start)[i], color=colour, linestyle="", **own)
        axes.set_xscale("log")
        axes.set_xlim(18, 2600)
        axes.set_ylim(bottom=0.0)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("simulations")
        bare(axes)
    panels[-1].legend(*panels[0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure


def force_figure(found: Found) -> Figure:
    """Differences of tension by scenario: the paper's bars, and ours as marks."""
    figure = Figure(figsize=(9.0, 7.6), layout="constrained")
    labels = list(PAPER.PAPER_TABLE7)
    places = np.arange(len(labels))
    panels = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    for j, (axes, ligament) in enumerate(zip(panels, PAPER.PAPER_LIGAMENTS, strict=True)):
        for s, start in enumerate(PAPER.FORCE_STARTS):
            heights = [PAPER.PAPER_TABLE7[x][j][s] for x in labels]
            shift = 0.2 * (2 * s - 1)
            axes.bar(
                places + shift,
                heights,
                0.36,
                color=("#BBBBBB", "#777777")[s],
                label=f"the paper, {start}" if j == 0 else None,
            )
        mark_forces(axes, found, ligament, is_named=j == 0)
        axes.set_yscale("log")
        axes.set_ylim(LEAST_N, 600)
        axes.set_title(ligament, fontsize=10)
        axes.set_xticks(places, labels, rotation=40, ha="right", fontsize=9)
        bare(axes)
    figure.supylabel("largest difference of tension [N]", fontsize=10)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def mark_forces(axes: Axes, found: Found, ligament: str, *, is_named: bool) -> None:
    """Our differences: filled for the first knee, hollow for the second."""
    rows = range(len(PAPER.PAPER_TABLE7))
    for k, name in enumerate(knees(found)):
        values = np.array(
            [forces(found, name, "scenario", (i, ligament))[: len(MISTAKES)] for i in rows], float
        )
        for m, (label, marker) in enumerate(MISTAKES):
            if np.isnan(values[:, m]).all():
                continue
            colour = ("#0072B2", "#56B4E9", "#D55E00", "#000000", "#CC79A7")[m]
            axes.plot(
                np.arange(len(values)) + 0.09 * (m - 2),
                np.maximum(values[:, m], LEAST_N),
                linestyle="",
                marker=marker,
                markersize=5,
                color=colour,
                markerfacecolor=colour if k == 0 else "white",
                clip_on=False,
                label=label if is_named and k == 0 else None,
            )


def bare(axes: Axes) -> None:
    """No frame above and to the right."""
    axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main()
