"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import beta, chi2
from scipy.stats import f as f_distribution

import identknee as ik
from identknee.runs.declare import BoolArray

KNEE = "reference"
UNITS = {"none": "", "insertions": "mm", "load axes": "deg", "tibial frame": "deg"}
Row = Mapping[str, Any]


class Level:
    """All fits of one kind and size of error."""

    def __init__(self, part: Row, kind: str, size: float) -> None:
        rows = [x for x in part["fits"] if x["kind"] == kind and x["size"] == size]
        self.kind, self.size, self.n = kind, size, len(rows)
        self.label = kind if kind == "none" else f"{kind} {size:g} {UNITS[kind]}"
        self.fitted = [x for x in rows if x["theta"] is not None]
        self.p = len(part["parameters"])
        self.n_forces = len(part["forces"])
        self.residuals = part["n_residuals"]
        width = self.p + self.n_forces
        self.theta = numbers([x["theta"] for x in self.fitted], self.p)
        self.forces = numbers([x["forces"] for x in self.fitted], self.n_forces)
        self.force_rms = numbers([x["force_rms_N"] for x in self.fitted], self.n_forces)
        self.deviance = numbers([[x["deviance"]] for x in self.fitted], 1)[:, 0]
        # A true value that no constrained fit reaches is one that is not covered.
        ratios = numbers([x["ratios"] for x in self.fitted], width)
        self.ratios = np.where(np.isnan(ratios), np.inf, ratios)

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the fit."""
        return int(self.residuals - self.p)

    @property
    def is_covered(self) -> BoolArray:
        """Whether the 95 % interval for the stated noise holds the truth, all replicates."""
        return self._all(self.ratios <= chi2.ppf(0.95, 1))

    @property
    def is_covered_scaled(self) -> BoolArray:
        """The same with the noise estimated from what the fit leaves, and an F threshold."""
        variance = self.deviance / self.degrees
        threshold = f_distribution.ppf(0.95, 1, self.degrees)
        return self._all(self.ratios <= threshold * variance[:, None])

    @property
    def misfit_share(self) -> float:
        """Share of the fits whose residuals are too large for the stated noise, at 5 %."""
        limit = chi2.ppf(0.95, self.degrees)
        missing = self.n - len(self.fitted)
        return float((np.sum(self.deviance > limit) + missing) / self.n)

    def _all(self, covered: BoolArray) -> BoolArray:
        """With the replicates that could not be fitted, which cover nothing."""
        missing = np.zeros((self.n - len(covered), covered.shape[1]), dtype=np.bool_)
        return np.vstack([covered, missing])


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def levels_of(record: Row) -> list[Level]:
    """The levels in the order of the record."""
    part = record["knees"][KNEE]
    return [Level(part, kind, size) for kind, size in record["head"]["settings"]["levels"]]


def figure_1(record: Row) -> Figure:
    """Coverage of the 95 % intervals at each level."""
    part, levels = record["knees"][KNEE], levels_of(record)
    names = [*map(short, part["parameters"]), *map(short_force, part["forces"])]
    figure = Figure(figsize=(9.0, 6.6), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    titles = ("noise as stated", "noise estimated from the misfit (F threshold)")
    for axes, title, scaled in zip(panels, titles, (False, True), strict=True):
        _coverage(axes, levels, names, scaled=scaled)
        axes.set_title(title, fontsize=10)
    panels[1].set_xticks(
        range(len(levels)),
        [x.label for x in levels],
        rotation=30,
        ha="right",
        fontsize=ik.report.SMALL,
    )
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=6,
        frameon=False,
        fontsize=ik.report.SMALL,
    )
    return figure


def figure_2(record: Row) -> Figure:
    """Errors of the parameters at each level."""
    part, levels = record["knees"][KNEE], levels_of(record)
    truth = np.array(part["truth"])
    m = len(truth) // 2
    figure = Figure(figsize=(0.9 + 2.4 * m, 6.0), layout="constrained")
    grid = figure.subplots(2, m, squeeze=False, sharex=True, sharey="row")
    for j, name in enumerate(part["parameters"]):
        axes = grid[j // m, j % m]
        _spreads(axes, [x.theta[:, j] - truth[j] for x in levels])
        axes.set_title(short(name), fontsize=10)
        _name_levels(axes, levels)
    grid[0, 0].set_ylabel("error of stiffness [kN]")
    grid[1, 0].set_ylabel("error of reference strain [%]")
    return figure


def figure_3(record: Row) -> Figure:
    """Errors of the largest ligament forces at each level."""
    part, levels = record["knees"][KNEE], levels_of(record)
    truth = np.array(part["true_forces"])
    figure = Figure(figsize=(0.9 + 2.4 * len(truth), 3.6), layout="constrained")
    grid = figure.subplots(1, len(truth), squeeze=False, sharey=True)[0]
    for j, (axes, name) in enumerate(zip(grid, part["forces"], strict=True)):
        _spreads(axes, [x.forces[:, j] - truth[j] for x in levels])
        axes.set_title(f"{short_force(name)}, {truth[j]:.0f} N", fontsize=10)
        _name_levels(axes, levels)
    grid[0].set_ylabel("error of the largest force [N]")
    return figure


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_coverage": figure_1,
    "figure_2_parameters": figure_2,
    "figure_3_forces": figure_3,
}


def tables(record: Row) -> dict[str, ik.report.Table]:
    """Tables of the page by name."""
    return {
        "coverage": coverage_table(record),
        "bias": bias_table(record),
        "forces": forces_table(record),
        "ends": ends_table(record),
    }


def coverage_table(record: Row) -> ik.report.Table:
    """Coverage of parameters and forces, and whether the misfit warns."""
    rows: list[tuple[Cell, ...]] = []
    for level in levels_of(record):
        cells: list[Cell] = [level.label, level.n]
        for covered in (level.is_covered, level.is_covered_scaled):
            parts = (covered[:, : level.p], covered[:, level.p :])
            cells += [100.0 * float(part.mean()) for part in parts]
            each = 100.0 * covered[:, : level.p].mean(axis=0)
            cells.append(f"{each.min():.0f} to {each.max():.0f}")
        rows.append((*cells, 100.0 * level.misfit_share))
    return table(
        "Coverage of 95 % intervals, and fits whose misfit warns (chi-squared, 5 %)",
        "error of the geometry; replicates | 0; parameters [%] | 1; forces [%] | 1; "
        "single parameters [%]; parameters, noise from misfit [%] | 1; "
        "forces, noise from misfit [%] | 1; single parameters, noise from misfit [%]; "
        "misfit warns [%] | 0",
        rows,
    )


def bias_table(record: Row) -> ik.report.Table:
    """Mean error of each parameter with its standard error, and the spread."""
    part = record["knees"][KNEE]
    truth = np.array(part["truth"])
    rows: list[tuple[Cell, ...]] = []
    for level in levels_of(record):
        error = level.theta - truth
        if not len(error):
            rows.append((level.label, *[None] * len(truth)))
            continue
        mean, sd = error.mean(axis=0), error.std(axis=0)
        cells = [f"{a:+.2f} ({b:.2f})" for a, b in zip(mean, sd, strict=True)]
        rows.append((level.label, *cells))
    return ik.report.Table(
        title="Error of the fitted parameters: mean (sd) over replicates",
        columns=(
            ik.report.Column(name="error of the geometry"),
            *(
                ik.report.Column(name=short(x), unit="kN" if x.endswith("_kN") else "%")
                for x in part["parameters"]
            ),
        ),
        rows=tuple(rows),
    )


def forces_table(record: Row) -> ik.report.Table:
    """Root mean square error of each ligament's tension over all trials."""
    part = record["knees"][KNEE]
    rows: list[tuple[Cell, ...]] = []
    for level in levels_of(record):
        cells: list[Cell] = [level.label]
        for j in range(level.n_forces):
            values = level.force_rms[:, j]
            low, middle, high = (
                np.quantile(values, [0.05, 0.5, 0.95]) if len(values) else (np.nan,) * 3
            )
            cells.append(f"{middle:.0f} [{low:.0f}, {high:.0f}]")
        rows.append(tuple(cells))
    return table(
        "Error of tension over the 63 trials, root mean square: median [5 %, 95 %]",
        ["error of the geometry", *(f"{short_force(x)} [N]" for x in part["forces"])],
        rows,
    )


def ends_table(record: Row) -> ik.report.Table:
    """How the fits ended and what they left."""
    rows: list[tuple[Cell, ...]] = []
    for level in levels_of(record):
        outcomes = [x["outcome"] for x in level.fitted]
        reduced = level.deviance / level.degrees
        at_bound = [any(x["at_bound"]) for x in level.fitted]
        rows.append(
            (
                level.label,
                level.n - len(level.fitted),
                *(outcomes.count(x) for x in ("minimum", "valley", "cliff")),
                sum(at_bound),
                float(np.median(np.sqrt(reduced))) if len(reduced) else None,
                float(np.max(np.sqrt(reduced))) if len(reduced) else None,
            )
        )
    return table(
        "How the fits ended",
        "error of the geometry; no prediction anywhere | 0; minimum | 0; valley | 0; cliff | 0; "
        "a parameter at its bound | 0; misfit over noise, median; misfit over noise, worst",
        rows,
    )


def numbers(rows: list[Any], width: int) -> ik.runs.Array:
    """Numbers of the record, shape ``(n, width)``; what JSON has as null is NaN."""
    return np.array(rows, dtype=np.float64).reshape(len(rows), width)


def short(parameter: str) -> str:
    """Owner and kind of a parameter."""
    owner, _, kind = parameter.rpartition(".")
    return f"{owner} {'stiffness' if kind.endswith('_kN') else 'strain'}"


def short_force(name: str) -> str:
    """Ligament of a force."""
    return f"{name.partition('@')[0]} force"


def _coverage(axes: Axes, levels: list[Level], names: list[str], *, scaled: bool) -> None:
    """Coverage of each quantity by level, with the 95 % interval of the control's count."""
    n = max(level.n for level in levels)
    expected = round(0.95 * n)
    low = beta.ppf(0.025, expected, n - expected + 1)
    high = beta.ppf(0.975, expected + 1, max(n - expected, 1e-9))
    axes.axhspan(100 * low, 100 * high, color="0.9", zorder=0)
    axes.axhline(95.0, color=ik.report.GREY, linewidth=0.8)
    offsets = np.linspace(-0.32, 0.32, len(names))
    for k, name in enumerate(names):
        values = [
            100.0 * (x.is_covered_scaled if scaled else x.is_covered)[:, k].mean() for x in levels
        ]
        axes.plot(
            np.arange(len(levels)) + offsets[k],
            values,
            ik.report.MARKERS[k % len(ik.report.MARKERS)],
            color=ik.report.COLOURS[k % len(ik.report.COLOURS)],
            fillstyle="full" if k < len(ik.report.COLOURS) else "none",
            markersize=4.5,
            label=name,
        )
    axes.set_ylim(-3, 103)
    axes.set_ylabel("covered [%]")
    axes.spines[["top", "right"]].set_visible(False)


def _spreads(axes: Axes, errors: list[ik.runs.Array]) -> None:
    """Median, quartiles and 5 % to 95 % of each list of errors."""
    for k, values in enumerate(errors):
        if len(values):
            low, first, middle, third, high = np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95])
            axes.plot([k, k], [low, high], color=ik.report.COLOURS[0], linewidth=1.0)
            axes.plot([k, k], [first, third], color=ik.report.COLOURS[0], linewidth=4.5)
            axes.plot(k, middle, ik.report.MARKERS[0], color=ik.report.BLACK, markersize=3.5)
    axes.axhline(0.0, color=ik.report.GREY, linewidth=0.8, zorder=0)
    axes.spines[["top", "right"]].set_visible(False)


def _name_levels(axes: Axes, levels: list[Level]) -> None:
    axes.set_xticks(
        range(len(levels)), [x.label for x in levels], rotation=90, fontsize=ik.report.SMALL
    )


if __name__ == "__main__":
    main()
