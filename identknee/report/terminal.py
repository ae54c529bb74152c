"""An answer as lines on a terminal: the statements that the page shows too, and what to know."""

from identknee.report.answers.statements import statements_of
from identknee.report.answers.taken import taken_for_granted
from identknee.runs.findings import finding_lines
from identknee.verbs.answer import Answer


def terminal_lines(answer: Answer) -> list[str]:
    """The terminal text of an answer: sentences with their tables, then findings."""
    lines: list[str] = []
    for statement in statements_of(answer):
        lines += [statement.sentence, *(f"\n{x}\n" for x in statement.tables)]
    return [*lines, *taken_for_granted(answer), *finding_lines(answer.findings)]
