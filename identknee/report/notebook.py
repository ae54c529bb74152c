"""An answer in a notebook, with table and figure."""

from base64 import b64encode
from pathlib import Path

from matplotlib.figure import Figure

from identknee.report.figures import png, show_figures
from identknee.report.page.laxity_part import laxity_drawings
from identknee.report.page.markup import parts
from identknee.report.page.results import Findings, Result, drawings
from identknee.report.presenter import Drawing, main_statements, statements_of
from identknee.runs.findings import finding_lines
from identknee.runs.plain_records import summary_of
from identknee.runs.record import record
from identknee.verbs.answer import Answer
from identknee.verbs.registry import verbs_with_answer

# Bytes of a picture and of a whole answer in a notebook, which keeps every one of them.
MOST_BYTES = 130_000
SHARPNESS = (110, 90, 70, 50, 35)


def result_of(answer: Answer, folder: Path | None = None) -> Result:
    """The answer as the report takes it, as if it had been read from `folder`."""
    made = (
        answer.record
        or record(next(verbs_with_answer(type(answer).__name__)).name, {}, {}).finish()
    )
    summary = {**summary_of(answer), "record": made.to_dict()}
    return Result(folder=folder or Path(made.verb), summary=summary, answer=answer)


def answer_html(answer: Answer) -> str:
    """The answer for a notebook: its main sentences, a table and one figure, at most 200 kB."""
    main = main_statements(answer)
    tables = [x.first_rows() for said in (*main, *statements_of(answer)) for x in said.tables]
    picture, caption = b"", ""
    for drawing in _drawings(answer)[:1]:
        caption = drawing.caption
        # As sharp a picture as fits.
        for dots in SHARPNESS:
            if len(picture := png(drawing.figure, dots)) <= MOST_BYTES:
                break
    return str(
        parts().notebook_answer(
            [x.sentence for x in main],
            tables[:1],
            b64encode(picture).decode("ascii"),
            caption,
            finding_lines(answer.findings),
        )
    )


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
