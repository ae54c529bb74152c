"""What answers are printed and drawn by: text here, figures and notebooks when they are wanted."""

import textwrap
from typing import TYPE_CHECKING

from identknee.report.opening import opening_of
from identknee.report.presenter import assumption_sentences, main_statements, statements_of
from identknee.runs.findings import finding_lines
from identknee.verbs.answer import Answer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, MOST_LINES = 100, 25


def full_text(answer: Answer) -> str:
    """All that the answer says."""
    return "\n".join(terminal_lines(answer))


def terminal_lines(answer: Answer) -> list[str]:
    """What a person reads of an answer: sentences with their tables, then what to know."""
    opening = opening_of([answer])
    lines = list(opening.sentences)
    for statement in statements_of(answer):
        lines += [statement.sentence, *(f"\n{x}\n" for x in statement.tables)]
    left = finding_lines(opening.without(answer.findings))
    return [*lines, *assumption_sentences(answer), *left]


def short_text(answer: Answer) -> str:
    """What the answer says, cut to a screen."""
    opening = opening_of([answer])
    lines = [f"{type(answer).__name__}:"]
    for sentence in opening.sentences:
        lines += textwrap.wrap(sentence, WIDTH)
    for statement in main_statements(answer):
        lines += textwrap.wrap(statement.sentence, WIDTH)
        lines += [y[:WIDTH] for x in statement.tables[:1] for y in str(x.first_rows()).splitlines()]
    for line in finding_lines(opening.without(answer.findings)):
        lines += textwrap.wrap(line, WIDTH)
    last = "All of it: print(answer). A figure: answer.plot(). A page: ik.report(answer, PATH)."
    room = MOST_LINES - 1
    return "\n".join([*(lines if len(lines) <= room else [*lines[: room - 1], "..."]), last])


def html(answer: Answer) -> str:
    """The answer for a notebook."""
    from identknee.report.notebook import answer_html

    return answer_html(answer)


def figure(answer: Answer, name: str | None) -> "Figure":
    """A figure of the answer; see `identknee.verbs.answer.Answer.plot`."""
    from identknee.report.notebook import answer_figure

    return answer_figure(answer, name)
