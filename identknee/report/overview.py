"""The head of a report: one verdict, one table, the fits, the next tests."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from enum import Enum, unique
from math import inf, isinf, sqrt

import numpy as np

from identknee.checks.fit_checks import ALIKE, SAME
from identknee.diagnosis.verdict import Verdict
from identknee.identify.sweep import WITHIN
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.laxity.trial_words import load_words
from identknee.model.effects.facts import cause_label
from identknee.report.opening import Opening, opening_of
from identknee.report.presenter import (
    NOT_CONVERGED,
    Range,
    Source,
    of_type,
    presenter_of,
    statements_of,
)
from identknee.runs.declare import declared, entry
from identknee.runs.record import Outcome
from identknee.runs.words import (
    amount,
    capitalised,
    interval,
    label_without_unit,
    listed,
    listed_first,
    parameter_words,
    unit_of,
)
from identknee.verbs.answer import Answer, Question
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.fit import Calibration
from identknee.verbs.sweep import Sweep

# Share of a set's width: ends that differ by less count as equal.
NEAR = 0.15


@unique
class Relation(Enum):
    """How one range compares with another; the value follows the name of its method."""

    SAME = "agrees"
    NARROWER = "is narrower"
    WIDER = "is wider"
    LOWER = "lies lower"
    HIGHER = "lies higher"
    APART = "contradicts"
    CLOSED = "closes it"
    OPEN = "leaves it open"


@declared
class Agreement:
    """What other methods say of a quantity beside the main one."""

    main: Range = entry("What the table shows")
    others: tuple[tuple[Range, Relation], ...] = entry("Every other method with how it lies to it")

    @property
    def differing(self) -> tuple[tuple[Range, Relation], ...]:
        """Those that do not agree."""
        return tuple(x for x in self.others if x[1] is not Relation.SAME)

    @property
    def is_contradicted(self) -> bool:
        """Whether a method with the same model excludes all that the main one allows."""
        return any(y is Relation.APART and x.source is not Source.CAUSE for x, y in self.others)

    @property
    def is_moved_by_cause(self) -> bool:
        """Whether the model with a cause excludes all that the one without allows."""
        return any(y is Relation.APART and x.source is Source.CAUSE for x, y in self.others)

    def sentence(self, unit: str) -> str:
        """Which methods agree, and how the others differ."""
        n = 1 + len(self.others)
        if n == 1:
            return f"{self.main.source.value} only"
        agreeing = n - len(self.differing)
        if agreeing == n:
            return f"{'both' if n == 2 else f'all {n}'} agree"
        parts = [f"{agreeing} of {n} agree"] if agreeing > 1 else []
        parts += [
            f"{x.source.value} {relation.value} ({interval((x.low, x.high), unit)})"
            for x, relation in self.differing
        ]
        return "; ".join(parts)

    def brief(self) -> str:
        """The same in a few words, without ranges: those that contradict, and how many differ."""
        n, differing = 1 + len(self.others), self.differing
        if not differing:
            return self.sentence("")
        apart = [x.source.value for x, relation in differing if relation is Relation.APART]
        if len(differing) == 1:
            parts = [f"{x.source.value} {relation.value}" for x, relation in differing]
        else:
            parts = [f"contradicted by {listed(apart)}"] if apart else []
            if len(apart) < len(differing):
                parts.append(f"{len(differing) - len(apart)} of {n} differ")
        return "; ".join(parts)


def agreement(ranges: Sequence[Range]) -> Agreement:
    """The first of these ranges, and how each of the others lies to it."""
    main, *others = ranges
    return Agreement(main=main, others=tuple((x, relation(main, x)) for x in others))


def relation(main: Range, other: Range) -> Relation:
    """How `other` lies to `main`, scaled to the same limit of misfit where that is known."""
    (low, high), (own_low, own_high) = (
        _with_infinities(x) for x in (_scaled(other), (main.low, main.high))
    )
    if high < own_low or low > own_high:
        return Relation.APART
    if (isinf(low) and not isinf(own_low)) or (isinf(high) and not isinf(own_high)):
        return Relation.OPEN
    if isinf(own_low) or isinf(own_high):
        is_same = isinf(own_low) == isinf(low) and isinf(own_high) == isinf(high)
        return Relation.SAME if is_same else Relation.CLOSED
    slack = NEAR * (own_high - own_low)
    below, above = own_low - low, high - own_high
    if abs(below) <= slack and abs(above) <= slack:
        return Relation.SAME
    if min(below, above) > -slack and below + above > slack:
        return Relation.WIDER
    if max(below, above) <= slack and below + above < -slack:
        return Relation.NARROWER
    return Relation.HIGHER if above > below else Relation.LOWER


def reasons(agreements: Iterable[Agreement]) -> str:
    """Which methods are compared and why some differ, in one line; empty where one stands alone."""
    seen = list(agreements)
    ranges = [x for own in seen for x in (own.main, *(other for other, _ in own.others))]
    sources = [x for x in Source if any(y.source is x for y in ranges)]
    if len(sources) < 2:
        return ""
    differing = {x.source for own in seen for x, _ in own.differing}
    sentences = [f"Methods compared: {listed(x.value for x in sources)}."]
    sentences += [_WHY[x] for x in sources if x in differing and x in _WHY]
    if any(x.status == NOT_CONVERGED for x in ranges):
        sentences.append("The posterior has not converged yet.")
    scales = sorted({x.reach for x in ranges if x.reach not in (None, 1.0)} - {None})
    sentences += [
        f"Equivalent sets reach to {x:.2g} times the squared misfit that ends a 95 % set; for the "
        "comparison they are scaled to the same misfit."
        for x in scales
    ]
    return " ".join(sentences)


_WHY = {
    Source.POSTERIOR: "The posterior adds the prior to the data.",
    Source.DIAGNOSIS: "The diagnosis takes the noise from the scatter of the data, and the model "
    "as linear near the fit.",
    Source.CAUSE: "With the cause the model is different, so its values may differ.",
    Source.INFORMATION: "The local approximation linearises the model at the fit.",
    Source.EQUIVALENTS: "Equivalent sets show how far a fit can move, not what is excluded.",
}


def _with_infinities(ends: tuple[float | None, float | None]) -> tuple[float, float]:
    low, high = ends
    return -inf if low is None else low, inf if high is None else high


def _scaled(x: Range) -> tuple[float | None, float | None]:
    if x.low is None or x.high is None or x.value is None or x.reach in (None, 1.0):
        return x.low, x.high
    factor = 1.0 / sqrt(x.reach or 1.0)
    return x.value + factor * (x.low - x.value), x.value + factor * (x.high - x.value)


def ranges_of(answers: Sequence[Answer]) -> dict[str, list[Range]]:
    """By the name of a parameter or force, what each method says of it, the most informative first.

    If two answers are of one kind, the later counts. Nothing is known at a fit that is rejected or
    implausible, by an answer's own findings or by a diagnosis of the same knee.
    """
    found: dict[str, dict[Source, Range]] = {}
    diagnoses = of_type(answers, Diagnosis)
    for answer in answers:
        presenter = presenter_of(answer)
        rejected = next((x.doubt_before for x in diagnoses[-1:] if _same_knee(x, answer)), None)
        for name, own in presenter.ranges(answer):
            shown = own
            if own.status in KNOWN:
                doubt = presenter.doubt(answer, own.source)
                doubt = doubt or (None if own.source is Source.CAUSE else rejected)
                shown = own if doubt is None else replace(own, status=doubt)
            found.setdefault(name, {})[own.source] = shown
    order = list(Source)
    return {
        name: sorted(by_source.values(), key=lambda x: order.index(x.source))
        for name, by_source in found.items()
    }


def _same_knee(one: Answer, other: Answer) -> bool:
    """Whether two answers are of the same knee and data; of those without record it is supposed."""
    inputs = [{} if x.record is None else x.record.inputs for x in (one, other)]
    return not any(
        (first := inputs[0].get(x)) and (second := inputs[1].get(x)) and first != second
        for x in ("subject", "data")
    )


# More fits than these are given as a range.
MOST_LISTED_FITS = 4
MOST_SEARCHES_NAMED = 2
ENDED = {
    Outcome.MINIMUM: "a minimum",
    Outcome.VALLEY: "stopped early",
    Outcome.CLIFF: "stopped at a cliff",
    Outcome.BUDGET: "budget used up",
    Outcome.SPREAD: "population shrunk",
}


def searches_sentences(answers: Sequence[Answer]) -> tuple[str, ...]:
    """Fits and sweeps in a few sentences; none without a search."""
    fits = fits_by_start(answers)
    several = [] if len(fits) < 2 else [*_several(fits)]
    failed = [x for x in of_type(answers, Calibration) if x.outcome is Outcome.START_FAILED]
    alone = [*([] if several else fits.values()), *failed, *of_type(answers, Sweep)]
    return (*several, *(statements_of(x)[0].sentence for x in alone))


def has_better_fit(fit: Calibration, others: Iterable[Calibration]) -> bool:
    """Whether another fit of the same data has smaller errors of both lengths and angles."""
    return fit.rmse.n_compared > 0 and any(
        np.array_equal(x.data.coordinates, fit.data.coordinates, equal_nan=True)
        and x.rmse.n_compared >= fit.rmse.n_compared
        and all(
            np.isnan(own) or own > (1.0 + ALIKE) * other
            for own, other in ((fit.rmse.mm, x.rmse.mm), (fit.rmse.deg, x.rmse.deg))
        )
        for x in others
    )


def fits_by_start(answers: Sequence[Answer]) -> dict[str, Calibration]:
    """Fits that ended by their start, and by their method too where several began there."""
    found = [x for x in of_type(answers, Calibration) if x.outcome is not Outcome.START_FAILED]
    starts = Counter(x.start for x in found)
    names = [x.start if starts[x.start] == 1 else f"{x.start} ({_method(x)})" for x in found]
    # Fits alike in both, as with other settings, are distinguished by their number.
    seen: Counter[str] = Counter()
    by_start = {}
    for name, fit in zip(names, found, strict=True):
        seen[name] += 1
        by_start[name if seen[name] == 1 else f"{name}, fit {seen[name]}"] = fit
    return by_start


def _several(fits: Mapping[str, Calibration]) -> Iterator[str]:
    if alike := _alike(fits):
        yield alike
    elif len(fits) <= MOST_LISTED_FITS:
        each_fit = "; ".join(
            f"from {name} by {_method(x)} to {_errors(x)} "
            f"({_end(x)}, {x.n_simulations} simulations)"
            for name, x in fits.items()
        )
        yield f"{len(fits)} fits reproduce the measured laxity (RMSE): {each_fit}."
    else:
        best, worst = (f(fits.values(), key=lambda x: x.objective) for f in (min, max))
        yield (
            f"{len(fits)} fits reproduce the measured laxity (RMSE) to {_errors(best)} at best and "
            f"{_errors(worst)} at worst."
        )
    if differ := disagreement(fits):
        lowest = min(fits, key=lambda x: fits[x].objective)
        yield f"{differ} The lowest misfit is that from {lowest}."
    else:
        yield f"They end at the same parameters, to within {WITHIN:g} kN and {WITHIN:g} %."
    yield "That a model fits does not show that its parameters are right."


def _alike(fits: Mapping[str, Calibration]) -> str:
    """Fits that ended alike, in one sentence; empty where they differ or are many."""
    one = next(iter(fits.values()))
    alike = {(_errors(x), x.outcome, x.method) for x in fits.values()}
    if len(alike) > 1 or len(fits) > MOST_LISTED_FITS:
        return ""
    counts = sorted({x.n_simulations for x in fits.values()})
    many = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return (
        f"The {len(fits)} fits from {listed(fits)} by {_method(one)} all reproduce the measured "
        f"laxity to {_errors(one)} (RMSE; {_end(one)} after "
        f"{many} simulations)."
    )


def _end(fit: Calibration) -> str:
    return ENDED.get(fit.outcome, str(fit.outcome.value))


def _method(fit: Calibration) -> str:
    return fit.method.replace("-", " ")


def _errors(fit: Calibration) -> str:
    sizes = ((fit.rmse.mm, "mm"), (fit.rmse.deg, "deg"))
    return listed(amount(size, unit) for size, unit in sizes if np.isfinite(size))


def disagreement(fits: Mapping[str, Calibration]) -> str:
    """That fits from different starts end at different parameters; empty where they do not."""
    if len(fits) < 2:
        return ""
    starts, own = list(fits), list(fits.values())
    shared = [x for x in own[0].parameter_names if all(x in y.parameter_names for y in own)]
    ends = np.array([[x.search.theta[x.parameter_names.index(y)] for y in shared] for x in own])
    spread = np.ptp(ends, axis=0)
    clauses = []
    for j in np.argsort(-spread)[:MOST_SEARCHES_NAMED]:
        if spread[j] > WITHIN:
            name, k = shared[j], sorted((int(ends[:, j].argmin()), int(ends[:, j].argmax())))
            ended = [f"{amount(float(ends[i, j]), unit_of(name))} from {starts[i]}" for i in k]
            clauses.append(f"{parameter_words(name)} is {listed(ended, 'but')}")
    if not clauses:
        return ""
    return f"Different starts end at different parameters: {'; '.join(clauses)}."


def stale_answers(answers: Sequence[Answer]) -> dict[int, Answer]:
    """Places of answers at a best fit that another one undercuts, with the lowest such other.

    Both were asked the same question. Fits alone from several starts are compared elsewhere.
    """
    found = {}
    for place, own in enumerate(answers):
        others = [
            x
            for x in answers
            if x.best_deviance < own.best_deviance - SAME
            and not (isinstance(x, Calibration) and isinstance(own, Calibration))
            and _differences(own.question, x.question) == ()
        ]
        if others:
            found[place] = min(others, key=lambda x: x.best_deviance)
    return found


def question_sentences(answers: Sequence[Answer]) -> Iterator[str]:
    """Which answers are out of date, and in what the questions of the others differ."""
    for place, better in stale_answers(answers).items():
        own = answers[place]
        has_file = isinstance(better, Calibration)
        begun = " with --start fitted/fitted.toml, of the folder of that fit" if has_file else ""
        yield (
            f"{_verb(own).capitalize()} rests on a fit of deviance {own.best_deviance:.4g}, and "
            f"{_verb(better)} found one of {better.best_deviance:.4g}: {_verb(own)} is out of "
            f"date and should be run again{begun}."
        )
    asked = [x for x in answers if x.question is not None]
    if len(asked) < 2:
        return
    groups: dict[tuple[str, ...], list[str]] = {}
    first = asked[0]
    for x in asked[1:]:
        if differences := _differences(first.question, x.question):
            groups.setdefault(differences, []).append(_verb(x))
    for differences, verbs in groups.items():
        yield (
            f"{listed(dict.fromkeys(verbs)).capitalize()} and {_verb(first)} were asked different "
            f"questions: they differ in {listed(differences)}."
        )


def _differences(one: Question | None, other: Question | None) -> tuple[str, ...] | None:
    """In what two questions differ; None where one is not known."""
    return None if one is None or other is None else one.differences(other)


def _verb(answer: Answer) -> str:
    return "a fit" if answer.record is None else answer.record.verb


MOST_NAMED = 3
KNOWN = ("known", "probable", "known locally")
FORCE = ".tension_N@"


@unique
class Tone(Enum):
    """How a verdict is meant; the value is its class on the page."""

    GOOD = "good"
    OPEN = "open"
    WRONG = "wrong"


@declared
class Row:
    """A parameter or force in the table."""

    name: str = entry("Its name in results")
    label: str = entry("Its name in words")
    estimate: str = entry("Estimate with its unit")
    limits: str = entry("Set with its unit")
    status: str = entry("What is known, in a word or three")
    agreement: str = entry("Whether methods agree, and if not how they differ")
    found: Agreement = entry("Agreement of the methods in numbers")


@declared
class Overview:
    """What all results of one data set say together."""

    verdict: str = entry(
        "One sentence or two; empty where no result says anything of parameters or model"
    )
    said: tuple[str, ...] = entry("The sentences of the verdict, one by one")
    tone: Tone = entry("How it is meant")
    opening: Opening = entry("What comes before it where a fit is rejected or implausible")
    rows: tuple[Row, ...] = entry("Parameters, then forces")
    reasons: str = entry("Why methods differ, in one line; empty where they do not")
    searches: tuple[str, ...] = entry("Sentences of fits and searches")
    questions: tuple[str, ...] = entry(
        "Which answers are out of date, and which were asked something else"
    )
    next_tests: tuple[str, ...] = entry("Tests to do, each with what it would bring")


def overview(answers: Sequence[Answer]) -> Overview:
    """What these answers, all of one data set, say together."""
    trials: dict[str, str] = {}
    for answer in answers:
        data = getattr(answer, "data", None)
        if isinstance(data, Laxity):
            trials |= _trial_words(data.protocol)
    rows = tuple(_row(*x, trials) for x in _shown(ranges_of(answers)))
    diagnosis = next(reversed(of_type(answers, Diagnosis)), None)
    differ = disagreement(fits_by_start(answers))
    fits = of_type(answers, Calibration)
    # Warnings of a fit that another one beats do not lead the page.
    opening = opening_of(
        x for x in answers if not any(has_better_fit(y, fits) for y in of_type([x], Calibration))
    )
    parameters = [x for x in rows if "@" not in x.name]
    sentences, tone = _verdict(parameters, diagnosis, differ, opening)
    shown = [presenter_of(x).headline(x) for x in answers]
    said = tuple(x for x in (*shown, *sentences) if x)
    if opening.sentences:
        tone = Tone.WRONG
    return Overview(
        verdict=" ".join(said),
        said=said,
        tone=tone,
        opening=opening,
        rows=rows,
        reasons=reasons(x.found for x in rows),
        searches=searches_sentences(answers),
        questions=tuple(question_sentences(answers)),
        next_tests=tuple(
            dict.fromkeys(test for x in answers for test in presenter_of(x).next_tests(x))
        ),
    )


def _trial_words(protocol: Protocol) -> dict[str, str]:
    """What each trial is about, without loads that stray; its name too where others are alike."""
    said = [load_words(protocol, k) for k in range(protocol.n)]
    return {
        name: x if said.count(x) == 1 else f"{x} ({name})"
        for name, x in zip(protocol.trials, said, strict=True)
    }


def _shown(ranges: Mapping[str, Sequence[Range]]) -> Iterator[tuple[str, Sequence[Range]]]:
    """Parameters, then the forces asked for, or of each ligament the least known one."""
    forces = {name: x for name, x in ranges.items() if FORCE in name}
    asked = [name for name, x in forces.items() if x[0].source is Source.PROFILE]
    widest: dict[str, str] = {}
    for name in sorted(forces, key=lambda x: -forces[x][0].width):
        widest.setdefault(name.partition(FORCE)[0], name)
    others = [x for x in ranges if x not in forces]
    yield from ((x, ranges[x]) for x in (*others, *(asked or widest.values())))


def _row(name: str, ranges: Sequence[Range], trials: Mapping[str, str]) -> Row:
    found, unit = agreement(ranges), unit_of(name)
    main = found.main
    owner, _, trial = name.partition(FORCE)
    is_slack = FORCE in name and main.low == main.high == 0.0
    limits = "slack" if is_slack else interval((main.low, main.high), unit)
    return Row(
        name=name,
        label=f"{owner} force, {trials.get(trial, trial)}" if trial else label_without_unit(name),
        estimate=amount(main.value, unit),
        limits=limits if main.reach == 1.0 else f"{limits} (not a 95 % set)",
        status=main.status,
        agreement=found.sentence(unit),
        found=found,
    )


def _verdict(
    rows: Sequence[Row], diagnosis: Diagnosis | None, differ: str, opening: Opening
) -> tuple[list[str], Tone]:
    model, tone = _model(diagnosis)
    unknown = [x for x in rows if x.status not in KNOWN]
    contradicted = [x.name for x in rows if x.found.is_contradicted]
    moved = [x.name for x in rows if x.found.is_moved_by_cause]
    sentences = [x for x in (model, _known(rows, unknown, diagnosis, opening)) if x]
    doubts = [f"methods contradict one another on {_named(contradicted)}"] * bool(contradicted)
    doubts += [f"with the cause {_named(moved)} lies outside its set"] * bool(moved)
    doubts += ["fits from different starts end at different parameters"] * bool(differ)
    if tone is Tone.GOOD and (unknown or doubts):
        tone = Tone.OPEN
    if doubts:
        sentences.append(
            f"However, {listed(doubts)}." if sentences else f"{capitalised(listed(doubts))}."
        )
    return sentences, tone


def _model(diagnosis: Diagnosis | None) -> tuple[str, Tone]:
    if diagnosis is None:
        return "", Tone.GOOD
    if diagnosis.verdict is Verdict.ADEQUATE:
        return "The model explains the data.", Tone.GOOD
    if diagnosis.verdict is Verdict.NOT_TESTABLE:
        return diagnosis.verdict.sentence, Tone.OPEN
    if diagnosis.verdict is Verdict.NAMED:
        names = listed(map(cause_label, diagnosis.cause_names))
        return f"A misfit is detected. Only one known cause fits: {names}.", Tone.WRONG
    return diagnosis.sentence, Tone.WRONG


def _known(
    rows: Sequence[Row], unknown: Sequence[Row], diagnosis: Diagnosis | None, opening: Opening
) -> str:
    """How many parameters are known, and on what condition."""
    if not rows:
        return ""
    n, proviso = len(rows), ""
    if opening.sentences and len(unknown) == n:
        return "None of the values below is known until that is explained."
    if diagnosis is None:
        proviso = ", if the model is right (not tested)"
    elif diagnosis.verdict is Verdict.NOT_TESTABLE:
        proviso = ", if the model is right"
    elif diagnosis.verdict is not Verdict.ADEQUATE:
        return "The sets below are conditional on the model."
    if not unknown:
        which = {1: "The one parameter is", 2: "Both parameters are"}.get(
            n, f"All {n} parameters are"
        )
        return f"{which} known within limits{proviso}."
    words = {x.status for x in unknown}
    names, n_known = _named([x.name for x in unknown]), n - len(unknown)
    share = f"{n_known or 'None'} of {n} parameters {'is' if n_known < 2 else 'are'}"
    known = f"{share} known within limits{proviso}"
    if words == {NOT_CONVERGED}:
        return f"{known}; the posterior of {names} has not converged yet."
    state = words.pop() if len(words) == 1 else "not"
    return f"{known}; {names} {'is' if len(unknown) == 1 else 'are'} {state}."


def _named(names: Sequence[str]) -> str:
    return listed_first([parameter_words(x) for x in names], MOST_NAMED)
