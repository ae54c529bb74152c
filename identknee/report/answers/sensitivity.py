"""What a sensitivity analysis says: which parameter moves which laxity most."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from identknee.identify.sensitivity import Sensitivity
from identknee.laxity.trial_words import UNLOADED
from identknee.report.presenter import Drawing, Presenter, Question, Statement, Table, table
from identknee.runs.words import coordinate_words, label, listed, parameter_words
from identknee.subject.knee import Knee
from identknee.verbs.sensitivity import GlobalSensitivity

INDICES = {"mu_star": "mean absolute effect, mu*", "ST": "total Sobol index, ST"}


@dataclass(frozen=True, slots=True)
class Measure:
    """What a method measures: its main index, its name in a sentence, and what the index means."""

    index: str
    name: str
    meaning: str


MEASURES = {
    "morris": Measure(
        "mu_star",
        "Morris's elementary effects",
        "its mean effect (mm or deg) when it alone crosses its whole range",
    ),
    "sobol": Measure(
        "ST",
        "Sobol's total index",
        "the share of the variance that would be left if all others were known",
    ),
    "delta": Measure(
        "delta",
        "the delta index",
        "how much knowing it changes the distribution of the output, 0 to 1",
    ),
    "pawn": Measure(
        "pawn",
        "the pawn index",
        "how far knowing it shifts the distribution of the output, 0 to 1",
    ),
    "hdmr": Measure("ST", "the hdmr index", "the share of the variance that its terms explain"),
    "shapley": Measure(
        "shapley",
        "the shapley index",
        "its fair share of the variance, with what it shares with others",
    ),
}


def _missing(found: Sensitivity) -> str:
    """How many samples half-widths of 0.02 would take; empty where they are reached."""
    missing = found.missing_simulations
    if missing <= 0:
        return ""
    if not math.isfinite(missing):
        return (
            " Some indices are unknown whatever the number of simulations; trials that always have "
            "a prediction would show them."
        )
    # Two digits: the estimate is no better.
    rounded = f"{float(f'{missing:.2g}'):,.0f}"
    return f" Half-widths of 0.02 in every group would take about {rounded} more simulations."


def _most_influential(answer: GlobalSensitivity) -> str:
    found = answer.analysis
    measure = MEASURES[found.method]
    entries = found.largest[measure.index]

    def size(name: str) -> float:
        value = float(entries[name]["largest"]["value"])
        # Unknown where every simulation of a group failed.
        return 0.0 if math.isnan(value) else value

    name = max(entries, key=size)
    top = str(entries[name]["largest"]["group"])
    where, group = top, answer.group_named(top)
    if group is not None:
        under = "without load" if group.load == UNLOADED else f"under {group.load}"
        words = coordinate_words(group.coordinate)
        where = f"{words} at {group.flexion_deg:g} deg of flexion {under}"
    return f"By {measure.name}, laxity depends most on {parameter_words(name)}: {where}."


def _group(answer: GlobalSensitivity, name: str, words: Callable[[str], str]) -> str:
    group = answer.group_named(name)
    return name if group is None else f"{words(group.coordinate)}, {group.place}"


def _table(answer: GlobalSensitivity) -> Table:
    found = answer.analysis
    name = MEASURES[found.method].index
    index = found.indices[name]
    tops = [found.largest_group(name, i) for i in range(found.parameters.n)]
    return table(
        "Largest influence of every parameter",
        (
            "parameter",
            (f"index {name}", 3),
            ("half-width", 3),
            "laxity it moves most",
            ("index for lost trials", 3),
        ),
        (
            (
                label(parameter),
                float(index.final[top, i]),
                float(index.final_half_widths[top, i]),
                _group(answer, found.groups[top], coordinate_words),
                float(index.final[-1, i]),
            )
            for i, (parameter, top) in enumerate(zip(found.parameters.names, tops, strict=True))
        ),
    )


class SensitivityPresenter(Presenter[GlobalSensitivity]):
    """How a sensitivity analysis is shown."""

    question = Question.LAXITY

    @override
    def statements(self, answer: GlobalSensitivity) -> Iterator[Statement]:
        """Which parameter moves which laxity most, and how well that is known."""
        found = answer.analysis
        if found.share_failed == 1.0:
            # Without variance of the outputs, indices have no meaning.
            yield self.say(
                f"None of the {found.n_simulations} simulations has a prediction in every trial, "
                "so no "
                "index can be given."
            )
            return
        yield self.say(
            f"{_most_influential(answer)} The largest index of each parameter is "
            f"{MEASURES[found.method].meaning}.",
            _table(answer),
        )
        yield self.say(
            f"Of {found.n_simulations} simulations, {100 * found.share_failed:.3g} % had a trial "
            f"without a prediction. The rule for these: {found.rule_of_lost}.{_missing(found)}"
        )

    @override
    def drawings(
        self, answer: GlobalSensitivity, subject: str, knee: Knee | None
    ) -> Iterator[Drawing]:
        from identknee.report.parameter_figures import effects_figure, map_figure

        found = answer.analysis
        name = next((x for x in INDICES if x in found.indices), None)
        if name is None:
            return
        index, parameters = found.indices[name], found.parameters.names
        by_coordinate: dict[str, list[tuple[int, str]]] = {}
        for i, x in enumerate(map(answer.group_named, found.groups)):
            if x is not None:
                by_coordinate.setdefault(label(x.coordinate), []).append((i, x.place))
        # Results of earlier versions have the names of the groups only.
        by_coordinate = by_coordinate or {"": list(enumerate(found.groups[:-1]))}
        tables = {
            coordinate: ([place for _, place in rows], index.final[[i for i, _ in rows]])
            for coordinate, rows in by_coordinate.items()
        }
        yield Drawing(
            name="influence",
            figure=map_figure(tables, parameters, INDICES[name]),
            caption="How much each parameter (across) moves each kind of laxity (down): dark means "
            "strongly.",
            description=f"{INDICES[name]} of {listed(map(label, parameters))} by coordinate, "
            "flexion and load.",
        )
        if name == "mu_star":
            size, width, spread = index.final, index.final_half_widths, found.indices["sigma"].final
            # The last group is failure.
            order = np.argsort(-np.nan_to_num(size[:-1], nan=-1.0).max(axis=1))
            panels = {
                _group(answer, found.groups[i], label): (size[i], width[i], spread[i])
                for i in order[:2]
            }
            yield Drawing(
                name="effects",
                figure=effects_figure(panels, parameters),
                caption="The two kinds of laxity that move most. Farther right an effect is "
                "stronger; farther up it depends more on the other parameters.",
                description=f"Morris effects of {listed(map(label, parameters))}.",
            )
