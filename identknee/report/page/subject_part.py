"""All there is to say of one subject: the answer, then its parts, then how it was computed."""

import json
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from identknee.diagnosis.verdict import Verdict
from identknee.report.answers.fit import nuisance_tables, parameters_at_bounds
from identknee.report.drawing import Drawing
from identknee.report.overview import (
    KNOWN,
    Overview,
    Row,
    Tone,
    fits_by_start,
    has_better_fit,
    overview,
)
from identknee.report.page.laxity_part import laxity_drawings
from identknee.report.page.markup import (
    bullets,
    collapsible,
    element,
    escaped,
    figure_html,
    paragraph,
    scrolling,
    section,
    table_html,
)
from identknee.report.page.results import Findings, Result, drawings
from identknee.report.page.svg import inline_svg
from identknee.report.page.viewer import KneeScene, viewer_html
from identknee.report.presenter import of_type, presenter_of, statements_of
from identknee.report.statement import Question, Statement, assumption_sentences
from identknee.report.tables import Column, Table
from identknee.runs.findings import About, Finding, Severity, by_severity
from identknee.runs.progress import progress
from identknee.runs.record import Outcome
from identknee.runs.words import capitalised, label, listed
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.fit import Calibration
from identknee.verbs.registry import verbs

HEADS = ("quantity", "estimate", "95 % set", "status", "methods")
MOST_OPEN = 3
TITLE = "Parameters and forces"


def overview_html(found: Overview, cautions: Sequence[Finding], level: int) -> str:
    """Verdict, warnings, table, fits, next tests; what there is nothing of is left out.

    Parameters
    ----------
    found
        From `identknee.report.overview.overview`.
    cautions
        What results say against themselves, errors first. All errors stand in the open, and as
        many warnings as leave the table on the first screens.
    level
        Level of the heading above.
    """
    verdict = paragraph(found.verdict, class_=f"verdict {found.tone.value}")
    searches = paragraph(" ".join(found.searches))
    tests = element(f"h{level + 1}", "Next tests") + bullets(map(escaped, found.next_tests))
    return "".join(
        (
            verdict if found.verdict else "",
            _cautions(cautions) if cautions else "",
            _table(found.rows) if found.rows else "",
            paragraph(found.reasons, class_="note") if found.reasons else "",
            element(f"h{level + 1}", "Fits") + searches if found.searches else "",
            tests if found.next_tests else "",
        )
    )


def _cautions(found: Sequence[Finding]) -> str:
    n = max(MOST_OPEN, sum(x.severity is Severity.ERROR for x in found))
    # One more takes no more room than the words that would hide it.
    n = len(found) if len(found) == n + 1 else n
    sentences = [x.line for x in found]
    rest = sentences[n:]
    folded = collapsible(f"{len(rest)} more warnings", "".join(map(paragraph, rest)))
    return element("div", "".join(map(paragraph, sentences[:n])) + folded, class_="cautions")


def _table(rows: Iterable[Row]) -> str:
    heads = "".join(element("th", x, scope="col") for x in HEADS)
    body = "".join(map(_row, rows))
    whole = element("caption", TITLE, class_="unseen")
    whole += element("thead", element("tr", heads)) + element("tbody", body)
    return scrolling(element("table", whole, class_="overview"), TITLE)


def _row(row: Row) -> str:
    name = element("th", escaped(row.label), scope="row")
    differs = "differs" if row.found.differing else "agrees"
    cells = (
        (row.estimate, "estimate"),
        (row.limits, "limits"),
        (row.status, "status"),
        (row.agreement, differs),
    )
    return element("tr", name + "".join(element("td", escaped(x), class_=y) for x, y in cells))


def computed_html(results: Sequence[Result]) -> str:
    """A table of all results, and their records."""
    rows = tuple(
        (
            x.verb,
            x.folder.name,
            short_path(x.data) or "-",
            str(x.record["started"])[:16].replace("T", " "),
            float(x.record["seconds"]),
            "-" if x.record["seed"] is None else str(x.record["seed"]),
        )
        for x in results
    )
    columns = (
        Column(name="verb"),
        Column(name="folder"),
        Column(name="data"),
        Column(name="begun (UTC)"),
        Column(name="time", unit="s", decimals=1),
        Column(name="seed"),
    )
    table = table_html(Table(title="Results on this page", columns=columns, rows=rows))
    records = {f"{x.verb}, {x.folder}": x.record for x in results}
    text = json.dumps(records, indent=2, ensure_ascii=False)
    written = element("pre", escape(text), tabindex="0", aria_label="Records of all results")
    folded = collapsible("Settings, digests of inputs and versions", written)
    return collapsible(f"{len(results)} result{'' if len(results) == 1 else 's'}", table) + folded


def further_html(findings: Findings) -> str:
    """A command for each question that no result answers; empty where all are answered."""
    done = {x.verb for x in findings.results}
    if "demo" in done:
        done.add("profile")
    data = next((x.data for x in reversed(findings.results) if x.data), None)
    if data is None:
        made = findings.of("demo", "simulate")
        data = str(made[0].folder / "laxity.csv") if made else "DATA.csv"
    noise = "" if "demo" not in done else " --noise 0.5mm,0.5deg"
    return bullets(
        f"{escape(verb.suggestion)} "
        + element(
            "code",
            escape(f"identknee {verb.name} {shlex.quote(findings.subject)} {shlex.quote(data)}")
            + (noise if verb.name not in ("fit", "sensitivity") else ""),
        )
        for verb in verbs()
        if verb.suggestion and verb.name not in done
    )


def short_path(path: str) -> str:
    """The last two parts of a path.

    Examples
    --------
    >>> short_path("/home/knee/laxity.csv")
    'knee/laxity.csv'
    """
    return "/".join(path.replace("\\", "/").rstrip("/").split("/")[-2:])


def fits_statement(answers: Sequence[Answer]) -> Statement:
    """Where several fits ended, how well each fits, and what it says of geometry and tests.

    Parameters
    ----------
    answers
        Fits of one table, at least two.
    """
    fits = fits_by_start(answers)
    best = min(fits.values(), key=lambda x: x.objective)
    is_uncertain = bool(best.nuisances)
    return Statement(
        question=Question.SEARCH,
        sentence=f"The tables set the {len(fits)} fits side by side."
        + (" The stated errors are those of the fit with the lowest misfit." * is_uncertain),
        tables=(_ends(fits), _parameters(fits), *nuisance_tables(best)),
        is_answer=True,
    )


def _ends(fits: dict[str, Calibration]) -> Table:
    return Table(
        title="How each fit ended",
        columns=(
            Column(name="start"),
            Column(name="RMSE", unit="mm", decimals=None),
            Column(name="RMSE", unit="deg", decimals=None),
            Column(name="simulations", decimals=0),
            Column(name="end"),
        ),
        rows=tuple(
            (name, x.rmse.mm, x.rmse.deg, x.n_simulations, x.outcome.sentence)
            for name, x in fits.items()
        ),
    )


def _parameters(fits: dict[str, Calibration]) -> Table:
    names = dict.fromkeys(
        name
        for x in fits.values()
        for name in x.parameter_names
        if name not in {y.name for y in x.nuisances}
    )
    values = {
        start: dict(zip(x.parameter_names, x.search.theta.tolist(), strict=True))
        for start, x in fits.items()
    }
    notes = {start: parameters_at_bounds(x) for start, x in fits.items()}
    return Table(
        title="Fitted parameters by start",
        columns=(
            Column(name="parameter"),
            *(Column(name=f"from {start}", decimals=None) for start in fits),
            Column(name="remark"),
        ),
        rows=tuple(
            (
                label(name),
                *(values[start].get(name, np.nan) for start in fits),
                _remark([start for start in fits if name in notes[start]], len(fits)),
            )
            for name in names
        ),
    )


def _remark(starts: Sequence[str], n: int) -> str:
    if not starts:
        return ""
    return "at its bound" if len(starts) == n else f"at its bound from {', '.join(starts)}"


# Findings about these stand in the part on searches, all others in that on the model.
OF_SEARCH = (About.STARTS, About.TRIALS, About.EARLIER)


def warnings(result: Result) -> Iterator[Statement]:
    """The findings of a result; all but infos lead the page."""
    for x in result.answer.findings:
        yield Statement(
            question=Question.SEARCH if x.kind.about in OF_SEARCH else Question.WRONG,
            sentence=x.line,
            warning=None if x.severity is Severity.INFO else x,
        )


def merge_duplicate_warnings(found: Iterable[tuple[Finding, str]]) -> list[Finding]:
    """Warnings without those that another result gives too, the gravest first.

    Parameters
    ----------
    found
        Each with the result that has it. Where two results find the same, if with other numbers,
        the one with more values stays, else the first; where each has a value that the other lacks
        both stay. Findings whose kinds share a lead become one.
    """
    kept: list[tuple[Finding, str]] = []
    for finding, source in found:
        names = finding.values.keys()
        same = [
            place
            for place, (x, of) in enumerate(kept)
            if x.identity == finding.identity and of != source
            if names <= x.values.keys() or x.values.keys() <= names
        ]
        if not same:
            kept.append((finding, source))
        elif len(names) > len(kept[same[0]][0].values):
            kept[same[0]] = finding, source
    by_lead: dict[object, list[Finding]] = {}
    for place, (finding, _) in enumerate(kept):
        lead = (finding.severity, finding.kind.lead) if finding.kind.lead else place
        by_lead.setdefault(lead, []).append(finding)
    return by_severity(_as_one(x) for x in by_lead.values())


def _as_one(findings: list[Finding]) -> Finding:
    """Findings of one lead as one, their details one after the other."""
    first, *others = findings
    if not others:
        return first
    return replace(first, sentence=first.kind.sentence(*(x.detail for x in findings)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SourcedStatement:
    """A finding with where it is from."""

    finding: Statement
    source: str


def sourced_statements(results: Sequence[Result]) -> list[SourcedStatement]:
    """What results say: fits of one table side by side, what several take for granted once."""
    fits = of_type([x.answer for x in results], Calibration)
    together = _together(results)
    said = []
    for result in results:
        own = [*_warnings(result, fits), *statements_of(result.answer)]
        if result in together:
            # What leads each of these stands in the table of all.
            own = [x for x in own if not x.is_answer]
            if result is together[0]:
                own.insert(0, fits_statement([x.answer for x in together]))
        said += [SourcedStatement(finding=x, source=_source(result)) for x in own]
    return [*said, *_assumptions(results)]


def _together(results: Sequence[Result]) -> list[Result]:
    """The fits of the table that most were made to, where there are several."""
    found = [
        x
        for x in results
        if any(y.outcome is not Outcome.START_FAILED for y in of_type([x.answer], Calibration))
    ]
    counts = Counter(x.data_digest for x in found)
    main, n = counts.most_common(1)[0] if counts else ("", 0)
    return [x for x in found if x.data_digest == main] if n > 1 else []


def _warnings(result: Result, fits: Sequence[Calibration]) -> Iterator[Statement]:
    """What a result says against itself; of a fit that another beats, none leads the page."""
    is_past = any(has_better_fit(x, fits) for x in of_type([result.answer], Calibration))
    for x in warnings(result):
        yield replace(x, question=Question.SEARCH, warning=None) if is_past else x


def _assumptions(results: Sequence[Result]) -> Iterator[SourcedStatement]:
    """The assumptions of results, with their source if not shared by all."""
    taken = {_source(x): assumption_sentences(x.answer) for x in results}
    sources = [x for x in taken if taken[x]]
    by_sources: dict[tuple[str, ...], list[str]] = {}
    for sentence in dict.fromkeys(x for source in sources for x in taken[source]):
        own = tuple(x for x in sources if sentence in taken[x])
        by_sources.setdefault(own, []).append(sentence)
    for own, sentences in by_sources.items():
        told = " ".join(sentences)
        if len(own) < len(sources):
            told = f"{capitalised(listed(own))}: {told}"
        yield SourcedStatement(
            finding=Statement(question=Question.KNOWN, sentence=told), source=listed(own)
        )


def _source(result: Result) -> str:
    return f"{result.verb} of {short_path(result.data)}" if result.data else result.verb


RIGHT = "What was tested of the model"
VERDICT_HEADINGS = {
    Verdict.ADEQUATE: RIGHT,
    Verdict.NOT_TESTABLE: "Why the model could not be tested",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Figure:
    """A figure as HTML, and whether it is among the first that a reader looks at."""

    html: str
    is_first: bool


def subject_html(findings: Findings, number: int, level: int, scene: KneeScene | None) -> str:
    """The answer, the parts behind it with links to them, and how it was computed.

    Parameters
    ----------
    findings
        All results of one subject.
    number
        Number of the subject on the page, for identities.
    level
        Level of its headings.
    scene
        Its knee to turn; None for none.
    """
    merged = findings.merged
    main = overview([x.answer for x in findings.of_main_data])
    said = sourced_statements(merged.results)
    cautions = merge_duplicate_warnings(
        (x.finding.warning, x.source) for x in said if x.finding.warning is not None
    )
    figures = _figures(merged, number)
    parts = [("answer", "The answer", overview_html(main, cautions, level))]
    for question in Question:
        own = [x for x in said if x.finding.question is question and x.finding.warning is None]
        content = _part(own, figures.get(question, []))
        parts.append((question.value, _heading(question, main, merged), content))
        if question is Question.NEXT and scene is not None:
            parts.append(("knee", "The knee in three dimensions", viewer_html(scene)))
    parts.append(("computed", "How this was computed", computed_html(findings.results)))
    parts.append(("further", "What further verbs would answer", further_html(findings)))
    shown = [(f"{key}-{number}", heading, content) for key, heading, content in parts if content]
    links = bullets(
        element("a", escape(heading), href=f"#{identity}") for identity, heading, _ in shown[1:]
    )
    contents = element("nav", links, aria_label=f"Contents, subject {findings.title}")
    first, *others = [section(*x, level=level) for x in shown]
    return first + contents + "".join(others)


def _heading(question: Question, main: Overview, findings: Findings) -> str:
    """The heading of a part, as the verdict has it."""
    if question is Question.KNOWN and main.tone is Tone.WRONG:
        return "What would be known if the model were right"
    if question is Question.KNOWN and main.rows and all(x.status in KNOWN for x in main.rows):
        return "What is known"
    if question is Question.WRONG:
        diagnoses = of_type((x.answer for x in findings.results), Diagnosis)
        if not diagnoses:
            return RIGHT
        return VERDICT_HEADINGS.get(diagnoses[-1].verdict, question.heading)
    return question.heading


def _part(said: Sequence[SourcedStatement], figures: Sequence[_Figure]) -> str:
    """What matters most in the open, the rest one click away."""
    leading = [x for x in said if x.finding.is_answer] or said[:1]
    rest = [x for x in said if x not in leading]
    first = "".join(x.html for x in figures if x.is_first)
    more = "".join(x.html for x in figures if not x.is_first)
    return (
        bullets(map(_item, leading))
        + collapsible(f"More in words ({len(rest)})", bullets(map(_item, rest)))
        + first
        + collapsible("More figures", more)
    )


def _item(said: SourcedStatement) -> str:
    """A sentence, and its numbers with their source one click away."""
    finding = said.finding
    tables = "".join(map(table_html, finding.tables))
    return paragraph(finding.sentence) + collapsible(
        f"The numbers behind it ({said.source})", tables
    )


def _figures(findings: Findings, number: int) -> Mapping[Question, list[_Figure]]:
    """The figures by the question they belong to."""
    placed: dict[Question, list[_Figure]] = {}
    shown = progress(findings.results, description="drawing the report")
    for k, result in enumerate(shown):
        shows = presenter_of(result.answer)
        for i, drawing in enumerate(drawings(result)):
            question = shows.questions.get(drawing.name, shows.question)
            html = _figure(drawing, f"s{number}r{k}-{drawing.name}")
            is_first = i == 0 and not shows.is_folded
            placed.setdefault(question, []).append(_Figure(html=html, is_first=is_first))
    for k, (_, drawing) in enumerate(laxity_drawings(findings)):
        html = _figure(drawing, f"s{number}l{k}-{drawing.name}")
        is_first = drawing.name != "laxity-all"
        placed.setdefault(Question.LAXITY, []).append(_Figure(html=html, is_first=is_first))
    return placed


def _figure(drawing: Drawing, identity: str) -> str:
    return figure_html(inline_svg(drawing.figure, identity, drawing.description), drawing.caption)
