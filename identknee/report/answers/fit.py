"""What a fit says: how well it reproduces the data, and that this is not yet knowledge."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import override

from identknee.checks.fit_checks import AT_END, ComparedForces
from identknee.checks.limit_price import PlausibilityPrice
from identknee.laxity.protocol import Protocol, from_zero
from identknee.report.answers.simulate import simulated_curves
from identknee.report.presenter import (
    Drawing,
    Presenter,
    Question,
    Statement,
    Table,
    of_type,
    optimizer_sources,
    presenter_of,
    settings_of,
    table,
)
from identknee.runs.declare import Array
from identknee.runs.findings import Severity
from identknee.runs.record import Outcome
from identknee.runs.words import amount, coordinate_words, label, listed, unit_of
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.fit import Calibration

if TYPE_CHECKING:
    from identknee.report.laxity_figures import LaxityCurves

# Below it an error is that of rounding, mm or deg.
NO_ERROR = 1e-4
# Stated errors that a terminal shows.
MOST_ERRORS = 8
# Other optima that a terminal shows.
MOST_OPTIMA = 4
# Limits that a terminal shows.
MOST_LIMITS = 5
# Fits in a figure.
MOST_LINES = 4


def parameters_at_bounds(answer: Calibration) -> tuple[str, ...]:
    """Names of the parameters that the fit's own warning says lie at a bound."""
    search, own = answer.search, answer.search.parameters
    margin = AT_END * (own.upper - own.lower)
    stands = (np.abs(search.theta - own.lower) <= margin) | (
        np.abs(search.theta - own.upper) <= margin
    )
    named = zip(own.names, stands & (own.lower < own.upper), strict=True)
    return tuple(name for name, is_there in named if is_there and name not in search.fixed)


def nuisance_tables(answer: Calibration) -> Iterator[Table]:
    """What a fit says of stated errors; nothing where none are stated."""
    if answer.nuisances:
        moved = sorted(answer.nuisances, key=lambda x: -abs(x.away))
        yield table(
            "Stated errors of geometry and tests at the fit, largest shifts first",
            ("error", ("fitted", None), ("sd", None), ("stated sd", None)),
            ((label(x.name), x.value, x.sd, x.prior_sd) for x in moved),
            most=MOST_ERRORS,
        )


def evidence_tables(answer: Calibration) -> Iterator[Table]:
    """Terms of the deviance at the fit; nothing where the laxity table is the only one."""
    if len(answer.evidence) > 1:
        yield table(
            "Terms of the deviance at the fit",
            ("term", ("values", 0), ("deviance", 2), ("share", 2)),
            ((x.name, x.n, x.deviance, x.share) for x in answer.evidence),
        )


def plausibility_tables(answer: Calibration) -> Iterator[Table]:
    """Limits of plausibility: what the fit has there and what each costs."""
    if (found := answer.plausibility) is not None:
        yield table(
            f"Limits of plausibility: price {found.price:.3g}, of which the data pay "
            f"{found.of_data:.3g}",
            (
                "limit",
                ("at the fit", 1),
                ("mean or most", 0),
                ("sd or scale", 0),
                ("deviance", 2),
                ("saved without it", 2),
            ),
            (
                (
                    x.limit.name,
                    x.limit.value,
                    x.limit.size,
                    x.limit.spread,
                    x.limit.deviance,
                    x.drop_one,
                )
                for x in sorted(found.limits, key=lambda x: -x.limit.deviance)
            ),
            most=MOST_LIMITS,
        )


def agreement_tables(answer: Calibration) -> Iterator[Table]:
    """How each experiment, state or kind of force is fitted with the others and alone."""
    if (found := answer.agreement) is not None:
        yield table(
            f"Terms together and alone (p = {found.p_value:.2g} if they agree)",
            ("term", ("values", 0), ("together", 1), ("alone", 1), ("p", 3)),
            ((x.name, x.n, x.together, x.alone, x.p_value) for x in found.terms),
        )


def optima_tables(answer: Calibration) -> Iterator[Table]:
    """Other parameter sets that fit as well, by the force in which they differ most."""
    if answer.optima:
        yield table(
            "Other ends of searches that fit as well, with the force that differs most",
            ("force", ("there [N]", 0), ("at the fit [N]", 0), ("deviance higher by", 2)),
            ((x.quantity, x.force_N, x.force_at_fit_N, x.rise) for x in answer.optima),
            most=MOST_OPTIMA,
        )


def _band(
    beside: Sequence[Answer], as_measured: Callable[[Array], Array]
) -> tuple[str, Array] | None:
    """Predictions of the posterior, or of equivalent sets, from the same data."""
    for other in beside:
        if (found := presenter_of(other).band(other)) is not None:
            name, coordinates, ends = found
            drawn = np.array([as_measured(x) for x in coordinates])
            return name, np.quantile(drawn, ends, axis=0)
    return None


def compared_forces_drawing(forces: ComparedForces) -> Drawing:
    """The figure of measured forces beside those predicted."""
    from identknee.report.laxity_figures import compared_forces_figure

    kinds = list(dict.fromkeys(map(label, forces.names)))
    return Drawing(
        name="forces",
        figure=compared_forces_figure(forces),
        caption="Measured forces (dots, with two standard deviations) and those that the fit "
        "predicts (squares), by trial.",
        description=f"Measured and predicted {listed(kinds)} in {len(set(forces.trials))} trials.",
    )


def plausibility_drawing(price: PlausibilityPrice) -> Drawing:
    """The figure of what a fit has at each limit, with limits and without."""
    from identknee.report.laxity_figures import plausibility_figure

    return Drawing(
        name="plausibility",
        figure=plausibility_figure(price),
        caption="Forces, strains and contact of the fit with limits (filled) and without them "
        "(open), as a share of each limit. Grey is the limit with its standard deviation or scale.",
        description=f"{len(price.limits)} limits of plausibility and the values of two fits there.",
    )


class CalibrationPresenter(Presenter[Calibration]):
    """How a fit is shown."""

    question = Question.SEARCH

    @override
    def statements(self, answer: Calibration) -> Iterator[Statement]:
        """How well the fit reproduces the data, and how the search ended."""
        if answer.outcome is Outcome.START_FAILED:
            # What the search began with is no fit, and its error is that of the other trials.
            yield self.say(answer.sentence, is_answer=True)
            return
        sizes = ((answer.rmse.mm, "mm"), (answer.rmse.deg, "deg"))
        errors = [
            amount(size, unit) if size >= NO_ERROR else f"less than {NO_ERROR:g} {unit}"
            for size, unit in sizes
            if np.isfinite(size)
        ]
        is_good = all(x.severity is Severity.INFO for x in answer.findings)
        caution = " A good fit does not show that its parameters are right." if is_good else ""
        plural = "" if answer.rmse.n_compared == 1 else "s"
        search = answer.search
        notes = dict.fromkeys(parameters_at_bounds(answer), "at its bound")
        notes |= dict.fromkeys(search.fixed, "fixed")
        nuisances = {x.name for x in answer.nuisances}
        rows = zip(
            answer.parameter_names, search.start.tolist(), search.theta.tolist(), strict=True
        )
        yield self.say(
            f"The best fit reproduces the measured laxity to {listed(errors)} on average "
            f"(RMSE over {answer.rmse.n_compared} measured value{plural}). "
            f"{answer.sentence}{caution}",
            table(
                "Fitted parameters",
                ("parameter", ("start", None), ("fitted", None), "remark"),
                (
                    (label(name), start, end, notes.get(name, ""))
                    for name, start, end in rows
                    if name not in nuisances
                ),
            ),
            *evidence_tables(answer),
            *plausibility_tables(answer),
            *agreement_tables(answer),
            *nuisance_tables(answer),
            *optima_tables(answer),
            is_answer=True,
        )
        if answer.held_out is not None:
            held = answer.held_out
            sizes_held = [
                f"{amount(x, unit_of(k))} {coordinate_words(k)}" for k, x in held.rmse.items()
            ]
            lost = (
                f" {len(held.lost)} of them have no prediction: {listed(held.lost)}."
                if held.lost
                else ""
            )
            share = (
                f"{100 * held.within_90:.0f} % of the values predicted lie in their 90 % intervals."
            )
            shown = f" {share}" if sizes_held else ""
            to = f", to {listed(sizes_held)} on average (RMSE)" if sizes_held else ""
            yield self.say(
                f"The fit predicts {len(held.trials)} held-out trials{to}.{lost}{shown}",
                table(
                    "Trials held out",
                    ("value", ("measured", 2), ("predicted", 2), ("sd", 2)),
                    (
                        (f"{label(x.coordinate)} in {x.trial}", x.measured, x.predicted, x.sd)
                        for x in held.values
                    ),
                ),
            )

    @override
    def drawings(self, answer: Calibration, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        """Measured forces beside those predicted, and what no knee does."""
        if answer.compared_forces is not None:
            yield compared_forces_drawing(answer.compared_forces)
        if answer.plausibility is not None:
            yield plausibility_drawing(answer.plausibility)

    @override
    def curves(self, answer: Calibration, beside: Sequence[Answer]) -> "LaxityCurves":
        """Measured laxity, that of all fits to it, and a band of what fits as well."""

        def as_measured(values: Array) -> Array:
            return from_zero(values, answer.protocol, answer.data.zero)

        fits = of_type(beside, Calibration)
        fits = [x for x in fits if x.protocol.trials == answer.protocol.trials][:MOST_LINES]
        return replace(
            simulated_curves(answer, answer.data),
            simulated={
                "fit" if len(fits) == 1 else f"fit from {x.start}": as_measured(x.coordinates)
                for x in fits
            },
            band=_band(beside, as_measured),
        )

    @override
    def method(self, answer: Calibration) -> Iterator[str]:
        search, settings = answer.search, settings_of(answer)
        words = search.method.replace("-", " ")
        more = settings.get("more_starts")
        beside = f" and up to {more} further starts" if more else ""
        yield (
            f"Parameters were fitted by {words} from {answer.start}{beside}, "
            f"in {search.n_simulations} simulations."
        )
        yield f"The search ended so: {answer.outcome.sentence}"
        if settings.get("likelihood") == "student":
            yield "Errors had Student's t distribution."
        if held := settings.get("hold_out"):
            trials = [held] if isinstance(held, str) else held
            yield f"Held out of the fit and predicted were {listed(map(str, trials))}."

    @override
    def sources(self, answer: Calibration) -> tuple[str, ...]:
        return optimizer_sources(answer.search.method)

    @override
    def protocol(self, answer: Calibration) -> Protocol:
        return answer.protocol
