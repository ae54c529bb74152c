"""Tables for a paper: CSV, LaTeX and Markdown, each with what it rests on below it."""

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from identknee.report.overview import Overview, overview
from identknee.report.presenter import (
    Table,
    assumption_sentences,
    is_blank,
    statements_of,
    table,
)
from identknee.runs.findings import Severity, finding_lines
from identknee.runs.words import unit_of
from identknee.verbs.answer import Answer

ESTIMATES = "estimates"
DASH = "A dash is an end that is open, or a value that is not known."
# Characters that are special in LaTeX, and signs that pdfTeX lacks.
LATEX = {
    "\\": r"\textbackslash{}",
    **{x: f"\\{x}" for x in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": "$<$",
    ">": "$>$",
    "|": "$|$",
    "\u2212": "$-$",
    "±": r"$\pm$",
    "·": r"$\cdot$",
    "×": r"$\times$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "°": r"$^\circ$",
    "²": "$^2$",
    "³": "$^3$",
    "\u2013": "--",
    "…": r"\ldots{}",
    "µ": r"$\mu$",
    "μ": r"$\mu$",
    "σ": r"$\sigma$",
    "χ": r"$\chi$",
    "Δ": r"$\Delta$",
}
# Longer texts of a column are broken into lines.
LONGEST, WRAPPED = 36, r"p{0.25\linewidth}"
# Advice on commands does not belong in a paper.
HINT = re.compile(r"; [^;.]*--[^.]*")
NUMBER = re.compile(r"(-?)(\d+(?:\.\d+)?)(?:e([+-]\d+))?")


def estimates_table(found: Overview) -> Table:
    """The quantities of an overview with their ends as numbers, in the order of the page."""
    return table(
        "Estimates and 95 % sets",
        (
            "quantity",
            "unit",
            *(("estimate", None), ("lower end", None), ("upper end", None)),
            *("status", "method", "methods compared"),
        ),
        (
            (
                x.label,
                unit_of(x.name),
                *(x.found.main.value, x.found.main.low, x.found.main.high),
                *(x.status, x.found.main.source.value, x.agreement),
            )
            for x in found.rows
        ),
    )


def tables_of(answer: Answer) -> dict[str, Table]:
    """All tables of an answer by their names, its estimates first."""
    estimates = estimates_table(overview([answer]))
    found = {ESTIMATES: estimates} if estimates.rows else {}
    return found | named(x for said in statements_of(answer) for x in said.tables)


def named(tables: Iterable[Table]) -> dict[str, Table]:
    """Tables by their names, those of one name told apart by a number; without empty ones."""
    found: dict[str, Table] = {}
    for x in tables:
        alike = [y for y in found.values() if y.name == x.name]
        if x.rows and x not in alike:
            found[f"{x.name}-{len(alike) + 1}" if alike else x.name] = x
    return found


def file_word(name: str) -> str:
    """A name as part of the name of a file.

    Examples
    --------
    >>> file_word("s192803 (ACL cut)")
    's192803-ACL-cut'
    """
    return "-".join(re.findall(r"[\w.]+", name))


def notes_of(answers: Sequence[Answer]) -> tuple[str, ...]:
    """What the numbers of these answers rest on: assumptions, then errors and warnings."""
    assumed = [y for x in answers for y in assumption_sentences(x)]
    serious = [y for x in answers for y in x.findings if y.severity is not Severity.INFO]
    sentences = dict.fromkeys([*assumed, *finding_lines(serious)])
    return tuple(HINT.sub("", x) for x in sentences)


def _csv(given: Table, _: str, notes: Sequence[str]) -> str:
    """Cells in full precision; the notes are comment lines, as in a laxity table."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([x.head for x in given.columns])
    writer.writerows([["" if is_blank(x) else x for x in row] for row in given.rows])
    return "".join(f"# {x}\n" for x in (given.title, *notes)) + text.getvalue()


def _markdown(given: Table, _: str, notes: Sequence[str]) -> str:
    return "\n\n".join([given.markdown(), " ".join(notes)]).rstrip() + "\n"


def _latex(given: Table, label: str, notes: Sequence[str]) -> str:
    """A floating table that needs no package."""
    texts = given.texts()
    longest = [max(len(row[i]) for row in texts) for i in range(len(given.columns))]
    places = "".join(
        ("l" if length <= LONGEST else WRAPPED) if given.is_text(i) else "r"
        for i, length in enumerate(longest)
    )
    heads = " & ".join(escaped(x.head) for x in given.columns)
    rows = [" & ".join(map(_latex_cell, row)) for row in texts]
    lines = [
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{escaped(given.title)}.}}",
        rf"  \label{{tab:{label}}}",
        rf"  \begin{{tabular}}{{{places}}}",
        r"    \hline",
        rf"    {heads} \\",
        r"    \hline",
        *(rf"    {x} \\" for x in rows),
        r"    \hline",
        r"  \end{tabular}",
        *([rf"  \par\smallskip{{\footnotesize {escaped(' '.join(notes))}\par}}"] * bool(notes)),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def escaped(text: str) -> str:
    r"""A text as LaTeX sets it, letter by letter.

    Examples
    --------
    >>> escaped("95 % of ACL_a"), escaped("\u22124 to 2")
    ('95 \\% of ACL\\_a', '$-$4 to 2')
    """
    return "".join(LATEX.get(x, x) for x in text)


def _latex_cell(text: str) -> str:
    """A cell; numbers have the minus and the exponent of mathematics."""
    number = NUMBER.fullmatch(text)
    if number is None or not (number[1] or number[3]):
        return "--" if text == "-" else escaped(text)
    power = "" if number[3] is None else rf"\times 10^{{{int(number[3])}}}"
    return f"${number[1]}{number[2]}{power}$"


FORMS: Mapping[str, tuple[str, Callable[[Table, str, Sequence[str]], str]]] = {
    "csv": ("csv", _csv),
    "latex": ("tex", _latex),
    "markdown": ("md", _markdown),
}


def forms_of(words: str) -> tuple[str, ...]:
    """The forms that a text names, as in ``"csv,latex"``.

    Raises
    ------
    ValueError
        If it names another.
    """
    found = tuple(x.strip() for x in words.split(",") if x.strip())
    if wrong := [x for x in found if x not in FORMS]:
        raise ValueError(f"--tables {wrong[0]}: it is none of {', '.join(FORMS)}")
    return found


def table_files(
    tables: Mapping[str, tuple[Table, Sequence[str]]], forms: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Name and content of a file for each table and form.

    Parameters
    ----------
    tables
        By name, a table and what it rests on.
    forms
        Some of `FORMS`.
    """
    for name, (given, notes) in tables.items():
        shown = given.without_blank_columns
        has_dash = any(is_blank(cell) for row in shown.rows for cell in row)
        below = (*([DASH] if has_dash else []), *notes)
        for form in forms:
            ending, write = FORMS[form]
            yield f"{name}.{ending}", write(shown, name, below)
