"""What answers are printed and drawn by: text here, figures and notebooks when they are wanted."""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from identknee.report.opening import MOST_FINDINGS, brief_line, opening_of
from identknee.report.presenter import (
    Question,
    Statement,
    assumption_sentences,
    main_statements,
    presenter_of,
    statements_of,
)
from identknee.runs.findings import (
    Severity,
    by_severity,
    finding_lines,
    without_repeats,
)
from identknee.runs.words import listed
from identknee.verbs.answer import Answer

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

WIDTH, MOST_LINES = 100, 25


def brief_lines(answer: Answer) -> list[str]:
    """What a command prints: main sentences, each with its first table, and the gravest findings.

    All of it is in `terminal_lines`, in the files and in the report.
    """
    if presenter_of(answer).is_brief:
        return terminal_lines(answer)
    opening = opening_of([answer])
    lines = list(opening.brief)
    statements = statements_of(answer)
    main = _main(statements)
    for statement in main:
        lines += [statement.sentence, *(f"\n{x}\n" for x in statement.tables[:1])]
    # One line less on a screen; between statements the empty line is needed.
    lines[-1] = lines[-1].rstrip("\n")
    rest = by_severity(opening.without(answer.findings))
    serious = [x for x in rest if x.severity is not Severity.INFO]
    # Errors are all printed, however many there are.
    n_errors = sum(x.severity is Severity.ERROR for x in serious)
    shown = serious[: max(MOST_FINDINGS - opening.n_brief, n_errors)]
    lines += map(brief_line, shown)
    counts = {
        "finding": len(without_repeats(answer.findings)) - opening.n_brief - len(shown),
        "assumption": len(assumption_sentences(answer)),
        "table": sum(len(x.tables) for x in statements) - sum(len(x.tables[:1]) for x in main),
    }
    more = listed(f"{n} {word}{'s' * (n > 1)}" for word, n in counts.items() if n > 0)
    return [*lines, f"{more} more: --verbose, or the report"] if more else lines


def _main(statements: Sequence[Statement]) -> list[Statement]:
    """The answer, what to do next, and the first numbers where these have none."""
    is_main = [x.is_answer or x.question is Question.NEXT for x in statements]
    if not any(x.is_answer for x in statements):
        is_main[:1] = [True]
    if not any(x.tables for x, is_said in zip(statements, is_main, strict=True) if is_said):
        first = next((k for k, x in enumerate(statements) if x.tables), 0)
        is_main[first : first + 1] = [True]
    return [x for x, is_said in zip(statements, is_main, strict=True) if is_said]


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


def figure(answer: Answer, name: str | None, **where: Any) -> "Figure":
    """A figure of the answer; see `identknee.verbs.answer.Answer.plot`."""
    from identknee.report.notebook import answer_figure

    return answer_figure(answer, name, **where)


def methods(answer: Answer) -> str:
    """How the answer was computed; see `identknee.verbs.answer.Answer.methods`."""
    from identknee.report.methods import methods_text

    return methods_text(answer)


def dataframe(answer: Answer, name: str | None) -> "DataFrame":
    """A table of the answer; see `identknee.verbs.answer.Answer.to_dataframe`."""
    from identknee.report.table_files import tables_of

    known = tables_of(answer)
    if not known:
        raise ValueError(f"{type(answer).__name__} has no table; print it to see what it says")
    if name is not None and name not in known:
        raise ValueError(f"there is no table {name!r}; choose from {', '.join(known)}")
    return known[name or next(iter(known))].dataframe()
