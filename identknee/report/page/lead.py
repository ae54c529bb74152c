"""What a page begins with: answer, gravest findings, a table, a picture and what is next."""

from collections.abc import Sequence

from markupsafe import Markup

from identknee.report.opening import MOST_FINDINGS, brief_line
from identknee.report.overview import Overview, Row
from identknee.report.tables import Table, table
from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding, Severity

# What is asked after a fit, in this order, before anything else.
AFTER_FIT = ("profile", "diagnose", "design")
# Rows of the table that are not folded: with a picture beside them they take one screen.
MOST_ROWS = 14


@declared
class Lead:
    """The first screens of a page, and what they leave for below."""

    found: Overview = entry("What all results say together")
    shown: tuple[str, ...] = entry("The gravest findings, each on a line or two")
    left: str = entry("How many more findings there are, in words; empty for none")
    below: tuple[str, ...] = entry("Findings in full that the first screens leave out or cut short")
    rows: tuple[Row, ...] = entry("The table")
    folded: tuple[Row, ...] = entry("Its rows that are one click away")
    ranges: Table = entry("What each method says where they differ")
    picture: Markup = entry("Measured and simulated laxity; empty where there is none")
    step: tuple[str, str] | None = entry(
        "A question that is open and its command, where no other step is advised"
    )


def lead_of(
    found: Overview,
    cautions: Sequence[Finding],
    picture: Markup,
    further: Sequence[tuple[str, str]],
) -> Lead:
    """The first screens of a page.

    Parameters
    ----------
    found
        What all results say together.
    cautions
        Findings that the sentences before the verdict do not say, the gravest first.
    picture
        Measured and simulated laxity; empty where there is none.
    further
        Questions that no result answers with their commands.
    """
    opening = found.opening
    # Sentences before the verdict are findings too.
    n_shown = max(1, MOST_FINDINGS - opening.n_brief)
    shown = tuple(map(brief_line, cautions[:n_shown]))
    full = [x for x in opening.sentences if x not in opening.brief]
    below = [*full, *(x.line for x in cautions if x.line not in shown)]
    n_opening = len({x.identity for x in opening.findings}) - opening.n_brief
    is_advised = opening.has_command or found.next_tests
    return Lead(
        found=found,
        shown=shown,
        left=_left(n_opening, cautions[n_shown:], is_cut=bool(below)),
        below=tuple(below),
        rows=found.rows[:MOST_ROWS],
        folded=found.rows[MOST_ROWS:],
        ranges=table(
            "What each method says",
            ("quantity", "methods"),
            ((x.label, x.agreement) for x in found.rows if x.agreement != x.found.brief()),
        ),
        picture=picture,
        step=None if is_advised else _step(found, further),
    )


def _step(found: Overview, further: Sequence[tuple[str, str]]) -> tuple[str, str] | None:
    """The question to ask next, with its command; None where all are answered."""
    by_verb = {command.split()[1]: (question, command) for question, command in further}
    is_fitted = found.rows or found.searches
    wanted = [*(AFTER_FIT if is_fitted else ()), *by_verb]
    return next((by_verb[x] for x in wanted if x in by_verb), None)


def _left(n_opening: int, cautions: Sequence[Finding], *, is_cut: bool) -> str:
    """How many findings more there are."""
    n = max(n_opening, 0) + len(cautions)
    if not n:
        return "The findings in full" if is_cut else ""
    n_errors = sum(x.severity is Severity.ERROR for x in cautions)
    errors = f", {n_errors} of them errors" if n_errors > 1 else ", 1 of them an error" * n_errors
    return f"{n} more finding{'s' * (n > 1)}{errors}"
