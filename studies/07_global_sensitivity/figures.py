"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table, turn_ticks
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import identknee as ik
from identknee.report.figures import COLOURS, GREY, MARKERS, SMALL, bare, legend_below
from identknee.runs.words import coordinate_words, label

KNEE = "reference"
# What a clinician turns the knee by, at its middle angle.
SHOWN = (
    "internal_deg, 30 deg, internal moment",
    "internal_deg, 30 deg, external moment",
    "varus_deg, 30 deg, varus moment",
    "varus_deg, 30 deg, valgus moment",
)
FAILURE = "failure"
# Of each method over the posterior, the index drawn.
METHODS = {
    "morris": "Morris",
    "sobol": "Sobol",
    "delta": "delta",
    "pawn": "PAWN",
    "hdmr": "HDMR",
    "shapley": "Shapley",
}
OVER_POSTERIOR = {"delta": "delta", "pawn": "pawn", "hdmr": "ST", "shapley": "shapley"}
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, {name: of_knee(draw) for name, draw in FIGURE_OF.items()}, tables)


def of_knee(draw: Callable[[Row], Figure]) -> Callable[[Row], Figure]:
    """What draws the same from the whole record."""
    return lambda record: draw(record["knees"][KNEE])


def figure_1(part: Row) -> Figure:
    """Total Sobol indices of every group."""
    row = part["sobol"]
    values = array(row["indices"]["ST"]["value"])
    rows: dict[str, list[tuple[str, ik.runs.Array]]] = {}
    for name, line in zip(row["groups"], values, strict=True):
        coordinate, _, where = name.partition(", ")
        if name != FAILURE:
            rows.setdefault(coordinate, []).append((where, line))
    ordered = {}
    for coordinate, lines in rows.items():
        # By load, then by angle, which is how one looks for a pattern.
        lines.sort(key=lambda x: x[0].partition(", ")[::-1])
        ordered[label(coordinate)] = ([name for name, _ in lines], np.array([x for _, x in lines]))
    return ik.report.map_figure(ordered, part["parameters"], "total Sobol index, ST")


def figure_2(part: Row) -> Figure:
    """First-order and total Sobol indices, and how their confidence intervals shrink."""
    row, place = part["sobol"], np.arange(len(part["parameters"]))
    kinds = {"first order, S1": row["indices"]["S1"], "total, ST": row["indices"]["ST"]}
    figure, grid = panels_of(6)
    for axes, name in zip(grid, (*SHOWN, FAILURE), strict=False):
        at = row["groups"].index(name)
        for k, (kind, index) in enumerate(kinds.items()):
            values, widths = array(index["value"])[at], array(index["half_width"])[at]
            axes.bar(
                place + 0.4 * (k - 0.5),
                values,
                0.38,
                yerr=widths,
                color=COLOURS[k],
                error_kw={"elinewidth": 0.9, "capsize": 2},
                label=kind,
            )
        name_panel(axes, name, part["parameters"])
        axes.set_ylim(min(0.0, lowest(row["indices"]["S1"], at)), 1.05)
    grid[0].legend(frameon=False, fontsize=SMALL)
    widths = np.maximum(*(array(x["largest_half_width_by_level"]) for x in kinds.values()))
    levels = row["n_simulations"] / row["n_samples"] * np.array(row["levels"])
    draw_convergence(grid[5], levels, widths[:, :-1])
    return figure


def lowest(index: Row, at: int) -> float:
    """Lowest end of the confidence intervals of one group."""
    return float(np.min(array(index["value"])[at] - array(index["half_width"])[at]))


def draw_convergence(axes: Axes, simulations: ik.runs.Array, widths: ik.runs.Array) -> None:
    """Half-widths against simulations, with the line they should follow."""
    middle = np.nanmedian(widths, axis=1)
    low, high = np.nanmin(widths, axis=1), np.nanmax(widths, axis=1)
    blue = COLOURS[0]
    axes.fill_between(
        simulations, low, high, color=blue, alpha=0.2, linewidth=0, label="all groups"
    )
    axes.plot(simulations, middle, MARKERS[0] + "-", color=blue, label="median group")
    expected = middle[-1] * np.sqrt(simulations[-1] / simulations)
    axes.plot(simulations, expected, ":", color=GREY, label="1 / square root of N")
    axes.axhline(0.02, color=COLOURS[1], linewidth=1.0, linestyle="--", label="0.02")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(simulations, [f"{x:,.0f}" for x in simulations])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("simulations")
    axes.set_title("largest half-width of a group", fontsize=10)
    axes.legend(frameon=False, fontsize=SMALL)
    bare(axes)


def figure_3(part: Row) -> Figure:
    """Elementary effects on the same rotations."""
    row = part["morris"]
    star, sigma = row["indices"]["mu_star"], row["indices"]["sigma"]
    panels = {}
    for name in SHOWN:
        at = row["groups"].index(name)
        panels[f"{in_words(name)} [deg]"] = (
            array(star["value"])[at],
            array(star["half_width"])[at],
            array(sigma["value"])[at],
        )
    return ik.report.effects_figure(panels, part["parameters"])


def figure_4(part: Row) -> Figure:
    """Over the posterior: four methods for correlated parameters."""
    place, offsets = np.arange(len(part["parameters"])), np.linspace(-0.3, 0.3, len(OVER_POSTERIOR))
    figure, grid = panels_of(len(SHOWN))
    for axes, name in zip(grid, SHOWN, strict=True):
        for k, (method, index) in enumerate(OVER_POSTERIOR.items()):
            row = part[method]
            at, found = row["groups"].index(name), row["indices"][index]
            axes.errorbar(
                place + offsets[k],
                array(found["value"])[at],
                yerr=array(found["half_width"])[at],
                fmt=MARKERS[k],
                color=COLOURS[k],
                capsize=2,
                markersize=4,
                label=METHODS[method],
            )
        name_panel(axes, name, part["parameters"])
    handles, labels = grid[0].get_legend_handles_labels()
    legend_below(figure, handles, labels)
    return figure


def panels_of(n: int) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels in two columns."""
    figure = Figure(figsize=(9.0, 0.6 + 2.9 * (n // 2)), layout="constrained")
    return figure, list(figure.subplots(n // 2, 2).ravel())


def name_panel(axes: Axes, name: str, parameters: Sequence[str]) -> None:
    """Name a panel of indices and the parameters along it."""
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    owners = [(x.rpartition(".")[0], x.endswith("_kN")) for x in parameters]
    words = [f"{owner} {'stiffness' if is_k else 'strain'}" for owner, is_k in owners]
    axes.set_xticks(range(len(parameters)), words, fontsize=SMALL)
    turn_ticks(axes, 45)
    axes.set_title(in_words(name), fontsize=10)
    bare(axes)


def in_words(group: str) -> str:
    """A group of outputs as the title of a panel."""
    coordinate, _, where = group.partition(", ")
    return f"{coordinate_words(coordinate)}, {where}" if where else group


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_total_indices": figure_1,
    "figure_2_sobol": figure_2,
    "figure_3_morris": figure_3,
    "figure_4_posterior": figure_4,
}


def tables(record: Row) -> dict[str, ik.report.Table]:
    """Tables of the page by name."""
    return {
        "shares": shares_table(record),
        "failures": failures_table(record),
        "convergence": convergence_table(record),
        "posterior": posterior_table(record),
    }


def shares_table(record: Row) -> ik.report.Table:
    """Mean total index over the groups of each coordinate, by parameter."""
    rows: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        row = part["sobol"]
        values = array(row["indices"]["ST"]["value"])
        coordinates = [name.partition(", ")[0] for name in row["groups"]]
        for coordinate in dict.fromkeys(coordinates):
            chosen = values[[x == coordinate for x in coordinates]]
            rows.append((knee, coordinate_words(coordinate), *map(float, chosen.mean(axis=0))))
    parameters = first_part(record)["parameters"]
    return ik.report.Table(
        title="Total Sobol index ST over the box, mean over flexion angles and loads",
        columns=(
            ik.report.Column(name="knee"),
            ik.report.Column(name="output"),
            *map(short, parameters),
        ),
        rows=tuple(rows),
    )


def failures_table(record: Row) -> ik.report.Table:
    """How much failed, and how far the two rules about it are apart."""
    rows: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for method, index in (("morris", "mu_star"), ("sobol", "ST")):
            row = part[method]
            found = row["indices"][index]
            apart = np.abs(array(found["value"]) - array(found["complete"]))[:-1]
            width = array(found["half_width"])[:-1] + array(found["complete_half_width"])[:-1]
            rows.append(
                (
                    knee,
                    METHODS[method],
                    row["n_simulations"],
                    100.0 * row["failed_share"][-1],
                    100.0 * max(row["failed_share"][:-1]),
                    100.0 * min(row["complete_share"][:-1]),
                    100.0 * float(np.mean(apart > width)),
                )
            )
    return table(
        "Simulations without a prediction, and what they change",
        "knee; method; simulations | 0; any trial failed [%] | 1; worst group failed [%] | 1; "
        "complete samples of that group [%] | 1; indices that differ between the rules [%] | 1",
        rows,
    )


def convergence_table(record: Row) -> ik.report.Table:
    """Half-widths, and what is missing to 0.02."""
    rows: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for method in ("morris", "sobol", *OVER_POSTERIOR):
            row = part[method]
            widths = array(row["largest_half_width"])[:-1]
            missing = array(row["more_simulations"])[:-1]
            known = np.isfinite(widths)
            rows.append(
                (
                    knee,
                    METHODS[method],
                    row["n_simulations"],
                    float(np.median(widths[known])),
                    float(widths[known].max()),
                    float(np.median(missing[known])),
                    float(missing[known].max()),
                    row["seconds"],
                )
            )
    return table(
        "Half-width of the 95 % confidence interval (Morris: over the largest effect)",
        "knee; method; simulations | 0; median group | 3; worst group | 3; "
        "simulations missing to reach 0.02, median | 0; the same, worst | 0; time [s] | 0",
        rows,
    )


def posterior_table(record: Row) -> ik.report.Table:
    """Mean index over all groups of each method over the posterior, by parameter."""
    rows: list[tuple[Cell, ...]] = []
    for knee, part in record["knees"].items():
        for method, index in OVER_POSTERIOR.items():
            found = part[method]["indices"][index]
            mean = np.nanmean(array(found["value"])[:-1], axis=0)
            floor = found["noise_floor"]
            noise = None if floor is None else float(np.nanmean(array(floor)[:-1]))
            name = METHODS[method] + (f", {index}" if index != method else "")
            rows.append((knee, name, *map(float, mean), noise))
    parameters = first_part(record)["parameters"]
    return ik.report.Table(
        title="Mean index over all groups, over the posterior with its correlated parameters",
        columns=(
            ik.report.Column(name="knee"),
            ik.report.Column(name="index"),
            *map(short, parameters),
            ik.report.Column(name="dummy"),
        ),
        rows=tuple(rows),
    )


def array(values: Any) -> ik.runs.Array:
    """Numbers of the record; what JSON has as null is NaN."""
    return np.array(values, dtype=np.float64)


def first_part(record: Row) -> Row:
    """The part of the first knee."""
    part: Row = next(iter(record["knees"].values()))
    return part


def short(parameter: str) -> ik.report.Column:
    """Column of a parameter."""
    owner, _, kind = parameter.rpartition(".")
    return ik.report.Column(name=f"{owner} {'stiffness' if kind.endswith('_kN') else 'strain'}")


if __name__ == "__main__":
    main()
