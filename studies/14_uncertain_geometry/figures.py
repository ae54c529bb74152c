"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from matplotlib.figure import Figure
from scipy.stats import binomtest, chi2

import identknee as ik

KNEE = "reference"
# Half of a 95 % interval, in standard deviations.
HALF = 1.96
# What the literature says of a stiffness, the log-sd of its usual prior, as such a half width [%].
PRIOR = 100.0 * HALF * 0.35
TICKS = ((10, 20, 50), (0.3, 1, 3), (1, 3, 10))
Row = Mapping[str, Any]


class Level:
    """All fits at one quality of the geometry."""

    def __init__(self, part: Row, insertions_mm: float, frames: float) -> None:
        where = (insertions_mm, frames)
        self.rows = [x for x in part["fits"] if (x["insertions_mm"], x["frames"]) == where]
        self.verdicts = Counter(
            x["verdict"] for x in part["verdicts"] if (x["insertions_mm"], x["frames"]) == where
        )
        self.label = label(insertions_mm, frames)
        self.fitted = [x for x in self.rows if x["theta"] is not None]
        self.size = np.abs(np.array([*part["truth"], *part["true_forces"]]))
        self.m = len(part["forces"])

    @property
    def half_widths(self) -> ik.runs.Array:
        """Median half width of the 95 % intervals: stiffness, strain, force; shape ``(3, m)``."""
        sds = np.array([x["sd"] for x in self.fitted], dtype=np.float64)
        # A force in a trial without equilibrium is not known at all.
        widths = HALF * np.median(np.where(np.isnan(sds), np.inf, sds), axis=0)
        is_strain = np.arange(3 * self.m) // self.m == 1
        return np.asarray(np.where(is_strain, widths, 100.0 * widths / self.size)).reshape(3, -1)

    def covered(self, first: int, last: int) -> tuple[int, int]:
        """How many of the true values the 95 % intervals hold, and how many there are."""
        limit = chi2.ppf(0.95, 1)
        ratios = [x["ratios"][first:last] for x in self.fitted]
        held = sum(y is not None and y <= limit for row in ratios for y in row)
        return held, len(self.rows) * (last - first)


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def label(insertions_mm: float, frames: float) -> str:
    """What is stated of the geometry."""
    parts = [f"insertions {insertions_mm:g} mm"] if insertions_mm else []
    parts += [f"frames {frames:g} deg, {frames:g} mm"] if frames else []
    return ", ".join(parts) or "exact"


def levels_of(record: Row) -> list[Level]:
    """The levels in the order of the record."""
    part = record["knees"][KNEE]
    return [Level(part, *x) for x in record["head"]["settings"]["levels"]]


def figure_1(record: Row) -> Figure:
    """What is known about each ligament at each quality of the geometry."""
    part, levels = record["knees"][KNEE], levels_of(record)
    widths = np.array([x.half_widths for x in levels])
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    titles = ("stiffness [% of it]", "reference strain [% strain]", "largest force [% of it]")
    names = [x.partition("@")[0] for x in part["forces"]]
    places = -np.arange(len(levels))
    for j, (axes, title, ticks) in enumerate(zip(panels, titles, TICKS, strict=True)):
        for k, name in enumerate(names):
            axes.plot(
                widths[:, j, k],
                places + 0.15 * (1.5 - k),
                ik.report.MARKERS[k],
                color=ik.report.COLOURS[k],
                label=name,
            )
        axes.set_xscale("log")
        axes.set_xlim(0.7 * widths[:, j].min(), 1.4 * widths[:, j].max())
        axes.set_xticks(ticks, [f"±{x:g}" for x in ticks])
        axes.minorticks_off()
        axes.grid(axis="x", color="0.9")
        axes.set_axisbelow(True)
        axes.set_title(title, fontsize=10)
        axes.set_yticks(places, [x.label for x in levels])
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].axvspan(PRIOR, 1e3, color="0.88", zorder=0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {"figure_1_known": figure_1}


def tables(record: Row) -> dict[str, ik.report.Table]:
    """Tables of the page by name."""
    return {
        "coverage": coverage_table(record),
        "known": known_table(record),
        "ends": ends_table(record),
    }


def coverage_table(record: Row) -> ik.report.Table:
    """How often 95 % intervals hold the truth."""
    rows: list[tuple[Cell, ...]] = []
    for level in levels_of(record):
        cells: list[Cell] = [level.label, len(level.rows)]
        for first, last in ((0, 2 * level.m), (2 * level.m, 3 * level.m)):
            held, n = level.covered(first, last)
            low, high = binomtest(held, n).proportion_ci(0.95, "exact")
            cells.append(f"{100 * held / n:.0f} ({100 * low:.0f} to {100 * high:.0f})")
        rows.append(tuple(cells))
    return table(
        "Coverage of 95 % intervals, with exact binomial intervals as if values were independent",
        "geometry, stated as it is; replicates | 0; parameters [%]; largest forces [%]",
        rows,
    )


def known_table(record: Row) -> ik.report.Table:
    """Median half width of the intervals at each quality."""
    part = record["knees"][KNEE]
    names = [x.partition("@")[0] for x in part["forces"]]
    rows: list[tuple[Cell, ...]] = []
    for level in levels_of(record):
        stiffness, strain, force = level.half_widths
        cells = [
            f"{a:.0f}; {b:.1f}; {c:.0f}" for a, b, c in zip(stiffness, strain, force, strict=True)
        ]
        rows.append((level.label, *cells))
    return table(
        "Half width of the 95 % intervals, median: stiffness [% of it]; reference strain "
        "[% strain]; largest force [% of it]",
        ["geometry", *names],
        rows,
    )


def ends_table(record: Row) -> ik.report.Table:
    """How the fits ended, and what diagnoses of the same data say."""
    rows: list[tuple[Cell, ...]] = []
    for level in levels_of(record):
        outcomes = Counter(x["outcome"] for x in level.fitted)
        rows.append(
            (
                level.label,
                len(level.rows) - len(level.fitted),
                *(outcomes[x] for x in ("minimum", "valley", "cliff")),
                min((x["n_trials"] for x in level.fitted), default=None),
                float(np.median([x["n_simulations"] for x in level.fitted])),
                ", ".join(f"{n} {x}" for x, n in sorted(level.verdicts.items())) or "none made",
            )
        )
    return table(
        "How the fits ended, the fewest trials of 63 that one rests on, and verdicts of `diagnose`",
        "geometry; no prediction | 0; minimum | 0; valley | 0; cliff | 0; fewest trials | 0; "
        "simulations a fit and its 12 intervals | 0; verdicts",
        rows,
    )


if __name__ == "__main__":
    main()
