"""An answer in a notebook, with table and figure."""

from base64 import b64encode
from pathlib import Path

from matplotlib.figure import Figure

from identknee.report.drawing import Drawing
from identknee.report.figures import png, show_figures
from identknee.report.page.laxity_part import laxity_drawings
from identknee.report.page.markup import bullets, element, paragraph, table_html
from identknee.report.page.results import Findings, Result, drawings
from identknee.report.presenter import main_statements, statements_of
from identknee.runs.findings import finding_lines
from identknee.runs.record import record
from identknee.runs.schema import summary_of
from identknee.verbs.answer import Answer
from identknee.verbs.registry import verbs_with_answer

# Bytes of a picture and of a whole answer in a notebook, which keeps every one of them.
MOST_BYTES = 130_000
SHARPNESS = (110, 90, 70, 50, 35)
STYLE = "max-width: 60em; overflow-x: auto"


def result_of(answer: Answer, folder: Path | None = None) -> Result:
    """The answer as the report takes it, as if it had been read from `folder`."""
    made = answer.record or record(_verb_of(answer), {}, {}).finish()
    summary = {**summary_of(answer), "record": made.to_dict()}
    return Result(folder=folder or Path(made.verb), summary=summary, answer=answer)


def _verb_of(answer: Answer) -> str:
    return next(verbs_with_answer(type(answer).__name__)).name


def answer_html(answer: Answer) -> str:
    """The answer for a notebook: its main sentences, a table and one figure, at most 200 kB."""
    main = main_statements(answer)
    sentences = "".join(paragraph(x.sentence) for x in main)
    tables = [x for said in (*main, *statements_of(answer)) for x in said.tables]
    table = "".join(table_html(x.first_rows()) for x in tables[:1])
    remarks = bullets(paragraph(x) for x in finding_lines(answer.findings))
    drawn = _drawings(answer)
    picture = _picture(drawn[0]) if drawn else ""
    return element("div", sentences + table + picture + remarks, style=STYLE)


def answer_figure(answer: Answer, name: str | None = None) -> Figure:
    """A figure of the answer; see `Answer.plot`."""
    known = {x.name: x for x in _drawings(answer)}
    if not known:
        raise ValueError(f"{type(answer).__name__} has no figure; print it to see its table")
    if name is not None and name not in known:
        raise ValueError(f"there is no figure {name!r}; choose from {', '.join(known)}")
    show_figures()
    return known[name or next(iter(known))].figure


def _drawings(answer: Answer) -> tuple[Drawing, ...]:
    result = result_of(answer)
    findings = Findings(subject=result.subject, results=(result,))
    return (*drawings(result), *(x for _, x in laxity_drawings(findings)))


def _picture(drawing: Drawing) -> str:
    source = f"data:image/png;base64,{b64encode(_small_png(drawing.figure)).decode('ascii')}"
    image = f'<img src="{source}" style="max-width: 100%">'
    return element("figure", image + element("figcaption", drawing.caption), style="margin: 0")


def _small_png(figure: Figure) -> bytes:
    """As sharp a picture as fits."""
    for dots in SHARPNESS:
        if len(content := png(figure, dots)) <= MOST_BYTES:
            break
    return content
