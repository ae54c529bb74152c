"""What a diagnosis says: what is wrong and why, which tests help, what a protocol could show."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from math import hypot
from typing import TYPE_CHECKING, TypeVar

from typing_extensions import override

from identknee.diagnosis.advice import Advice
from identknee.diagnosis.believability import CauseUnderLimits
from identknee.diagnosis.candidates import Detectability, Exclusion
from identknee.diagnosis.fitting import RivalState
from identknee.diagnosis.gain import FLEXION
from identknee.diagnosis.isolability import Distances
from identknee.diagnosis.misfit import LEVEL
from identknee.diagnosis.missing_line import Pull
from identknee.diagnosis.score import Cell
from identknee.diagnosis.verdict import Cause, Estimate, Verdict
from identknee.identify.laplace import Interval
from identknee.laxity.protocol import Protocol
from identknee.model.effects.facts import FACTS, NOT_OFFERED, cause_label
from identknee.report.answers.design import sizes_words, trial_list, trial_table, trials_words
from identknee.report.answers.fit import compared_forces_drawing
from identknee.report.presenter import (
    BY_ASSUMPTION,
    CLOSED,
    Drawing,
    Presenter,
    Question,
    Range,
    Source,
    Statement,
    Table,
    open_ends_text,
    table,
)
from identknee.runs.declare import Array
from identknee.runs.findings import Severity
from identknee.runs.schema import summary_of
from identknee.runs.words import (
    amount,
    coordinate_words,
    error_words,
    label,
    listed,
    listed_first,
    parameter_words,
)
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis, FamilyGain, GainFound, Misfit
from identknee.verbs.isolability import Isolability

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from identknee.report.laxity_figures import LaxityCurves

# A sentence and its table.
Said = tuple[str, Table]
MOST_CAUSES = 2
SIZES = ("detectable above", "smallest relevant effect")


def detectable_sizes(x: Detectability) -> tuple[str, str]:
    """The size that nine of ten data sets would show, and the smallest that matters."""
    # Not a number where no plausible size would be seen; infinite in answers of earlier versions.
    seen = amount(x.detectable, x.unit) if x.detectable < float("inf") else "not detectable"
    return seen, amount(x.relevant, x.unit)


def _few(causes: Sequence[str]) -> str:
    """Causes in words, of many the first."""
    return listed_first([cause_label(x) for x in causes], MOST_CAUSES)


class IsolabilityPresenter(Presenter[Isolability]):
    """How it is shown what a protocol could distinguish."""

    question = Question.WRONG

    @override
    def statements(self, answer: Isolability) -> Iterator[Statement]:
        """What a protocol could show, before there are data."""
        rows = tuple(
            (
                cause_label(name),
                *detectable_sizes(x),
                listed(map(cause_label, answer.look_alikes.get(name, ()))) or "-",
            )
            for name, x in answer.effects.items()
        )
        shown = table(
            "What these trials could show in nine of ten data sets",
            ("cause", *SIZES, "looks like"),
            rows,
        )
        trials = f"The {answer.n_trials} trials of {answer.protocol}"
        together = "; ".join(_few(x.effects) for x in answer.groups)
        outcome = "would distinguish all causes."
        if answer.groups:
            outcome = f"could not distinguish all causes. These are confounded: {together}."
        yield self.say(f"{trials} {outcome}", shown, is_answer=True)
        for group in answer.groups:
            if group.advised_trials:
                n = len(group.advised_trials)
                one = f"One more trial ({trials_words(group.advised_trials)})"
                yield Statement(
                    question=Question.NEXT,
                    sentence=f"{one if n == 1 else f'{n} more trials'} would help to tell "
                    f"{_few(group.effects) if len(answer.groups) > 1 else 'them'} apart. The two "
                    f"closest would then be {group.distance_with_advised_trials:.1f} and not "
                    f"{group.distance:.1f} units of noise apart.",
                    tables=(trial_table(group.advised_trials),),
                )

    @override
    def drawings(self, answer: Isolability, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        from identknee.report.diagnosis_figures import isolability_figure

        names = answer.rivals
        yield Drawing(
            name="isolability",
            figure=isolability_figure(
                Distances(effects=names, rivals=names, values=answer.distances)
            ),
            caption="How far the data of each cause (rows) are from what another cause (columns) "
            "could explain in its place. Causes in dark cells cannot be distinguished.",
            description=f"Distances between {len(names)} causes.",
        )

    @override
    def next_tests(self, answer: Isolability) -> Iterator[str]:
        for group in answer.groups:
            if group.advised_trials:
                trials = trial_list([summary_of(x) for x in group.advised_trials])
                causes = listed(map(cause_label, group.effects), "from")
                yield f"{trials}. This would tell {causes}."


Value = TypeVar("Value")
HYPOTHESIS = "On a real knee this name is a hypothesis that has yet to be tested."
MOST_PARAMETERS = 3
# Amplitudes of a cause that a terminal shows.
MOST_AMPLITUDES = 12
# Least gain on held-out trials that is claimed, in standard errors.
LEAST_GAIN = 2.0
FOUND = {
    Cell.MISSPECIFIED: "seen",
    Cell.INSPECT: "seen",
    Cell.EXCLUDED: "excluded",
    Cell.INCONCLUSIVE: "neither seen nor excluded",
}


def verdict_sentence(answer: Diagnosis) -> str:
    """The verdict with its causes, or with what would have to be known."""
    if answer.verdict is Verdict.NAMED:
        means = " ".join(x.meaning for x in answer.causes)
        return (
            "A misfit is detected, and only one known cause fits: "
            f"{listed(map(cause_label, answer.cause_names))}. {means} Its size is "
            f"{listed(map(size_words, answer.causes))}. {HYPOTHESIS}"
        )
    untested = [x.reason for x in answer.rivals if x.reason and x.could_matter]
    if answer.verdict is Verdict.AMBIGUOUS:
        names = listed(map(cause_label, answer.group), "or")
        sentences = [answer.sentence, *([f"Candidates: {names}."] if names else [])]
        return " ".join([*sentences, *untested])
    if answer.verdict is Verdict.UNEXPLAINED and answer.line is not None:
        return f"{answer.sentence} {answer.line.sentence}"
    if answer.verdict is Verdict.NOT_TESTABLE:
        found = [x.sentence for x in answer.findings if x.severity is Severity.ERROR]
        return " ".join([answer.verdict.sentence, *(x for x in answer.reasons if x not in found)])
    return " ".join([answer.sentence, *untested])


def size_words(cause: Cause) -> str:
    """The amplitude of a cause with its interval."""
    (low, high), unit = cause.ci95, cause.unit
    value = amount(cause.amplitude, unit)
    if low is None and high is None:
        return f"{value} (95 % open to both sides)"
    if low is None:
        return f"{value} (95 % open below, up to {amount(high, unit)})"
    if high is None:
        return f"{value} (95 % from {amount(low, unit)}, open above)"
    return f"{value} (95 % from {amount(low, '')} to {amount(high, unit)})"


def _verdict_tables(answer: Diagnosis) -> tuple[Table, ...]:
    # Its sentence holds them where nothing could be tested.
    # What is plausible is known of a cause's size, which is its first amplitude.
    rows = tuple(
        (
            f"{cause_label(cause.name)}, {label(name)}",
            x.value,
            *_or("open", x.ci95),
            cause.source if k == 0 else "",
        )
        for cause in answer.causes
        for k, (name, x) in enumerate(_largest_first(cause.parameters))
    )
    heads = ("amplitude", ("value", None), ("95 % from", None), ("to", None), "plausible size")
    others = tuple(
        (
            listed(map(cause_label, x.causes)) or "no cause",
            x.log_evidence_deficit,
            x.distance,
            x.state.value,
        )
        for x in answer.rivals
    )
    names = (
        "other explanation",
        ("log evidence behind", 1),
        ("distance", 1, "sd of the noise"),
        "state",
    )
    tables = [
        table(
            f"Verdict: {answer.verdict.value}",
            ("reason",),
            ((x,) for x in answer.reasons if answer.verdict is not Verdict.NOT_TESTABLE),
        ),
        table("Size of the cause", heads, rows, most=MOST_AMPLITUDES),
        table("Other explanations", names, others),
    ]
    if answer.misfit is not None:
        misfit = answer.misfit
        strength = (
            ("p-value of such a misfit from noise alone", answer.p_value),
            (
                f"chi-square{' without the cause' if answer.causes else ''}",
                misfit.chi_square_before,
            ),
            *([("chi-square with the cause", misfit.chi_square_after)] if answer.causes else []),
            ("measured values", misfit.n_measured),
        )
        tables.append(table("Strength of evidence", ("test", ("value", None)), strength))
    return tuple(x for x in tables if x.rows)


def _largest_first(amplitudes: Mapping[str, Estimate]) -> Sequence[tuple[str, Estimate]]:
    """The amplitudes as they are, or where they are many the largest first."""
    if len(amplitudes) <= MOST_AMPLITUDES:
        return [*amplitudes.items()]
    return sorted(amplitudes.items(), key=lambda x: -abs(x[1].value))


def _where(misfit: Misfit) -> Said:
    """Where the misfit is largest."""
    angles: dict[tuple[str, str], list[str]] = {}
    for x in misfit.cells:
        place = coordinate_words(x.coordinate), x.direction
        angles.setdefault(place, []).append(f"{x.flexion_deg:g}")
    places = listed(
        f"{coordinate} {_under(direction)} at {listed(own)} deg of flexion"
        for (coordinate, direction), own in angles.items()
    )
    share = f"{100 * misfit.share:.0f} % of what exceeds the noise is there."
    return f"The misfit is largest in {places}. {share}", table(
        "Cells that stand out",
        ("coordinate", ("flexion", 0, "deg"), "load", ("score", 1), ("p", None)),
        (
            (label(x.coordinate), x.flexion_deg, x.direction, x.score, x.p_value)
            for x in misfit.cells
        ),
    )


def _missing(pulls: Sequence[Pull]) -> Said:
    """All forces and moments that the model lacks, of which a picture shows the largest."""
    most = max(pulls, key=lambda x: (x.p_value <= LEVEL, hypot(*_forces(x))))
    where = f"{_under(most.direction)} at {most.flexion_deg:g} deg of flexion"
    force = amount(hypot(*_forces(most)), "N")
    return f"The largest force that the model lacks on the tibia is {force}, {where}.", table(
        "Missing force and moment on the tibia",
        (
            *(("flexion", 0, "deg"), "load"),
            *(("anterior force", 0, "N"), ("lateral force", 0, "N")),
            *(("internal moment", 1, "N·m"), ("p", None)),
        ),
        ((x.flexion_deg, x.direction, *_forces(x), x.internal_moment_Nm, x.p_value) for x in pulls),
    )


def _forces(pull: Pull) -> tuple[float, float]:
    return pull.anterior_force_N, pull.lateral_force_N


def _gain(gain: GainFound) -> Said:
    """Errors of held-out trials, and what the cause gains there."""
    held, expected = gain.rmse_held_out, gain.rmse_held_out_expected
    names = {
        "before": "without the cause",
        "after": "with the cause",
        "absorbed": "with a Gaussian process in place of a cause",
    }
    return _gain_sentence(gain), table(
        "Errors of held-out trials",
        (
            "model",
            *(("error", 2, unit) for unit in ("mm", "deg", "sd of the noise")),
            ("expected if the model is right", 2, "sd of the noise"),
        ),
        (
            (words, held[key].mm, held[key].deg, held[key].noise, expected[key].noise)
            for key, words in names.items()
        ),
    )


def _gain_sentence(gain: GainFound) -> str:
    """What the cause gains where trials are held out, claimed beyond two standard errors only."""
    held = gain.rmse_held_out
    errors = f"{held['after'].noise:.2f} times the noise, {held['before'].noise:.2f} without it"
    if gain.elpd_difference > LEAST_GAIN * gain.elpd_se:
        return (
            f"With the cause, the error on held-out trials is {errors}; their log predictive "
            f"density rises by {_rise(gain)}."
        )
    flexion = gain.families.get(FLEXION)
    alone = (
        f" With one flexion angle left out at a time it changes by {_rise(flexion)}."
        if flexion is not None and flexion.folds
        else ""
    )
    return (
        f"The cause does not clearly improve the prediction of held-out trials: their error is "
        f"{errors}, and their log predictive density changes by {_rise(gain)}; a gain counts from "
        f"{LEAST_GAIN:g} standard errors on.{alone}"
    )


def _rise(gain: GainFound | FamilyGain) -> str:
    return f"{amount(gain.elpd_difference, '')} ± {amount(gain.elpd_se, '')}"


def _under_limits(models: Sequence[CauseUnderLimits]) -> Said:
    """What limits of plausibility cost the model, and which cause pays for it."""
    base, *causes = models
    sentence = f"Without a cause the limits of plausibility cost {base.price:.1f}."
    if causes and causes[0].price is not None:
        best = causes[0]
        names = listed(map(cause_label, best.names))
        sentence += f" With {names} as the cause they cost {best.price:.1f}."
        if best.log_data_difference is not None and best.log_limits_difference is not None:
            sentence += (
                f" The log evidence of the data changes by {best.log_data_difference:.1f}. The log "
                "probability that a knee of the model is plausible changes by "
                f"{best.log_limits_difference:.1f}, which is no evidence of these data."
            )
    return sentence, table(
        "Causes where limits of plausibility count",
        (
            *("model with limits", ("price", 1), ("beyond limits", 1)),
            *(("change of log evidence", 1), ("change of log p(limits)", 1), ("sd", 1)),
        ),
        (
            (
                listed(map(cause_label, x.names)) or "no cause",
                *_or(
                    "not known",
                    (
                        *(x.price, x.of_limits),
                        *(x.log_data_difference, x.log_limits_difference, x.log_limits_se),
                    ),
                ),
            )
            for x in models
        ),
    )


def _change(answer: Diagnosis) -> Said:
    before, after = (_flat(x) for x in (answer.parameters_before, answer.parameters_after))
    old, new = (_flat(x) for x in (answer.parameters_before_ci95, answer.parameters_after_ci95))
    rows: list[tuple[str | float, ...]] = [
        (label(x), value, *_or("open", old[x]), after[x], *_or("open", new[x]))
        for x, value in before.items()
    ]
    moves = {x: abs(after[x] - value) / _width(old[x]) for x, value in before.items()}
    heads: tuple[str, ...] = ("parameter", "without", "95 % from", "to", "with", "95 % from", "to")
    title = "Parameters without and with the cause"
    sentence = "The table lists the fitted ligament parameters without any added cause."
    if not answer.causes:
        rows, heads, title = [x[:4] for x in rows], ("parameter", "value", *heads[2:4]), "Fit"
    else:
        most = sorted(moves, key=lambda x: -moves[x])[:MOST_PARAMETERS]
        words = listed(map(parameter_words, most))
        sentence = f"The cause changes the fitted parameters, most of all {words}."
    return sentence, table(title, heads, rows)


def _better_known(answer: Diagnosis, advice: Advice) -> Statement:
    """Whether a stated error known better would separate rivals better than one more trial."""
    least = {name: min(x) for name, x in advice.distance_with_error_halved.items()}
    trial, now = min(advice.distance_with_one_trial), min(advice.distance_before)
    order = sorted(least, key=lambda x: -least[x])
    best, distances = order[0], {error_words(x): least[x] for x in order}
    distances["the first trial to add"] = trial
    rows = sorted(distances.items(), key=lambda x: x[1], reverse=True)
    return Statement(
        question=Question.NEXT,
        sentence=f"Knowing the {error_words(best)} twice as well"
        f"{sizes_words(answer.nuisances, best)} would put the nearest rival {least[best]:.1f} "
        f"units of noise away instead of {now:.1f}; the first trial to add, {trial:.1f}.",
        tables=(
            table(
                "What would separate the nearest rival",
                ("known twice as well, or added", ("distance", 1, "sd of the noise")),
                rows,
            ),
        ),
    )


def _parameters_by_explanation(answer: Diagnosis) -> Said | None:
    """What the ligaments' parameters are under every explanation that is open."""
    rivals = [_flat(x.parameters) for x in answer.rivals if x.state is RivalState.OPEN]
    if not rivals or not answer.causes:
        return None
    intervals, rows, held = _flat(answer.parameters_after_ci95), [], []
    for name, best in _flat(answer.parameters_after).items():
        values = [best, *(x[name] for x in rivals)]
        low, high = intervals[name]
        # Open ends have no value to compare.
        is_free = (low is None or low <= min(values)) and (high is None or max(values) <= high)
        rows.append((label(name), min(values), max(values), "no" if is_free else "yes"))
        held += [] if is_free else [parameter_words(name)]
    who = "Whichever of the possible causes it is, the ligament parameters"
    finding = "stay within their intervals"
    if held:
        who = "More than one cause remains possible, and these parameters"
        finding = f"depend on which of them it is: {listed(held)}"
    heads = ("parameter", "from", "to", "depends on the cause")
    return f"{who} {finding}.", table("Parameters under all open explanations", heads, rows)


def _tried(effects: Mapping[str, Exclusion], uncertain: Set[str]) -> Said:
    """Every cause that was tested, and those that were not."""
    rows = tuple(
        (cause_label(name), FOUND[x.cell], x.score, *detectable_sizes(x), 100.0 * x.power)
        for name, x in effects.items()
    )
    heads = ("cause", "finding", ("score", 1), *SIZES, ("chance of detecting it", 0, "%"))
    counts = Counter(FOUND[x.cell] for x in effects.values())
    known = [x for x, y in FACTS.items() if x not in NOT_OFFERED and not y.is_numerical]
    missing = [cause_label(x) for x in known if x not in effects and x not in uncertain]
    stated = [cause_label(x) for x in known if x in uncertain]
    sentence = f"Of {len({*known, *effects})} known causes, {len(effects)} were tested: "
    sentence += f"{listed(f'{counts[x]} {x}' for x in dict.fromkeys(FOUND.values()) if counts[x])}."
    if missing:
        sentence += f" Not testable with these data or this knee: {listed(missing)}."
    if stated:
        sentence += f" Taken as uncertain from the start: {listed(stated)}."
    return sentence, table("Every cause tested", heads, rows)


def _under(direction: str) -> str:
    """A direction of load as it follows what it moves."""
    return "without load" if direction in ("no load", "unloaded") else f"under {direction}"


def _flat(tree: Mapping[str, Mapping[str, Value]] | None) -> dict[str, Value]:
    return {f"{owner}.{k}": x for owner, own in (tree or {}).items() for k, x in own.items()}


def _width(ends: Interval) -> float:
    """Width of an interval, for ranking; infinite where it is open."""
    low, high = ends
    return float("inf") if low is None or high is None else max(high - low, 1e-12)


def _or(word: str, values: Iterable[float | None]) -> Iterator[float | str]:
    """The values, with a word for those that are not there."""
    return (word if x is None else x for x in values)


class DiagnosisPresenter(Presenter[Diagnosis]):
    """How a diagnosis is shown."""

    question = Question.WRONG

    @override
    def statements(self, answer: Diagnosis) -> Iterator[Statement]:
        """The verdict, where the misfit is, what the cause changes, and which trials would help."""
        yield self.say(verdict_sentence(answer), *_verdict_tables(answer), is_answer=True)
        if answer.misfit is not None and answer.misfit.cells:
            yield self.say(*_where(answer.misfit), is_answer=True)
        # Null where no trial could be held out.
        if answer.gain is not None and answer.gain.rmse_held_out["after"].noise >= 0.0:
            yield self.say(*_gain(answer.gain))
        if answer.under_limits and answer.under_limits[0].price is None:
            yield self.say(
                "With limits of plausibility no fit has an equilibrium in every trial. Begin one "
                "elsewhere with --start."
            )
        elif answer.under_limits:
            yield self.say(*_under_limits(answer.under_limits), is_answer=True)
        if answer.parameters_before is not None:
            yield self.say(*_change(answer))
        if (whichever := _parameters_by_explanation(answer)) is not None:
            yield self.say(*whichever)
        if answer.missing_wrench and answer.verdict is not Verdict.ADEQUATE:
            yield self.say(*_missing(answer.missing_wrench))
        if answer.noise is not None:
            yield self.say(answer.noise.sentence)
        if answer.effects:
            uncertain = {x.name.partition(".")[0] for x in answer.nuisances}
            yield self.say(*_tried(answer.effects, uncertain))
        if answer.advised_trials:
            advice = "" if answer.advice is None else answer.advice.sentence
            yield Statement(
                question=Question.NEXT,
                sentence=f"Next test: {trials_words(answer.advised_trials)}. {advice}",
                tables=(trial_table(answer.advised_trials),),
                is_answer=True,
            )
        if answer.advice is not None and answer.advice.distance_with_error_halved:
            yield _better_known(answer, answer.advice)

    @override
    def drawings(self, answer: Diagnosis, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        """Where the model is wrong, what the cause explains, and the parameters it changes."""
        from identknee.report.diagnosis_figures import (
            misfit_figure,
            misfit_words,
            parameters_before_after_figure,
            residuals_figure,
            wrench_figure,
        )

        misfit, trials, residuals = answer.misfit, answer.trials, answer.residuals
        # None of them where the data cannot be tested.
        if misfit is None or trials is None or residuals is None:
            return
        where = misfit_words(misfit.cells, misfit.share)
        yield Drawing(
            name="misfit",
            figure=misfit_figure(misfit.map, where),
            caption="Measured minus predicted, in units of the noise: red where more was measured, "
            "blue where less. Framed cells are significant.",
            description=f"Map of the misfit by coordinate, flexion and load: {where}.",
        )
        causes = listed(map(cause_label, answer.cause_names))
        if answer.forces_after is not None:
            yield compared_forces_drawing(answer.forces_after)
        before = residuals.before
        changes = {f"what is explained by {causes}": before - residuals.after} if causes else {}
        if (figure := residuals_figure(trials.protocol, before, residuals.sd, changes)) is not None:
            yield Drawing(
                name="residuals",
                figure=figure,
                caption="Residuals of the model under every load (dots, with two standard "
                "deviations of the noise)"
                + (", and what the cause explains of it (line)." if causes else "."),
                description="Measured minus predicted laxity under every load"
                + (f", with the part that {causes} explains." if causes else "."),
            )
        is_wrong = answer.verdict is not Verdict.ADEQUATE
        if knee is not None and is_wrong and (figure := wrench_figure(answer, knee)) is not None:
            yield Drawing(
                name="missing-wrench",
                figure=figure,
                caption="Missing force and moment on the tibia, seen from above: arrows are "
                "forces, arcs are moments. Grey is the range that noise alone could explain.",
                description="Forces and moments that the model lacks, by flexion and load.",
            )
        # Without a cause there is nothing to compare.
        if causes:
            yield Drawing(
                name="before-after",
                figure=parameters_before_after_figure(answer),
                caption="The ligament parameters with their 95 % intervals, without and with the "
                "cause.",
                description=f"Fitted parameters of {listed(answer.parameters_before or ())}, "
                f"without and with {causes}.",
            )

    @override
    def curves(self, answer: Diagnosis, beside: Sequence[Answer]) -> "LaxityCurves | None":
        """The laxity of the model without and with the causes; None where nothing was tested."""
        from identknee.report.laxity_figures import LaxityCurves

        trials, residuals = answer.trials, answer.residuals
        if trials is None or residuals is None:
            return None
        simulated = {"model": trials.coordinates - residuals.before}
        if answer.causes:
            with_causes = f"with {listed(map(cause_label, answer.cause_names))}"
            simulated[with_causes] = trials.coordinates - residuals.after
        return LaxityCurves(
            protocol=trials.protocol,
            simulated=simulated,
            measured=trials.coordinates,
            sd=trials.sd,
            band=None,
        )

    @override
    def pictures(self, answer: Diagnosis, knee: Knee) -> dict[str, "Figure"]:
        from identknee.report.diagnosis_figures import diagnosis_figures

        return diagnosis_figures(answer, knee)

    @override
    def method(self, answer: Diagnosis) -> Iterator[str]:
        n = len(answer.effects)
        if n:
            yield f"{n} possible causes of misfit were tested against the data."
        if answer.steps:
            yield (
                f"The largest score of all exceeds {answer.steps[0].quantile:.3g} by chance in 5 % "
                "of data sets."
            )
        if answer.noise is not None:
            yield answer.noise.sentence
        if answer.p_value is not None:
            yield f"Noise alone leaves such a misfit with p = {answer.p_value:.2g}."

    @override
    def ranges(self, answer: Diagnosis) -> Iterator[tuple[str, Range]]:
        models = [
            (
                Source.DIAGNOSIS,
                answer.parameters_before,
                answer.parameters_before_ci95,
                answer.made_by_priors_before,
            ),
            (
                Source.CAUSE,
                answer.parameters_after,
                answer.parameters_after_ci95,
                answer.made_by_priors_after,
            ),
        ]
        for source, values, intervals, made_by_priors in models[: 2 if answer.causes else 1]:
            ends = _flat(intervals)
            for name, value in _flat(values).items():
                low, high = ends[name]
                status = open_ends_text(low, high)
                if status == CLOSED and name in made_by_priors:
                    status = BY_ASSUMPTION
                yield name, Range(source=source, low=low, high=high, value=value, status=status)

    @override
    def doubt(self, answer: Diagnosis, source: Source) -> str | None:
        return answer.doubt_after if source is Source.CAUSE else answer.doubt_before

    @override
    def protocol(self, answer: Diagnosis) -> Protocol | None:
        return None if answer.trials is None else answer.trials.protocol

    @override
    def missing_line(self, answer: Diagnosis, knee: Knee) -> Array | None:
        line = answer.line
        return line.in_common_frame(knee) if line is not None and line.is_line else None
