"""An answer where it is computed: as text in a terminal, with table and figure in a notebook."""

import textwrap
from base64 import b64encode
from pathlib import Path

from matplotlib.figure import Figure

from identknee.report.answers.statements import statements_of
from identknee.report.page.drawing import Drawing
from identknee.report.page.drawings import drawings
from identknee.report.page.laxity_part import laxity_drawings
from identknee.report.page.markup import bullets, element, paragraph, table_html
from identknee.report.page.results import Findings, Result
from identknee.report.picture import png, show_figures
from identknee.report.statement import Statement
from identknee.report.tables import Table
from identknee.runs.findings import finding_lines
from identknee.runs.plain_records import summary_of
from identknee.runs.record import record
from identknee.verbs.answer import Answer
from identknee.verbs.files import ANSWERS

WIDTH, MOST_LINES, MOST_ROWS = 100, 25, 12
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
    kind = f":{type(answer).__name__}"
    return next(verb for verb, place in ANSWERS.items() if place.endswith(kind))


def answer_text(answer: Answer) -> str:
    """What the answer says, cut to a screen."""
    lines = [f"{type(answer).__name__}:"]
    for statement in _main(answer):
        lines += textwrap.wrap(statement.sentence, WIDTH)
        lines += [y[:WIDTH] for x in statement.tables[:1] for y in str(_cut(x)).splitlines()]
    for line in finding_lines(answer.findings):
        lines += textwrap.wrap(line, WIDTH)
    last = "All of it: print(answer). A figure: answer.plot(). A page: ik.report(answer, PATH)."
    room = MOST_LINES - 1
    return "\n".join([*(lines if len(lines) <= room else [*lines[: room - 1], "..."]), last])


def answer_html(answer: Answer) -> str:
    """The answer for a notebook: its main sentences, a table and one figure, at most 200 kB."""
    main = _main(answer)
    sentences = "".join(paragraph(x.sentence) for x in main)
    tables = [x for said in (*main, *statements_of(answer)) for x in said.tables]
    table = "".join(table_html(_cut(x)) for x in tables[:1])
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


def _main(answer: Answer) -> tuple[Statement, ...]:
    """What belongs at the head of a page; of an answer without it the first statement."""
    said = statements_of(answer)
    return tuple(x for x in said if x.is_answer) or said[:1]


def _drawings(answer: Answer) -> tuple[Drawing, ...]:
    result = result_of(answer)
    findings = Findings(subject=result.subject, results=(result,))
    return (*drawings(result), *(x for _, x in laxity_drawings(findings)))


def _cut(table: Table) -> Table:
    """The first rows of a table, and how many are left out."""
    n = len(table.rows)
    if n <= MOST_ROWS:
        return table
    title = f"{table.title} (the first {MOST_ROWS} of {n} rows)"
    return Table(title=title, columns=table.columns, rows=table.rows[:MOST_ROWS])


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
