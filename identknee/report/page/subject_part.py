"""All there is to say of one subject: the answer, then its parts, then how it was computed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from identknee.diagnosis.verdict import Verdict
from identknee.report.drawing import Drawing
from identknee.report.overview.overview import KNOWN, Overview, Tone, overview
from identknee.report.page.computed_part import computed_html, further_html
from identknee.report.page.knee_scene import KneeScene
from identknee.report.page.laxity_part import laxity_drawings
from identknee.report.page.markup import (
    bullets,
    disclosed,
    element,
    figure_html,
    paragraph,
    section,
    table_html,
)
from identknee.report.page.overview_part import overview_html
from identknee.report.page.results import Findings, drawings
from identknee.report.page.said import Said, all_said
from identknee.report.page.svg import inline_svg
from identknee.report.page.viewer import viewer_html
from identknee.report.page.warnings import merge_duplicate_warnings
from identknee.report.presenter import of_type, presenter_of
from identknee.report.statement import Question
from identknee.runs.progress import progress
from identknee.verbs.diagnosis import Diagnosis

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
    said = all_said(merged.results)
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


def _part(said: Sequence[Said], figures: Sequence[_Figure]) -> str:
    """What matters most in the open, the rest one click away."""
    leading = [x for x in said if x.finding.is_answer] or said[:1]
    rest = [x for x in said if x not in leading]
    first = "".join(x.html for x in figures if x.is_first)
    more = "".join(x.html for x in figures if not x.is_first)
    return (
        bullets(map(_item, leading))
        + disclosed(f"More in words ({len(rest)})", bullets(map(_item, rest)))
        + first
        + disclosed("More figures", more)
    )


def _item(said: Said) -> str:
    """A sentence, and its numbers with their source one click away."""
    finding = said.finding
    tables = "".join(map(table_html, finding.tables))
    return paragraph(finding.sentence) + disclosed(f"The numbers behind it ({said.source})", tables)


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
