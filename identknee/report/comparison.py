"""Results side by side: of one knee, of several, of several models, before and after a change."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np

from identknee.calibrate.problem import (
    LIGAMENT_TERM,
    NUISANCE_TERM,
    PLAUSIBILITY_TERM,
    EvidenceTerm,
)
from identknee.laxity.protocol import ABSOLUTE, Protocol
from identknee.laxity.table import COORDINATES
from identknee.report.methods import given_options, value_words
from identknee.report.overview import FORCE, ranges_of
from identknee.report.presenter import Source, of_type, presenter_of
from identknee.report.results import Result, found_results, result_of
from identknee.runs.declare import (
    OF_COORDINATE,
    OF_QUANTITY,
    Array,
    array,
    declared,
    derived,
    entry,
)
from identknee.runs.files import PathLike
from identknee.runs.words import amount, interval, listed, unit_of
from identknee.verbs.answer import IN_WORDS, Answer, Question
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.fit import Calibration
from identknee.verbs.options import OutOption, argument, option
from identknee.verbs.sample import Sample
from identknee.verbs.simulate import SimulatedLaxity, Simulation
from identknee.verbs.verb import Run, verb

# Misfits are comparable only between answers that differ in none of these.
OF_MISFIT = frozenset({"trials", "weighting", "noise_mm", "noise_deg"})
# Options that the question has in words.
IN_QUESTION = frozenset(
    f"--{x}"
    for x in (
        *("noise", "priors", "fix", "bounds", "uncertain", "plausible"),
        *("keep", "leave-out", "weighting", "seed"),
    )
)
# Terms of the deviance that do not come from measured values.
NO_DATA = frozenset({LIGAMENT_TERM, NUISANCE_TERM, PLAUSIBILITY_TERM})
POINT, SIMULATED, NO_INTERVAL = "fit", "simulated with", "no interval"
FIXED = "held"


@declared
class Compared:
    """One of the results that are compared."""

    name: str = entry("Its name, as given or that of its folder")
    subject: str = entry("The knee, as the first call named it")
    subject_digest: str = entry("SHA-256 of the knee")
    data: tuple[str, ...] = entry("The laxity tables, as the call named them")
    data_digest: str = entry("SHA-256 of the laxity; empty for none")
    verbs: tuple[str, ...] = entry("The verbs that gave it")
    verdict: str = entry("Verdict of a diagnosis", only="a diagnosis", default="")
    causes: tuple[str, ...] = entry("Causes that it named", only="a diagnosis", default=())


@declared
class Stand:
    """What one result says of a quantity."""

    name: str = entry("Name of the result")
    estimate: float | None = entry("Its estimate; null where it has none", unit=OF_QUANTITY)
    lower: float | None = entry("Lower end of its 95 % set; null where open", unit=OF_QUANTITY)
    upper: float | None = entry("Upper end; null where open", unit=OF_QUANTITY)
    method: str = entry("The method: fit, or what gave the set")
    status: str = entry("What is known, in a word or three; no interval for a fit alone")

    @property
    def has_set(self) -> bool:
        """Whether a method gave a set, be it open."""
        return self.status not in (NO_INTERVAL, FIXED)

    @property
    def words(self) -> str:
        """Estimate and set without their unit."""
        value = amount(self.estimate, "")
        return f"{value} ({interval((self.lower, self.upper), '')})" if self.has_set else value


@declared
class ComparedQuantity:
    """A parameter, force or prediction in the results that have it."""

    name: str = entry("Its name in results")
    stands: tuple[Stand, ...] = entry("What each result that has it says")

    @property
    @derived("Whether two results exclude all that the other allows")
    def is_apart(self) -> bool:
        """Whether two sets have no value in common."""
        ends = [
            (-np.inf if x.lower is None else x.lower, np.inf if x.upper is None else x.upper)
            for x in self.stands
            if x.has_set
        ]
        return any(a[1] < b[0] for a in ends for b in ends)

    @property
    @derived("Largest difference of two estimates", unit=OF_QUANTITY)
    def spread(self) -> float:
        """Largest difference of two estimates; zero of one."""
        known = [x.estimate for x in self.stands if x.estimate is not None]
        return max(known) - min(known) if len(known) > 1 else 0.0


@declared
class ComparedMisfit:
    """How well one result fits its data."""

    name: str = entry("Name of the result")
    rmse_mm: float | None = entry("Root-mean-square error of lengths", unit="mm")
    rmse_deg: float | None = entry("Root-mean-square error of angles", unit="deg")
    terms: tuple[EvidenceTerm, ...] = entry("Terms of the deviance at the best fit")
    n_fitted: int | None = entry("Parameters fitted, without errors of knee and tests", unit="1")
    log_evidence: float | None = entry("Log evidence of nested sampling", unit="1")

    @property
    @derived("Deviance of the best fit; null where it is not known", unit="1")
    def deviance(self) -> float | None:
        """Deviance of the best fit."""
        return sum(x.deviance for x in self.terms) if self.terms else None

    @property
    @derived("Deviance of the data alone, without priors and limits", unit="1")
    def data_deviance(self) -> float | None:
        """Deviance of measured values alone."""
        own = [x.deviance for x in self.terms if x.name not in NO_DATA]
        return sum(own) if own else None


@declared
class Difference:
    """In what the results differ beside their numbers."""

    what: str = entry("A part of the question, an option, the knee or the data")
    values: tuple[str, ...] = entry("What each result has there")


@declared
class Comparison(Answer):
    """Results side by side: quantities, misfit, and in what the questions differ."""

    names: tuple[str, ...] = array("Names of the results", "result", is_in_arrays=False)
    items: tuple[Compared, ...] = entry("The results")
    parameters: tuple[ComparedQuantity, ...] = entry("Parameters of all results")
    forces: tuple[ComparedQuantity, ...] = entry("Ligament forces that two results or more have")
    predictions: tuple[ComparedQuantity, ...] = entry(
        "Other predictions that two results or more have"
    )
    misfits: tuple[ComparedMisfit, ...] = entry("How well each fits its data")
    is_misfit_comparable: bool = entry("Whether misfits and evidence are of the same data")
    why_not: str = entry("Why they are not; empty where they are")
    differences: tuple[Difference, ...] = entry("In what the results differ, part by part")
    coordinate_names: tuple[str, ...] = array(
        "Names of the coordinates", "coordinate", is_in_arrays=False
    )
    laxity_difference: Array = array(
        "Root-mean-square difference of the predicted laxity from that of the first result, over "
        "trials that both have; NaN where there are none",
        *("result", "coordinate"),
        unit=OF_COORDINATE,
        is_in_json=True,
    )
    n_trials_shared: tuple[int, ...] = entry("Trials that each shares with the first result")

    @property
    def quantities(self) -> tuple[ComparedQuantity, ...]:
        """Parameters, forces and predictions."""
        return (*self.parameters, *self.forces, *self.predictions)


def comparison(given: Mapping[str, Sequence[Result]]) -> Comparison:
    """Results side by side, by the name of each; one name may have results of several verbs."""
    answers = {name: [x.answer for x in own] for name, own in given.items()}
    quantities = _quantities(answers)
    forces = [x for x in quantities if FORCE in x.name and len(x.stands) > 1]
    predictions = [
        x for x in quantities if "@" in x.name and FORCE not in x.name and len(x.stands) > 1
    ]
    laxity = [_predicted(own) for own in answers.values()]
    rows = [_difference(laxity[0], x) for x in laxity]
    questions = [
        next((x.question for x in own if x.question is not None), None) for own in answers.values()
    ]
    why_not = _why_not([own[0].data_digest for own in given.values()], questions)
    return Comparison(
        names=tuple(given),
        items=tuple(_compared(name, own) for name, own in given.items()),
        parameters=tuple(x for x in quantities if "@" not in x.name),
        forces=tuple(sorted(forces, key=lambda x: -x.spread)),
        predictions=tuple(sorted(predictions, key=lambda x: -x.spread)),
        misfits=tuple(_misfit(name, own) for name, own in answers.items()),
        is_misfit_comparable=not why_not,
        why_not=why_not,
        differences=tuple(_differences(list(given.values()), questions)),
        coordinate_names=COORDINATES,
        laxity_difference=np.array([x for x, _ in rows]),
        n_trials_shared=tuple(n for _, n in rows),
        assumptions=tuple(_assumptions(answers)),
    )


def _compared(name: str, results: Sequence[Result]) -> Compared:
    first, found = results[0], of_type([x.answer for x in results], Diagnosis)
    return Compared(
        name=name,
        subject=first.subject,
        subject_digest=first.subject_digest,
        data=first.tables,
        data_digest=first.data_digest,
        verbs=tuple(dict.fromkeys(x.verb for x in results)),
        verdict=found[-1].verdict.value if found else "",
        causes=found[-1].cause_names if found else (),
    )


def _quantities(answers: Mapping[str, Sequence[Answer]]) -> list[ComparedQuantity]:
    """Every quantity, each by the most informative method that all have which have it."""
    ranges = {name: ranges_of(own) for name, own in answers.items()}
    points = {name: _points(name, own) for name, own in answers.items()}
    quantities = dict.fromkeys(x for by in (ranges, points) for own in by.values() for x in own)
    found = []
    for quantity in quantities:
        own = {name: x[quantity] for name, x in ranges.items() if quantity in x}
        shared = [x for x in Source if all(any(y.source is x for y in z) for z in own.values())]
        stands = []
        for name in answers:
            if quantity in ranges[name]:
                every = ranges[name][quantity]
                main = next((y for x in shared[:1] for y in every if y.source is x), every[0])
                stands.append(
                    Stand(
                        name=name,
                        estimate=main.value,
                        lower=main.low,
                        upper=main.high,
                        method=main.source.value,
                        status=main.status,
                    )
                )
            elif quantity in points[name]:
                stands.append(points[name][quantity])
        found.append(ComparedQuantity(name=quantity, stands=tuple(stands)))
    return found


def _points(name: str, answers: Sequence[Answer]) -> dict[str, Stand]:
    """Parameters and forces of the best fit, which have no interval."""
    best = min(answers, key=lambda x: (x.parameter_set is None, x.best_deviance))
    errors = {x.name for x in best.nuisances}
    fixed = () if best.question is None else best.question.fixed
    values = {x: y for x, y in (best.parameter_set or {}).items() if x not in errors}
    if isinstance(best, SimulatedLaxity):
        for trial, tensions in zip(best.protocol.trials, best.tension_N.tolist(), strict=True):
            own = zip(best.ligaments, tensions, strict=True)
            values |= {f"{ligament}{FORCE}{trial}": x for ligament, x in own if np.isfinite(x)}
    return {
        quantity: Stand(
            name=name,
            estimate=float(value),
            lower=None,
            upper=None,
            method=SIMULATED if isinstance(best, Simulation) else POINT,
            status=FIXED if quantity in fixed else NO_INTERVAL,
        )
        for quantity, value in values.items()
    }


# Laxity that a result predicts: its trials, ``(n, 5)``, and what it counts from.
Predicted = tuple[Protocol, Array, str]


def _predicted(answers: Sequence[Answer]) -> Predicted | None:
    """Laxity as the last model of the answers predicts it; None where none predicts any."""
    for answer in reversed(answers):
        curves = presenter_of(answer).curves(answer, [answer])
        if curves is not None and curves.simulated:
            data = getattr(answer, "data", None) or getattr(answer, "trials", None)
            zero = getattr(data, "zero", ABSOLUTE)
            return curves.protocol, list(curves.simulated.values())[-1], str(zero)
    return None


def _difference(first: Predicted | None, other: Predicted | None) -> tuple[Array, int]:
    """Root-mean-square difference by coordinate over trials under the same loads, how many."""
    nothing = np.full(len(COORDINATES), np.nan), 0
    if first is None or other is None or first[2] != other[2]:
        return nothing
    keys = [_trials(protocol) for protocol, *_ in (first, other)]
    pairs = [(k, keys[1][x]) for x, k in keys[0].items() if x in keys[1]]
    if not pairs:
        return nothing
    one, two = np.array(pairs).T
    apart = first[1][one] - other[1][two]
    known = np.isfinite(apart).all(axis=1)
    if not known.any():
        return nothing
    return np.sqrt(np.mean(apart[known] ** 2, axis=0)), int(known.sum())


def _trials(protocol: Protocol) -> dict[Any, int]:
    """Rows of trials by what they are, whatever they are called."""
    rows = zip(protocol.trials, protocol.flexion_deg.tolist(), protocol.loads.tolist(), strict=True)
    return {(name, angle, *loads): k for k, (name, angle, loads) in enumerate(rows)}


def _misfit(name: str, answers: Sequence[Answer]) -> ComparedMisfit:
    best = min(answers, key=lambda x: x.best_deviance)
    fits = sorted(of_type(answers, Calibration), key=lambda x: x.best_deviance)
    sizes = [fits[0].rmse.mm, fits[0].rmse.deg] if fits else [np.nan, np.nan]
    mm, deg = (float(x) if np.isfinite(x) else None for x in sizes)
    values = next((x.parameter_set for x in (best, *answers) if x.parameter_set), None)
    held = {x.name for x in best.nuisances}
    held |= set(() if best.question is None else best.question.fixed)
    evidences = [x.nested.log_evidence for x in of_type(answers, Sample) if x.nested is not None]
    return ComparedMisfit(
        name=name,
        rmse_mm=mm,
        rmse_deg=deg,
        terms=best.evidence if np.isfinite(best.best_deviance) else (),
        n_fitted=len(set(values) - held) if values is not None and best.evidence else None,
        log_evidence=evidences[-1] if evidences else None,
    )


def _why_not(data_digests: Sequence[str], questions: Sequence[Question | None]) -> str:
    """Why misfits do not compare; empty where they do."""
    if len(set(data_digests)) > 1:
        return "the data are not the same"
    if not all(data_digests):
        return "there are no data"
    first, *others = questions
    if first is None or None in others:
        return "it is not known what was asked of the data"
    words = [y for x in others if x is not None for y in first.differences(x)]
    differing = [x for x in OF_MISFIT if IN_WORDS[x] in words]
    named = [words for x, words in IN_WORDS.items() if x in differing]
    return f"the results differ in {listed(named)}" if named else ""


def _differences(
    given: Sequence[Sequence[Result]], questions: Sequence[Question | None]
) -> Iterator[Difference]:
    """Knee, data, question and options, where they are not the same in all."""
    firsts = [own[0] for own in given]
    rows: dict[str, list[str]] = {
        "knee": [f"{x.subject} ({x.subject_digest[:8]})" for x in firsts],
        "data": [
            f"{', '.join(Path(y).name for y in x.tables)} ({x.data_digest[:8]})"
            if x.data_digest
            else "none"
            for x in firsts
        ],
        "commands": [", ".join(dict.fromkeys(x.verb for x in own)) for own in given],
    }
    asked = [{} if x is None else x.words for x in questions]
    rows |= {what: [x.get(what, "not known") for x in asked] for what in IN_WORDS.values()}
    rows |= _options(given)
    for what, values in rows.items():
        if len(set(values)) > 1:
            yield Difference(what=what, values=tuple(values))


def _options(given: Sequence[Sequence[Result]]) -> dict[str, list[str]]:
    """Options of the commands that all have, as each was given them."""
    found: dict[str, list[str]] = {}
    verbs = [{x.verb: given_options(x.record) for x in own} for own in given]
    for name in verbs[0]:
        if not all(name in x for x in verbs):
            continue
        chosen = [x[name] for x in verbs]
        for flag in dict.fromkeys(y for x in chosen for y in x):
            if flag not in IN_QUESTION:
                shown = [value_words(x[flag]) if flag in x else "as usual" for x in chosen]
                found[f"{name} {flag}"] = shown
    return found


def _assumptions(answers: Mapping[str, Sequence[Answer]]) -> Iterator[str]:
    """What each result assumes, with its name where not all do."""
    taken = {name: {y for x in own for y in x.assumptions} for name, own in answers.items()}
    for sentence in dict.fromkeys(
        z for own in answers.values() for x in own for z in x.assumptions
    ):
        owners = [name for name, own in taken.items() if sentence in own]
        yield sentence if len(owners) == len(taken) else f"{listed(owners)}: {sentence}"


def compared_values(x: ComparedQuantity, names: Sequence[str]) -> list[str]:
    """What each result says of a quantity, with its unit; a dash where it says nothing."""
    said = {y.name: f"{y.words} {unit_of(x.name)}".rstrip() for y in x.stands}
    return [said.get(name, "-") for name in names]


ResultsLike = Sequence[Answer | PathLike] | Mapping[str, Answer | PathLike]


@verb
def compare(
    run: Run,
    results: Annotated[
        ResultsLike,
        argument(
            "Results folders of any commands, or folders of such folders of one knee each.",
            "DIR...",
            in_python="Answers, folders, or either by name in a dictionary.",
            typed=list[Path],
        ),
    ],
    *,
    names: Annotated[
        Sequence[str] | None,
        option(
            "Name of each folder in tables and figures, in their order. If not given: the folders' "
            "own.",
            "--name",
            in_python="A list.",
            metavar="NAME",
        ),
    ] = None,
    **_: Unpack[OutOption],
) -> Comparison:
    """Results side by side: parameters, forces, misfit, and in what the questions differ.

    The results may be of one knee, of several, of several models, or before and after an
    extension. Each folder gives its most informative method for a quantity, the same one for all
    where they share one. Misfit and evidence are compared only where the data and the noise are
    the same.

    Raises
    ------
    ValueError
        If there are fewer than two results, names do not fit them, or one folder has several
        knees.
    InputError
        If a folder holds no results.
    """
    given = _named(results, names)
    run.start_clock()
    return comparison(given)


def _named(results: ResultsLike, names: Sequence[str] | None) -> dict[str, tuple[Result, ...]]:
    """The results of each answer or folder by its name."""
    if isinstance(results, Mapping):
        names, results = names or list(results), list(results.values())
    if isinstance(results, Answer | str | os.PathLike) or len(results) < 2:
        raise ValueError("a comparison needs two results or more; give their folders or answers")
    found = [_results_of(x) for x in results]
    names = list(names or _own_names(found, results))
    if len(names) != len(found):
        raise ValueError(f"--name: {len(names)} names for {len(found)} results; give one for each")
    if repeated := [x for x in names if names.count(x) > 1]:
        raise ValueError(f"--name {repeated[0]} is given twice; give each result its own name")
    return dict(zip(names, found, strict=True))


def _results_of(given: Answer | PathLike) -> tuple[Result, ...]:
    """The results of one answer, or of a folder with one knee."""
    if isinstance(given, Answer):
        return (result_of(given),)
    found = tuple(x for x in found_results(Path(given)) if not isinstance(x.answer, Comparison))
    if len({x.subject_digest for x in found}) != 1 or len({x.data_digest for x in found}) > 1:
        raise ValueError(
            f"{given} holds results of several knees or tables; give their folders one by one"
        )
    return found


def _own_names(found: Sequence[Sequence[Result]], given: Sequence[Any]) -> list[str]:
    """Names of the folders; numbers tell apart those of one name."""
    plain = [
        own[0].verb if isinstance(x, Answer) else Path(x).resolve().name
        for own, x in zip(found, given, strict=True)
    ]
    return [
        x if plain.count(x) == 1 else f"{x} {plain[: k + 1].count(x)}" for k, x in enumerate(plain)
    ]
