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
from identknee.report.answers.sample import CONDITIONS
from identknee.report.figures import BLACK, COLOURS, SMALL, STYLES, bare
from identknee.runs.words import label

KNEE = "reference"
# Steps after burn-in must be so many autocorrelation times.
TIMES = 50.0
Row = Mapping[str, Any]


def main() -> None:
    """Draw all figures and fill the page."""
    draw_study(
        __file__,
        {name: of_knees(draw) for name, draw in FIGURE_OF.items()},
        lambda record: tables(record["knees"]),
    )


def of_knees(draw: Callable[[Row], Figure]) -> Callable[[Row], Figure]:
    """What draws the same from the whole record."""
    return lambda record: draw(record["knees"])


def figure_1(knees: Row) -> Figure:
    """What was known before and is after."""
    part = knees[KNEE]
    posteriors = {name: np.array(x["draws"]) for name, x in knees.items()}
    return ik.report.prior_posterior_figure(
        part["parameters"], np.array(part["prior"]), posteriors, truth=part["truth"]
    )


def figure_2(knees: Row) -> Figure:
    """Every pair of parameters."""
    part = knees[KNEE]
    return ik.report.corner_figure(part["parameters"], np.array(part["draws"]), truth=part["truth"])


def figure_3(knees: Row) -> Figure:
    """Forces at the highest loads."""
    part = knees[KNEE]["predictions"]
    protocol = ik.load_protocol("seed63")
    return ik.report.forces_figure(
        [ik.laxity.load_words(protocol, protocol.trials.index(x)) for x in part["trials"]],
        part["ligaments"],
        np.array(part["force_quantiles_N"]),
        truth=np.array(part["true_force_N"]),
    )


def figure_4(knees: Row) -> Figure:
    """Autocorrelation time against the steps it comes from, and the line it must stay below."""
    part = knees[KNEE]
    kept, tau = np.array(part["tau"]["kept"], float), np.array(part["tau"]["tau"])
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for i, name in enumerate(part["parameters"]):
        style = STYLES[(i // len(COLOURS)) % len(STYLES)]
        axes.plot(kept, tau[:, i], style, color=COLOURS[i % len(COLOURS)], label=label(name))
    axes.plot(kept, kept / TIMES, color=BLACK, linewidth=1.0)
    end = kept[-1], kept[-1] / TIMES
    axes.annotate(f"steps / {TIMES:g}", end, fontsize=SMALL, ha="right", va="bottom")
    axes.set_xlabel("steps after burn-in")
    axes.set_ylabel("autocorrelation time [steps]")
    axes.set_ylim(bottom=0.0)
    bare(axes)
    figure.legend(loc="outside right upper", frameon=False, fontsize=SMALL)
    return figure


FIGURE_OF: Mapping[str, Callable[[Row], Figure]] = {
    "figure_1_prior_and_posterior": figure_1,
    "figure_2_pairs": figure_2,
    "figure_3_forces": figure_3,
    "figure_4_autocorrelation": figure_4,
}


def tables(knees: Row) -> dict[str, ik.report.Table]:
    """The tables of the page, by name of their place."""
    return {
        "parameters": parameters_table(knees),
        "gate": gate_table(knees),
        "predictions": predictions_table(knees),
        "nested": nested_table(knees),
    }


def parameters_table(knees: Row) -> ik.report.Table:
    """Posterior and profile of every parameter."""
    rows: list[list[Cell]] = []
    for knee, part in knees.items():
        for i, name in enumerate(part["parameters"]):
            one, profile = part["sample"]["parameters"][name], part["profiles"][name]
            rows.append(
                [
                    *(knee, label(name), part["truth"][i], one["mean"], one["sd"]),
                    between(one["q025"], one["q975"]),
                    between(profile["lower"], profile["upper"]),
                    part["leaning"]["prior"][i],
                    part["leaning"]["verdicts"][i],
                ]
            )
    return table(
        "Posterior beside profile likelihood, 95 % intervals",
        "knee; parameter; true; mean; sd; posterior; profile, no prior; prior sensitivity | 3; "
        "determined by",
        (tuple(row) for row in rows),
    )


def gate_table(knees: Row) -> ik.report.Table:
    """The numbers at which sampling stopped."""
    rows: list[list[Cell]] = [
        [knee, CONDITIONS[name], x["value"], x["bar"], "yes" if x["met"] else "no"]
        for knee, part in knees.items()
        for name, x in part["sample"]["gate"].items()
    ]
    return table(
        "The convergence check",
        "knee; condition; value | g; bar | g; met",
        (tuple(row) for row in rows),
    )


def predictions_table(knees: Row) -> ik.report.Table:
    """How well forces and laxity are known."""
    rows: list[list[Cell]] = []
    for knee, part in knees.items():
        found = part["predictions"]
        for i, ligament in enumerate(found["ligaments"]):
            width = found["largest_force_half_width_N"][i]
            share = 100.0 * found["share_of_forces_inside"][i]
            rows.append([knee, f"{ligament} tension", width, "N", share])
        for unit, width in found["largest_laxity_half_width"].items():
            rows.append([knee, "laxity", width, unit, None])
    return table(
        "Largest half-width of a 95 % interval over the 63 trials",
        "knee; prediction; half-width; unit; trials with the true value inside [%] | 0",
        (tuple(row) for row in rows),
    )


def nested_table(knees: Row) -> ik.report.Table:
    """What each way of sampling cost, and how far they differ."""
    rows: list[list[Cell]] = []
    for knee, part in knees.items():
        taken, nested = part["sample"], part.get("nested")
        rows.append(
            [knee, "ensembles", taken["n_simulations"], taken["ess_min"], taken["seconds"], None]
        )
        if nested is not None:
            worst = float(np.max(np.abs(nested["quantile_differences"])))
            numbers = (nested["n_simulations"], nested["effective_draws"], nested["seconds"], worst)
            rows.append([knee, "nested", *numbers])
    return table(
        "Two methods for the same posterior",
        "knee; method; simulations | 0; effective draws | 0; time [s] | 0; "
        "largest quantile difference [standard errors] | 1",
        (tuple(row) for row in rows),
    )


def between(low: float | None, high: float | None) -> str:
    """An interval; an open end is said to be open."""
    words = ("open" if x is None else f"{x:.2f}" for x in (low, high))
    return " to ".join(words)


if __name__ == "__main__":
    main()
