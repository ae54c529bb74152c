"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.page import Cell, draw_study, table
from matplotlib.figure import Figure

import identknee as ik
from identknee.report.sensitivity_figures import methods_figure, shares_figure

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
        ordered[coordinate] = ([name for name, _ in lines], np.array([x for _, x in lines]))
    return ik.report.map_figure(ordered, part["parameters"], "total Sobol index, ST")


def figure_2(part: Row) -> Figure:
    """Sobol indices of the rotations along their moments, and of failure."""
    row = part["sobol"]
    first, total = row["indices"]["S1"], row["indices"]["ST"]
    panels = {
        name: tuple(
            array(index[kind])[row["groups"].index(name)]
            for index in (first, total)
            for kind in ("value", "half_width")
        )
        for name in (*SHOWN, FAILURE)
    }
    per_block = row["n_simulations"] / row["n_samples"]
    widths = np.maximum(
        array(first["largest_half_width_by_level"]), array(total["largest_half_width_by_level"])
    )
    levels = per_block * np.array(row["levels"])
    return shares_figure(panels, part["parameters"], (levels, widths[:, :-1]))


def figure_3(part: Row) -> Figure:
    """Elementary effects on the same rotations."""
    row = part["morris"]
    star, sigma = row["indices"]["mu_star"], row["indices"]["sigma"]
    panels = {}
    for name in SHOWN:
        at = row["groups"].index(name)
        panels[f"{name} [deg]"] = (
            array(star["value"])[at],
            array(star["half_width"])[at],
            array(sigma["value"])[at],
        )
    return ik.report.effects_figure(panels, part["parameters"])


def figure_4(part: Row) -> Figure:
    """Over the posterior: four methods for correlated parameters."""
    panels = {}
    for name in SHOWN:
        panels[name] = {}
        for method, index in OVER_POSTERIOR.items():
            row = part[method]
            at = row["groups"].index(name)
            found = row["indices"][index]
            panels[name][method] = (array(found["value"])[at], array(found["half_width"])[at])
    return methods_figure(panels, part["parameters"])


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
            rows.append((knee, coordinate, *map(float, chosen.mean(axis=0))))
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
                    method,
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
        "its complete samples [%] | 1; indices that differ between the rules [%] | 1",
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
                    method,
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
        "missing to 0.02, median | 0; missing to 0.02, worst | 0; time [s] | 0",
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
            rows.append((knee, f"{method}, {index}", *map(float, mean), noise))
    parameters = first_part(record)["parameters"]
    return ik.report.Table(
        title="Over the posterior, correlated parameters: mean index over all groups",
        columns=(
            ik.report.Column(name="knee"),
            ik.report.Column(name="index"),
            *map(short, parameters),
            ik.report.Column(name="no influence"),
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
    return ik.report.Column(name=f"{owner} {'k' if kind.endswith('_kN') else 'eps_r'}")


if __name__ == "__main__":
    main()
