"""The page: one HTML file with the answer first and everything it stands on behind it."""

import json
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

from identknee.report.answers.statements import statements_of
from identknee.report.page.drawing import Drawing
from identknee.report.page.drawings import drawings
from identknee.report.page.knee_scene import KneeScene
from identknee.report.page.laxity_part import laxity_drawings
from identknee.report.page.markup import (
    bullets,
    disclosed,
    element,
    figure_html,
    paragraph,
    picture_html,
    section,
    table_html,
)
from identknee.report.page.results import Findings, Result, by_subject
from identknee.report.page.svg import inline_svg
from identknee.report.page.viewer import viewer_html
from identknee.report.page.warnings import warnings
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.record import versions

TAGS = {
    Question.KNOWN: "Parameters",
    Question.WRONG: "Model",
    Question.NEXT: "Next test",
    Question.LAXITY: "Laxity",
    Question.SEARCH: "Fit",
}
PLACES = dict.fromkeys(("diagnose", "isolability"), Question.WRONG)
PLACES |= {"design": Question.NEXT, "sweep": Question.SEARCH}
PLACES |= {"sensitivity": Question.LAXITY, "demo-starts": Question.SEARCH}
# Left by a diagnosis as pictures only, as they need all of it.
PICTURES = {
    "missing_wrench.png": "What else would have to act on the tibia, seen from above: arrows are "
    "forces, arcs moments; grey is what noise alone may ask for.",
}
# Nothing may be fetched: the page is all there is.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:"
)
FURTHER = {
    "fit": "Which parameters reproduce this laxity?",
    "sweep": "Do other starts end elsewhere?",
    "profile": "Which parameters are known, within what limits, and which are open?",
    "sample": "How probable is each value, and each ligament force?",
    "information": "Which combinations of parameters do the data know?",
    "equivalents": "How different may two knees be that this measurement cannot tell apart?",
    "sensitivity": "Which parameter moves which laxity?",
    "diagnose": "What does the model get wrong, and why?",
    "design": "Which trials would close the gap?",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Said:
    """A finding with where it is from."""

    finding: Statement
    source: str


def report_html(results: Sequence[Result], scenes: Mapping[str, KneeScene] | None = None) -> str:
    """The whole page; it needs nothing beside it and fetches nothing.

    Parameters
    ----------
    results
        As `found_results` gives them.
    scenes
        By the digest of the subject, the knee to turn in three dimensions.
    """
    shown = scenes or {}
    subjects = by_subject(results)
    level = 2 if len(subjects) == 1 else 3
    parts = [
        _subject(x, k, level, shown.get(x.results[0].subject_digest))
        for k, x in enumerate(subjects, 1)
    ]
    main = "".join(
        content if level == 2 else section(f"subject-{k}", f"Subject {x.subject}", content)
        for k, (x, content) in enumerate(zip(subjects, parts, strict=True), 1)
    )
    names = ", ".join(x.subject for x in subjects)
    title = f"Knee report: {names}"
    head = element("h1", escape(title)) + paragraph(_lead(results), class_="lead")
    body = (
        '<a class="skip" href="#main">Skip to the answer</a>'
        + element("header", head)
        + element("main", main, id="main")
        + element("footer", paragraph(f"{_maker()}. This page works offline."))
    )
    return document(title, body, has_viewer=bool(shown))


def report_drawings(results: Sequence[Result]) -> Iterator[tuple[str, Drawing]]:
    """Every figure of the page with the name of its file."""
    for findings in by_subject(results):
        pairs = [(x, y) for x in findings.results for y in drawings(x)]
        for result, drawing in [*pairs, *laxity_drawings(findings)]:
            folder = result.folder.name
            beside = "" if folder == result.verb else f"{folder}-"
            yield f"{beside}{result.verb}-{drawing.name}", drawing


def document(title: str, body: str, *, has_viewer: bool) -> str:
    """A page with its style and code; with a viewer also the library that draws it."""
    here = files("identknee.report.page")
    style = (here / "style.css").read_text(encoding="utf-8")
    code = (here / "page.js").read_text(encoding="utf-8")
    library = ""
    if has_viewer:
        # Loaded where it is needed: it is large.
        from plotly.offline import get_plotlyjs

        library = element("script", get_plotlyjs().replace("</script", "<\\/script"))
    head = (
        '<meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<link rel="icon" href="data:,">'
        f"{element('title', escape(title))}{element('style', style)}{library}"
    )
    return (
        f'<!doctype html>\n<html lang="en">{element("head", head)}'
        f"{element('body', body + element('script', code))}</html>\n"
    )


def _maker() -> str:
    return f"Made by identknee {versions().get('identknee', '')}".rstrip()


def _lead(results: Sequence[Result]) -> str:
    verbs = ", ".join(dict.fromkeys(x.verb for x in results))
    days = sorted({str(x.record["started"])[:10] for x in results})
    when = days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"
    return f"From {verbs}, computed {when}. Every sentence has its numbers behind it."


def _subject(findings: Findings, number: int, level: int, scene: KneeScene | None) -> str:
    said = [
        _Said(finding=x, source=_source(result))
        for result in findings.results
        for x in (*warnings(result), *_statements(result))
    ]
    figures = _figures(findings, number)
    parts = [("answer", "The answer", _answer(said))]
    for question in Question:
        rest = bullets(_item(x) for x in said if x.finding.question is question and not _leads(x))
        content = rest + "".join(figures.get(question, []))
        parts.append((question.value, question.heading, content))
        if question is Question.NEXT and scene is not None:
            parts.append(("knee", "The knee in three dimensions", viewer_html(scene)))
    parts.append(("computed", "How this was computed", _computed(findings.results)))
    parts.append(("further", "What further verbs would answer", _further(findings)))
    shown = [(f"{key}-{number}", heading, content) for key, heading, content in parts if content]
    links = bullets(
        element("a", escape(heading), href=f"#{identity}") for identity, heading, _ in shown[1:]
    )
    contents = element("nav", links, aria_label=f"Contents, subject {findings.subject}")
    first, *others = [section(*x, level=level) for x in shown]
    return first + contents + "".join(others)


def _statements(result: Result) -> Iterable[Statement]:
    taken = result.answer.assumptions
    assumed = [Statement(question=Question.KNOWN, sentence=" ".join(taken))] if taken else []
    return [*statements_of(result.answer), *assumed]


def _leads(said: _Said) -> bool:
    return said.finding.is_answer


def _answer(said: Iterable[_Said]) -> str:
    leading = sorted(
        (x for x in said if _leads(x)), key=lambda x: list(Question).index(x.finding.question)
    )
    rows: list[str] = []
    before: Question | None = None
    for x in leading:
        question = x.finding.question
        tag = element("p", escape(TAGS[question]), class_="tag") if question != before else ""
        rows.append(element("li", tag + _item(x), class_=f"on-{question.value}"))
        before = question
    return element("ul", "".join(rows), class_="answers") if rows else ""


def _item(said: _Said) -> str:
    """A sentence, and its numbers with their source one click away."""
    finding = said.finding
    tables = "".join(map(table_html, finding.tables))
    return paragraph(finding.sentence) + disclosed(f"The numbers behind it ({said.source})", tables)


def _source(result: Result) -> str:
    return f"{result.verb} of {_short(result.data)}" if result.data else result.verb


def _short(path: str) -> str:
    """The last two parts of a path."""
    return "/".join(path.replace("\\", "/").rstrip("/").split("/")[-2:])


def _figures(findings: Findings, number: int) -> dict[Question, list[str]]:
    """The figures as HTML by the question they belong to; details stay folded."""
    placed: dict[Question, list[str]] = {}
    for k, result in enumerate(findings.results):
        for name, caption in PICTURES.items():
            if result.verb == "diagnose" and (picture := result.folder / name).is_file():
                html = picture_html(picture.read_bytes(), caption)
                placed.setdefault(Question.WRONG, []).append(html)
        for drawing in drawings(result):
            identity = f"s{number}r{k}-{drawing.name}"
            key = f"{result.verb}-{drawing.name}"
            question = PLACES.get(key) or PLACES.get(result.verb, Question.KNOWN)
            placed.setdefault(question, []).append(_figure(drawing, identity))
    for k, (_, drawing) in enumerate(laxity_drawings(findings)):
        html = _figure(drawing, f"s{number}l{k}-{drawing.name}")
        if drawing.name == "laxity-all":
            html = disclosed("All coordinates along all loads", html)
        placed.setdefault(Question.LAXITY, []).append(html)
    return placed


def _figure(drawing: Drawing, identity: str) -> str:
    return figure_html(inline_svg(drawing.figure, identity, drawing.description), drawing.caption)


def _computed(results: Sequence[Result]) -> str:
    rows = tuple(
        (
            x.verb,
            x.folder.name,
            _short(x.data) or "-",
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
    return table + disclosed("Settings, digests of inputs and versions", written)


def _further(findings: Findings) -> str:
    done = {x.verb for x in findings.results}
    if "demo" in done:
        done.add("profile")
    data = next((x.data for x in reversed(findings.results) if x.data), None)
    if data is None:
        made = findings.of("demo", "simulate")
        data = str(made[0].folder / "laxity.csv") if made else "DATA.csv"
    noise = "" if "demo" not in done else " --noise 0.5mm,0.5deg"
    return bullets(
        f"{escape(question)} "
        + element(
            "code",
            escape(f"identknee {verb} {shlex.quote(findings.subject)} {shlex.quote(data)}")
            + (noise if verb not in ("fit", "sensitivity") else ""),
        )
        for verb, question in FURTHER.items()
        if verb not in done
    )
