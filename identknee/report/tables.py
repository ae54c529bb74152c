"""Results as tables: rows of text and numbers, each column with its unit."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from typing_extensions import override

if TYPE_CHECKING:
    from pandas import DataFrame

Cell = str | float | int | None
# Rows that a notebook shows.
MOST_ROWS = 12


@dataclass(frozen=True, slots=True)
class Column:
    """Head of a column.

    Attributes
    ----------
    name
        What stands in it.
    decimals
        Places after the point; None for as many as four significant digits need.
    unit
        Unit of its numbers; empty for text, counts and ratios.
    """

    name: str
    decimals: int | None = 2
    unit: str = ""

    @property
    def head(self) -> str:
        """Name and unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table with a title.

    Attributes
    ----------
    title
        A line that says what it shows.
    columns
        Heads, as many as every row has cells.
    rows
        Cells: text, numbers, or None where there is nothing to say.
    most
        Rows that a terminal shows, the first ones; all where None.

    Raises
    ------
    ValueError
        If a row is longer or shorter than the heads.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    most: int | None = None

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"every row of {self.title!r} needs {len(self.columns)} cells, got {len(row)}"
                )

    @property
    def name(self) -> str:
        """Its name in files and calls: the words of its title up to the first mark.

        Examples
        --------
        >>> table("95 % intervals of stiffness (3 rows)", ["name"], []).name
        'intervals-of-stiffness'
        """
        return "-".join(re.findall(r"[a-z]+", re.split(r"[:,(]", self.title)[0].lower()))

    def first_rows(self, most: int = MOST_ROWS) -> "Table":
        """The first rows, with how many there are."""
        n = len(self.rows)
        if n <= most:
            return self
        title = f"{self.title} (the first {most} of {n} rows)"
        return Table(title=title, columns=self.columns, rows=self.rows[:most])

    def texts(self) -> list[list[str]]:
        """The cells as text, row by row."""
        return [
            [_text(cell, column) for cell, column in zip(row, self.columns, strict=True)]
            for row in self.rows
        ]

    @property
    def without_blank_columns(self) -> "Table":
        """The table without columns of text, such as remarks, that are blank in every row."""
        n = len(self.columns)
        kept = [i for i in range(n) if i == 0 or any(row[i] != "" for row in self.rows)]
        if len(kept) == n or not self.rows:
            return self
        return replace(
            self,
            columns=tuple(self.columns[i] for i in kept),
            rows=tuple(tuple(row[i] for i in kept) for row in self.rows),
        )

    def markdown(self) -> str:
        """The table as Markdown, its title above it in bold."""
        heads = [column.head for column in self.columns]
        rule = ["---" if self.is_text(i) else "---:" for i in range(len(heads))]
        rows = [[cell.replace("|", "\\|") for cell in row] for row in (heads, *self.texts())]
        lines = ["| " + " | ".join(row) + " |" for row in (rows[0], rule, *rows[1:])]
        return "\n".join([f"**{self.title}**", "", *lines])

    def dataframe(self) -> "DataFrame":
        """The cells as numbers and texts, under heads with units; what is not known is NaN."""
        import pandas as pd

        heads = [column.head for column in self.columns]
        return pd.DataFrame([list(row) for row in self.rows], columns=heads)

    @override
    def __str__(self) -> str:
        """The table in columns of even width, for a terminal."""
        if self.without_blank_columns is not self:
            return str(self.without_blank_columns)
        rows = [[column.head for column in self.columns], *self.texts()[: self.most]]
        widths = [max(len(row[i]) for row in rows) for i in range(len(self.columns))]
        lines = [
            "  ".join(
                cell.ljust(width) if self.is_text(i) else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]
        left = len(self.rows) + 1 - len(rows)
        more = [f"and {left} more rows, which the report shows"] if left else []
        return "\n".join([self.title, *lines, *more])

    def is_text(self, i: int) -> bool:
        """Whether a column has text, which stands at its left."""
        return i == 0 or any(isinstance(row[i], str) for row in self.rows)


def table(
    title: str,
    heads: Iterable[str | tuple[Any, ...]],
    rows: Iterable[Iterable[Cell]],
    most: int | None = None,
) -> Table:
    """A table; a head is a name, or a name with its decimals and, where it has one, its unit.

    Examples
    --------
    >>> print(table("Ends", ["name", ("force", 1, "N")], [["ACL", 71.25]]))
    Ends
    name  force [N]
    ACL        71.2
    """
    columns = tuple(Column(x) if isinstance(x, str) else Column(*x) for x in heads)
    return Table(title=title, columns=columns, rows=tuple(map(tuple, rows)), most=most)


def _text(cell: Cell, column: Column) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int):
        return str(cell)
    if column.decimals is None:
        return f"{cell:.4g}"
    # Adding zero turns a rounded -0.0 into 0.0.
    return f"{round(cell, column.decimals) + 0.0:.{column.decimals}f}"
