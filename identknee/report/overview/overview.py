"""The head of a report: one verdict, one table, the fits, the next tests."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, unique

from identknee.diagnosis.verdict import Verdict
from identknee.laxity.protocol import FLEXION, LOADS
from identknee.laxity.table import Laxity
from identknee.laxity.trial_words import trial_words
from identknee.model.effects.facts import cause_label
from identknee.report.overview.agreement import Agreement, agreement, reasons
from identknee.report.overview.ranges import ranges_of
from identknee.report.overview.searches import disagreement, searches_sentences
from identknee.report.presenter import of_type, presenter_of
from identknee.report.range import NOT_CONVERGED, Range, Source
from identknee.runs.words import (
    amount,
    capital,
    interval,
    label_without_unit,
    listed,
    parameter_words,
    unit_of,
)
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis

MOST_NAMED = 3
KNOWN = ("known", "probable", "known locally")
FORCE = ".tension_N@"


@unique
class Tone(Enum):
    """How a verdict is meant; the value is its class on the page."""

    GOOD = "good"
    OPEN = "open"
    WRONG = "wrong"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A parameter or force in the table.

    Attributes
    ----------
    name
        Its name in results.
    label
        The same in words.
    estimate, limits
        With their unit.
    status
        What is known, in a word or three.
    agreement
        Whether methods agree, and if not how they differ.
    found
        The same in numbers.
    """

    name: str
    label: str
    estimate: str
    limits: str
    status: str
    agreement: str
    found: Agreement


@dataclass(frozen=True, slots=True, kw_only=True)
class Overview:
    """What all results of one data set say together.

    Attributes
    ----------
    verdict
        One sentence or two; empty where no result says anything of parameters or model.
    tone
        How it is meant.
    rows
        Parameters, then forces.
    reasons
        Why methods differ, in one line; empty where they do not.
    searches
        Sentences of fits and searches.
    next_tests
        Tests to do, each with what it would bring.
    """

    verdict: str
    tone: Tone
    rows: tuple[Row, ...]
    reasons: str
    searches: tuple[str, ...]
    next_tests: tuple[str, ...]


def overview(answers: Sequence[Answer]) -> Overview:
    """What these answers, all of one data set, say together."""
    trials = _trials(answers)
    rows = tuple(_row(*x, trials) for x in _shown(ranges_of(answers)))
    diagnosis = next(reversed(of_type(answers, Diagnosis)), None)
    differ = disagreement(answers)
    sentence, tone = _verdict([x for x in rows if "@" not in x.name], diagnosis, differ)
    shown = [presenter_of(x).headline(x) for x in answers]
    return Overview(
        verdict=" ".join(x for x in (*shown, sentence) if x),
        tone=tone,
        rows=rows,
        reasons=reasons(x.found for x in rows),
        searches=searches_sentences(answers),
        next_tests=tuple(said for x in answers for said in presenter_of(x).next_tests(x)),
    )


def _trials(answers: Sequence[Answer]) -> dict[str, str]:
    """Loads and flexion of each trial in words, by its name."""
    found: dict[str, str] = {}
    for answer in answers:
        data = getattr(answer, "data", None)
        if isinstance(data, Laxity):
            protocol = data.protocol
            for name, flexion, loads in zip(
                protocol.trials, protocol.flexion_deg, protocol.loads, strict=True
            ):
                values = {FLEXION: float(flexion)} | dict(zip(LOADS, loads.tolist(), strict=True))
                found[name] = trial_words(values)
    return found


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
    return Row(
        name=name,
        label=f"{owner} force, {trials.get(trial, trial)}" if trial else label_without_unit(name),
        estimate=amount(main.value, unit),
        limits="slack" if is_slack else interval((main.low, main.high), unit),
        status=main.status,
        agreement=found.sentence(unit),
        found=found,
    )


def _verdict(rows: Sequence[Row], diagnosis: Diagnosis | None, differ: str) -> tuple[str, Tone]:
    """One sentence or two, and the worst of what they say."""
    model, tone = _model(diagnosis)
    unknown = [x for x in rows if x.status not in KNOWN]
    contradicted = [x.name for x in rows if x.found.is_contradicted]
    moved = [x.name for x in rows if x.found.is_moved_by_cause]
    said = [x for x in (model, _known(rows, unknown, diagnosis)) if x]
    doubts = [f"methods contradict one another on {_named(contradicted)}"] * bool(contradicted)
    doubts += [f"with the cause {_named(moved)} lies outside its set"] * bool(moved)
    doubts += ["fits from different starts end at different parameters"] * bool(differ)
    if tone is Tone.GOOD and (unknown or doubts):
        tone = Tone.OPEN
    if doubts:
        said.append(f"However, {listed(doubts)}." if said else f"{capital(listed(doubts))}.")
    return " ".join(said), tone


def _model(diagnosis: Diagnosis | None) -> tuple[str, Tone]:
    if diagnosis is None:
        return "", Tone.GOOD
    if diagnosis.verdict is Verdict.ADEQUATE:
        return "The model explains the data.", Tone.GOOD
    if diagnosis.verdict is Verdict.NOT_TESTABLE:
        return diagnosis.verdict.sentence, Tone.OPEN
    if diagnosis.verdict is Verdict.NAMED:
        names = listed(map(cause_label, diagnosis.cause_names))
        said = f"The model lacks something that the data show. Only one known cause fits: {names}."
        return said, Tone.WRONG
    return diagnosis.sentence, Tone.WRONG


def _known(rows: Sequence[Row], unknown: Sequence[Row], diagnosis: Diagnosis | None) -> str:
    """How many parameters are known, and on what proviso."""
    if not rows:
        return ""
    n, proviso = len(rows), ""
    if diagnosis is None:
        proviso = ", if the model is right (not tested)"
    elif diagnosis.verdict is Verdict.NOT_TESTABLE:
        proviso = ", if the model is right"
    elif diagnosis.verdict is not Verdict.ADEQUATE:
        return "The sets below hold for the model as it stands."
    if not unknown:
        which = {1: "The one parameter is", 2: "Both parameters are"}.get(
            n, f"All {n} parameters are"
        )
        return f"{which} known within limits{proviso}."
    words = {x.status for x in unknown}
    names, n_known = _named([x.name for x in unknown]), n - len(unknown)
    share = f"{n_known or 'None'} of {n} parameters {'is' if n_known < 2 else 'are'}"
    said = f"{share} known within limits{proviso}"
    if words == {NOT_CONVERGED}:
        return f"{said}; the posterior of {names} has not converged yet."
    state = words.pop() if len(words) == 1 else "not"
    return f"{said}; {names} {'is' if len(unknown) == 1 else 'are'} {state}."


def _named(names: Sequence[str]) -> str:
    shown = [parameter_words(x) for x in names[:MOST_NAMED]]
    more = len(names) - len(shown)
    return listed([*shown, *([f"{more} more"] if more else [])])
