"""Fast part of the study: draws the figures and fills the tables of the page from the record."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
import scipy.interpolate
from common.page import draw_study, turn_ticks
from matplotlib.figure import Figure
from profile_tables import tables

import identknee as ik
from identknee.calibrate.problem import typical_steps
from identknee.report.figures import COLOURS, MARKERS, STYLES, bare
from identknee.runs.declare import Array
from identknee.runs.schema import from_plain
from identknee.runs.words import label, label_without_unit

# Parameters drawn in colour on each panel of paths: those that move most.
N_COMPENSATORS = 3
# Points of a smooth curve between two points of an edge.
PER_SEGMENT = 12
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(__file__, FIGURE_OF, tables)


def profiles_of(record: Row) -> list[ik.Profile]:
    """The profiles of the first knee's parameters."""
    part = next(iter(record["knees"].values()))
    kept = [{key: x for key, x in row.items() if key != "nested"} for row in part["profiles"]]
    return [from_plain(ik.Profile, row) for row in kept]


def figure_1(record: Row) -> Figure:
    """The profiles."""
    return ik.report.profiles_figure(profiles_of(record))


def figure_2(record: Row) -> Figure:
    """How the other parameters move along each profile, those that move most in colour."""
    part = next(iter(record["knees"].values()))
    n = len(part["parameters"])
    parameters = ik.model.Parameters(
        names=tuple(part["parameters"]),
        center=part["truth"],
        lower=part["lower_bound"],
        upper=part["upper_bound"],
        prior_sd=np.ones(n),
        is_log=np.zeros(n, bool),
    )
    profiles, scales = profiles_of(record), typical_steps(parameters)
    figure = Figure(figsize=(10.5, 2.6 * (len(profiles) // 4)), layout="constrained")
    panels = figure.subplots(len(profiles) // 4, 4)
    for axes, profile in zip(panels.flat, profiles, strict=True):
        moves = (profile.thetas - profile.optimum) / scales
        others = [i for i, name in enumerate(parameters.names) if name != profile.name]
        spans = np.ptp(moves, axis=0)
        ranked = [others[k] for k in np.argsort(-spans[others], kind="stable")]
        for i in ranked[N_COMPENSATORS:]:
            axes.plot(profile.values, moves[:, i], color="0.85", linewidth=0.8)
        for k, i in enumerate(ranked[:N_COMPENSATORS]):
            label = label_without_unit(parameters.names[i])
            style = {"marker": MARKERS[k], "markersize": 3, "color": COLOURS[k], "linewidth": 1.2}
            axes.plot(profile.values, moves[:, i], STYLES[k], label=label, **style)
        axes.axvline(profile.optimum_value, color="0.8", linewidth=0.8, zorder=0)
        axes.legend(fontsize=7, frameon=False, handlelength=1.6)
        axes.set_xlabel(f"{label_without_unit(profile.name)} [{profile.unit}]", fontsize=8)
        bare(axes)
        axes.tick_params(labelsize=7)
    for axes in panels[:, 0]:
        axes.set_ylabel("change [typical steps]")
    return figure


def figure_3(record: Row) -> Figure:
    """Nested sets."""
    return ik.report.intervals_figure(profiles_of(record))


def _smooth(edge: Array) -> Array:
    """Many points on a closed smooth curve through the edge of a set, shape ``(k, 2)``.

    An edge with gaps, where NaN stands, is given back as it is, closed.
    """
    closed = np.vstack([edge, edge[:1]])
    if not np.isfinite(edge).all():
        return closed
    steps = np.arange(len(closed))
    curve = scipy.interpolate.CubicSpline(steps, closed, bc_type="periodic")
    return np.asarray(curve(np.linspace(0, len(edge), PER_SEGMENT * len(edge) + 1)))


def figure_4(record: Row) -> Figure:
    """Stiffness with reference strain of each ligament, a row a knee."""
    knees = record["knees"]
    most = max(len(part["pairs"]) for part in knees.values())
    figure = Figure(figsize=(2.7 * most, 2.7 * len(knees)), layout="constrained")
    grid = figure.subplots(len(knees), most, squeeze=False)
    for axes_row, (knee, part) in zip(grid, knees.items(), strict=True):
        truth = dict(zip(part["parameters"], part["truth"], strict=True))
        for axes, pair in zip(axes_row, part["pairs"], strict=False):
            for k, (level, edge) in enumerate(zip(pair["levels"], pair["edges"], strict=True)):
                line = _smooth(np.array(edge, dtype=float))
                axes.plot(
                    *line.T, color=ik.report.COLOURS[k], linewidth=1.2, label=f"{100 * level:g} %"
                )
            axes.plot(*pair["optimum"], "+", color=ik.report.BLACK, label="best")
            axes.plot(
                *(truth[x] for x in pair["names"]), "*", color=ik.report.COLOURS[4], label="truth"
            )
            axes.set_xlabel(label(pair["names"][0]), fontsize=8)
            axes.set_ylabel(label(pair["names"][1]), fontsize=8)
            axes.tick_params(labelsize=7)
            axes.spines[["top", "right"]].set_visible(False)
        axes_row[0].set_title(knee, fontsize=9, loc="left")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def figure_5(record: Row) -> Figure:
    """Share of data sets in which a parameter's set is open, against the noise."""
    knees = record["knees"]
    figure = Figure(figsize=(4.3 * len(knees), 3.4), layout="constrained")
    noises = record["head"]["settings"]["noises_mm_deg"]
    for axes, (knee, part) in zip(
        figure.subplots(1, len(knees), squeeze=False, sharey=True)[0], knees.items(), strict=True
    ):
        for i, name in enumerate(part["parameters"]):
            shares = [
                np.mean(
                    [
                        None in (x["lower"][i], x["upper"][i])
                        for x in part["noises"]
                        if x["noise"] == noise
                    ]
                )
                for noise in noises
            ]
            if max(shares) > 0:
                k = i % len(ik.report.COLOURS)
                style = {
                    "color": ik.report.COLOURS[k],
                    "marker": ik.report.MARKERS[k],
                    "ls": ik.report.STYLES[i // len(ik.report.COLOURS)],
                }
                axes.plot(noises, shares, label=label_without_unit(name), **style)
        axes.set_xscale("log")
        axes.set_xticks(noises, [f"{x:g}" for x in noises])
        axes.minorticks_off()
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlabel("noise [mm and deg]")
        axes.set_title(knee, fontsize=10)
        axes.legend(fontsize=8, frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("share of data sets with an open end")
    return figure


def figure_6(record: Row) -> Figure:
    """Ligament forces with their sets beside the truth, a row a knee."""
    knees = record["knees"]
    figure = Figure(figsize=(9.0, 3.0 * len(knees)), layout="constrained")
    for axes, (knee, part) in zip(
        figure.subplots(len(knees), 1, squeeze=False)[:, 0], knees.items(), strict=True
    ):
        trials = list(dict.fromkeys(x["trial"] for x in part["forces"]))
        ligaments = list(dict.fromkeys(x["ligament"] for x in part["forces"]))
        for k, ligament in enumerate(ligaments):
            rows = [x for x in part["forces"] if x["ligament"] == ligament]
            across = np.arange(len(trials)) + 0.18 * (k - 0.5 * (len(ligaments) - 1))
            value, low, high = (
                np.array([np.nan if x[y] is None else x[y] for x in rows], dtype=float)
                for y in ("value", "lower", "upper")
            )
            axes.errorbar(
                across,
                value,
                yerr=[value - low, high - value],
                fmt=ik.report.MARKERS[k],
                color=ik.report.COLOURS[k],
                markersize=4,
                capsize=2,
                label=ligament,
            )
            axes.plot(across, [x["truth"] for x in rows], "_", color=ik.report.BLACK, markersize=7)
        axes.set_xticks(range(len(trials)), [*map(in_words, trials)], fontsize=7)
        turn_ticks(axes, 35)
        axes.set_ylabel("tension [N]")
        axes.set_title(knee, fontsize=10)
        axes.legend(fontsize=8, frameon=False, ncols=len(ligaments))
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def in_words(trial: str) -> str:
    """A trial by its angle and its load, short enough for an axis."""
    flexion, _, load = trial.removeprefix("flexion").partition("_")
    opposites = {"internal-10Nm": "external", "varus-10Nm": "valgus"}
    return f"{flexion} deg, {opposites.get(load, load.removesuffix('10Nm'))}"


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_profiles": figure_1,
    "figure_2_paths": figure_2,
    "figure_3_nested_sets": figure_3,
    "figure_4_pairs": figure_4,
    "figure_5_open_ends": figure_5,
    "figure_6_forces": figure_6,
}


if __name__ == "__main__":
    main()
