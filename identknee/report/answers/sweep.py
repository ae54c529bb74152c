"""What searches from many starts say: where they ended, and what that does not show."""

import math
from collections.abc import Iterator

import numpy as np
from typing_extensions import override

from identknee.identify.sweep import END, OUTCOMES, POLISHED, Recovery, Survey
from identknee.report.presenter import (
    Cell,
    Drawing,
    Presenter,
    Question,
    Statement,
    Table,
    optimizer_sources,
    settings_of,
    table,
)
from identknee.runs.record import Outcome
from identknee.runs.words import label, listed
from identknee.subject.knee import Knee
from identknee.verbs.sweep import Sweep

SHARES = "share of all starts"
MOST_LOST, MOST_BASINS = 3, 6
ENDED = {
    "minimum": "ended at a minimum",
    "valley": "stopped early in a valley",
    "cliff": "stopped at a cliff where the simulated knee jumps",
    "start_failed": "began where the model has no prediction",
}
SEARCHES = {END: "the search itself", POLISHED: "the polished search"}


def _kinds(survey: Survey) -> Table:
    searches = survey.searches
    return table(
        "What stopped the searches",
        ("end", "searches", "after polishing", "meaning"),
        (
            (
                kind.replace("_", " "),
                searches.kinds.get(kind, 0),
                searches.polished_outcomes.get(kind, 0),
                Outcome(kind).sentence,
            )
            for kind in dict.fromkeys([*searches.kinds, *searches.polished_outcomes])
        ),
    )


def _radius(recovery: Recovery, searches: str, within: float) -> str:
    radius = recovery.radius
    if radius.value == 0.0:
        return (
            f"At no distance from the best fit do nine in ten starts succeed for {searches}: at "
            f"every one, "
            "fewer than nine in ten starts led back to it "
            f"(to within {_kN_and_pct(within)}). More starts may show one."
        )
    return (
        f"Nine in ten starts within {_kN_and_pct(radius.value)} of the best fit lead {searches} "
        f"back to it, to within {_kN_and_pct(within)}. The 95 % limits of that distance are "
        f"{_kN_and_pct(radius.lower)} to {_kN_and_pct(radius.upper)}."
    )


def _pct(share: float) -> str:
    return f"{100 * share:.2g}" if share < 0.995 else "100"


def _kN_and_pct(distance: float) -> str:  # noqa: N802 - the unit
    return "any distance tried" if math.isinf(distance) else f"{distance:.2g} kN and %"


GOOD = "Good (1953), Biometrika 40(3-4), 237-264, doi:10.1093/biomet/40.3-4.237"


class SweepPresenter(Presenter[Sweep]):
    """How searches from many starts are shown."""

    question = Question.SEARCH

    @override
    def statements(self, answer: Sweep) -> Iterator[Statement]:
        """Where searches ended, what they may have missed, and how near one must start."""
        survey = answer.survey
        searches, n = survey.searches, survey.basins.n_basins
        ends = listed(f"{number} {ENDED[kind]}" for kind, number in searches.kinds.items())
        places = (
            "one and the same set of parameters" if n == 1 else f"{n} different sets of parameters"
        )
        found = f" Those at a minimum found {places}." if n else ""
        names = survey.searches.parameters.names_of_interest
        listed_basins = survey.basins.listed
        shown = listed_basins[:MOST_BASINS]
        left = len(listed_basins) - len(shown)
        rows: tuple[tuple[Cell, ...], ...] = (
            ("objective", *(x["objective"] for x in shown)),
            ("starts", *(x["n_starts"] for x in shown)),
            (f"{SHARES} [%]", *(round(100 * x["share"]) for x in shown)),
            *((label(name), *(x["parameters"][name] for x in shown)) for name in names),
        )
        yield self.say(
            (f"Of {searches.n} {searches.method} searches from different starts, {ends}.{found}"),
            _kinds(survey),
            table(
                f"Where searches ended{f' (the first {len(shown)} basins)' * bool(left)}",
                ("quantity", *((f"basin {k}", None) for k, _ in enumerate(shown, 1))),
                rows,
            ),
            is_answer=True,
        )
        if survey.unseen.n:
            yield self.say(
                f"An estimated {_pct(survey.unseen.estimate)} % of starts (at most "
                f"{_pct(survey.unseen.upper)} %) would end at a minimum not reached by any search."
            )
        recoveries = survey.recoveries
        if len(recoveries) > 1 and all(x.radius.value == 0.0 for x in recoveries.values()):
            either = " or ".join(SEARCHES[x] for x in recoveries)
            yield self.say(_radius(next(iter(recoveries.values())), either, survey.within))
        else:
            for name, recovery in recoveries.items():
                yield self.say(_radius(recovery, SEARCHES[name], survey.within))
        if answer.cliffs is not None:
            cliffs = answer.cliffs
            lost = ", ".join(
                f"{name} (on {n})" for name, n in list(cliffs.trials_lost.items())[:MOST_LOST]
            )
            yield self.say(
                f"On {cliffs.n_paths_with_cliff} of {cliffs.n_paths} straight paths to the best "
                "fit "
                f"the simulated knee jumps{f', most often in trial {lost}' if lost else ''}."
            )

    @override
    def method(self, answer: Sweep) -> Iterator[str]:
        searches, settings = answer.searches, settings_of(answer)
        placed = {"sobol": "Sobol points within the bounds", "shells": "shells"}
        where = placed.get(answer.design, answer.design)
        if answer.design == "shells" and settings.get("distances"):
            where += f" around the start (mean differences {settings['distances']} kN and %)"
        yield (
            f"Fits by {searches.method.replace('-', ' ')} began at {searches.n} starts, {where}, "
            f"with at most {searches.budget} simulations each."
        )
        yield "From each end least squares with exact derivatives went on."
        yield (
            "A search recovered the best fit where it ended within a mean distance of "
            f"{_kN_and_pct(answer.survey.within)}."
        )
        if answer.cliffs is not None:
            yield f"The straight paths of {answer.cliffs.n_paths} starts were searched for cliffs."

    @override
    def sources(self, answer: Sweep) -> tuple[str, ...]:
        return (*optimizer_sources(answer.searches.method), GOOD)

    @override
    def drawings(self, answer: Sweep, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        from identknee.report.sweep_figures import KINDS, start_end_figure, waterfall_figure

        searches = answer.searches
        number = np.arange(1.0, searches.n + 1.0)
        curves = {
            "end": (number, np.sort(searches.objectives)),
            "polished": (number, np.sort(searches.polished_objectives)),
        }
        counts = listed(f"{n} {KINDS[kind][2]}" for kind, n in searches.kinds.items())
        if np.isfinite(searches.objectives).any():
            yield Drawing(
                name="waterfall",
                figure=waterfall_figure({f"{searches.n} starts": curves}),
                caption="Objective at which each search ended, the best first. A step is a place "
                "where several searches ended.",
                description=f"Objectives of {searches.n} searches in ascending order: {counts}.",
            )
        kinds = [OUTCOMES[code].value for code in searches.kind_codes]
        names, best = searches.parameters.names, searches.polished[searches.best]
        yield Drawing(
            name="basins",
            figure=start_end_figure(
                {"": (searches.starts, searches.ends, kinds)}, names, best, mark="best end"
            ),
            caption="Where searches began (coloured by how they ended) and where they ended "
            "(black), in the plane of each ligament's two parameters.",
            description=f"Starts and ends of {searches.n} searches: {counts}.",
        )
