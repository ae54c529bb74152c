"""The cells of a CSV table, read with the line number that every message about them needs."""

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn, Self, TextIO

from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import PathLike, check_readable

OPENSIM, OPENSIM_END = (".sto", ".mot"), "endheader"
DEG = 57.29577951308232
COLUMN = re.compile(r"column\s*:\s*(\w+)\s*=\s*(?:([^*]+?)\s*\*)?\s*(-?)\s*(\S.*)", re.IGNORECASE)
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


class CellFile:
    """A CSV file being read: comments, header, then rows one by one.

    Lines that start with ``#`` are comments wherever they stand. Spaces around cells, quoted cells,
    a byte-order mark and any line ends are fine; rows whose cells are all blank are passed over.

    Attributes
    ----------
    path
        The file.
    columns
        Position of each column by its name.
    header_line
        Line number of the header.
    comments
        Line number and text of each comment met so far.
    delimiter
        What stands between cells: a comma or, where the header says so, a semicolon or a tab. Only
        then may numbers have a decimal comma.
    sources
        Column in the file, and the factor of its values, by the name that it is read under.
    """

    def __init__(self, path: Path, file: TextIO) -> None:
        self.path = path
        self.comments: list[tuple[int, str]] = []
        self.delimiter = ","
        self.sources: dict[str, tuple[str, float]] = {}
        self._lines = self._data_lines(file)
        self.header_line, names = self._header()
        self.columns = {name: position for position, name in enumerate(names)}
        self._n_columns = len(names)
        for name in names:
            if names.count(name) > 1:
                self.refuse(self.header_line, name, "two columns have this name", "Remove one.")

    @classmethod
    @contextmanager
    def open(cls, path: PathLike) -> Iterator[Self]:
        """The file at `path`, its header read.

        In an OpenSim storage (``.sto``, ``.mot``) the lines above the column names are comments,
        and cells that say nan are blank.

        Raises
        ------
        InputError
            If it cannot be read or has no header.
        """
        checked = check_readable(path)
        with checked.open(encoding="utf-8-sig", newline="") as file:
            is_storage = checked.suffix.lower() in OPENSIM
            yield cls(checked, io.StringIO(_as_csv(file)) if is_storage else file)

    def check_columns(self, known: Iterable[str], required: Iterable[str]) -> None:
        """Accept the header if all its columns are known and none is missing.

        Raises
        ------
        InputError
            If not, with the closest known name.
        """
        known = tuple(known)
        if self._is_storage:
            self.columns = {x: place for x, place in self.columns.items() if x in known}
        for name in self.columns:
            if name not in known:
                remedy = _column_remedy(name, known)
                self.refuse(self.header_line, name, "this column is unknown", remedy)
        for name in required:
            if name not in self.columns:
                self.refuse(
                    self.header_line, name, "this column is missing", "Add it; every row needs it."
                )

    def take_opposites(self, opposites: Mapping[str, str]) -> None:
        """Read columns whose values count the other way round, such as a valgus moment or valgus.

        Parameters
        ----------
        opposites
            Name of the column that each is the negative of.

        Raises
        ------
        InputError
            If both stand in the file.
        """
        for name, other in opposites.items():
            if name not in self.columns:
                continue
            if other in self.columns:
                why = f"{other} is there too, of which it is the negative"
                self.refuse(self.header_line, name, why, "Remove one of the two.")
            self._read_as(other, name, -1.0)

    def take_named(self) -> None:
        """Read columns under the names that comment lines above the header give them.

        ``# column: internal_deg = -57.3 * rotation`` reads the column ``rotation`` times -57.3.

        Raises
        ------
        InputError
            If a line has not this form, there is no such column, or its new name is taken.
        """
        for line, text in self.comments:
            if not text.lower().startswith("column"):
                continue
            found = COLUMN.fullmatch(text.rstrip(",; "))
            if found is None or not (found[2] is None or NUMBER.fullmatch(found[2])):
                remedy = "Write for example: # column: internal_deg = -57.3 * rotation."
                self.refuse(line, "", f"{text!r} does not say which column is which", remedy)
            name, source = found[1], found[4]
            if source not in self.columns:
                self.refuse(
                    line, "", f"there is no column {source}", suggestion(source, self.columns)
                )
            if name in self.columns and name != source:
                self.refuse(line, "", f"{name} is there already", "Remove one of the two.")
            self._read_as(name, source, float(found[2] or 1.0) * (-1.0 if found[3] else 1.0))

        if self._is_storage and "time" in self.columns:
            self._read_as("time_s", "time", 1.0)
        if any(re.fullmatch(r"indegrees\s*=\s*no", text.lower()) for _, text in self.comments):
            for name in [x for x in self.columns if x.endswith("_deg")]:
                self._read_as(name, name, DEG)

    @property
    def _is_storage(self) -> bool:
        return self.path.suffix.lower() in OPENSIM

    def _read_as(self, name: str, source: str, factor: float) -> None:
        before, known = self.sources.pop(source, (source, 1.0))
        self.columns[name] = self.columns.pop(source)
        self.sources[name] = before, known * factor

    def rows(self) -> Iterator["Row"]:
        """The rows below the header, in their order."""
        for line, text in self._lines:
            cells = self._split(line, text)
            if any(cells):
                n_columns = self._n_columns
                if len(cells) < n_columns or any(cells[n_columns:]):
                    self.refuse(
                        line,
                        "",
                        f"there are {len(cells)} cells under {n_columns} columns",
                        "Give each column one cell, blank where there is nothing to say, and "
                        "put cells that hold a comma in quotes.",
                    )
                yield Row(self, line, cells)

    def refuse(self, line: int, column: str, why: str, remedy: str) -> NoReturn:
        """Raise the error about a place in this file."""
        place = f"row {line}, column {column}" if column else f"row {line}"
        raise InputError(self.path, place, why, remedy)

    def _header(self) -> tuple[int, list[str]]:
        for line, text in self._lines:
            self.delimiter = next((x for x in ";\t" if x in text and "," not in text), ",")
            names = self._split(line, text)
            while names and not names[-1]:
                names.pop()
            if names:
                if "" in names:
                    self.refuse(line, "", "a column has no name", "Name it or remove it.")
                return line, names
        raise InputError(self.path, "", "there is no header", "Start with a row of column names.")

    def _data_lines(self, file: TextIO) -> Iterator[tuple[int, str]]:
        try:
            for number, line in enumerate(file, 1):
                text = line.rstrip("\r\n")
                if text.lstrip().startswith("#"):
                    self.comments.append((number, text.lstrip()[1:].strip()))
                elif text.strip():
                    yield number, text
        except UnicodeDecodeError as error:
            raise InputError(
                self.path, "", "the text is not UTF-8", "Save the table as CSV in UTF-8."
            ) from error

    def _split(self, line: int, text: str) -> list[str]:
        # Line by line, so that a quote left open spoils one row and row numbers stay line numbers.
        if text.count('"') % 2:
            self.refuse(line, "", "a quote is left open", 'Close it, or write "" for a quote mark.')
        try:
            (cells,) = csv.reader(
                [text], delimiter=self.delimiter, skipinitialspace=self.delimiter == ","
            )
        except csv.Error as error:
            self.refuse(line, "", f"the row cannot be split into cells ({error})", "Shorten it.")
        return [cell.strip() for cell in cells]


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One row of a `CellFile`."""

    file: CellFile
    line: int
    cells: list[str]

    def text(self, column: str) -> str:
        """What stands in `column`, without the spaces around it; empty without such a column."""
        position = self.file.columns.get(column)
        return "" if position is None else self.cells[position]

    def number(self, column: str, blank_where: str = "") -> float | None:
        """Number in `column`, None where the cell is blank.

        Parameters
        ----------
        column
            Its name.
        blank_where
            Where a blank cell is right, for the message about text in its place.

        Raises
        ------
        InputError
            If the cell holds anything but a finite decimal number.
        """
        text = self.text(column)
        if not text:
            return None
        # Only where no comma separates cells can one be nothing but a decimal sign.
        plain = text.replace(",", ".", 1) if self.file.delimiter != "," else text
        if NUMBER.fullmatch(plain):
            value = float(plain)
            if abs(value) != float("inf"):
                factor = self.file.sources.get(column, ("", 1.0))[1]
                # Zero stays without a sign.
                return value if factor == 1.0 else 0.0 + factor * value
            self.refuse(column, f"{text} is too large to be a number here", "Check its exponent.")
        if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", text):
            remedy = "Write it with a decimal point."
        elif re.fullmatch(r"[\u2212\u2012\u2013\u2014][0-9.]+", text):
            remedy = "Write the minus sign as a plain hyphen."
        elif blank_where:
            remedy = f"Write a number, or leave the cell blank where {blank_where}."
        else:
            remedy = "Write a number, such as 2.5."
        return self.refuse(column, f"{text!r} is not a number", remedy)

    def required(self, column: str) -> float:
        """Number in `column`.

        Raises
        ------
        InputError
            If the cell is blank or holds no number.
        """
        value = self.number(column)
        if value is None:
            self.refuse(column, "the cell is blank", "Write a number, 0 if it is zero.")
        return value

    def refuse(self, column: str, why: str, remedy: str) -> NoReturn:
        """Raise the error about a cell of this row."""
        self.file.refuse(self.line, self.file.sources.get(column, (column, 1.0))[0], why, remedy)


def _as_csv(file: TextIO) -> str:
    """An OpenSim storage with its head as comments, line by line."""
    lines, is_head = [], True
    for line in file:
        words = ["" if x.lower() == "nan" else x for x in line.split()]
        lines.append(f"# {line.strip().lstrip('# ')}" if is_head else "\t".join(words))
        is_head = is_head and line.strip().lower() != OPENSIM_END
    return "\n".join(lines)


def written(cells: Iterable[str]) -> str:
    """One CSV line of `cells`, quoted where a reader would need it.

    Examples
    --------
    >>> written(["#1", "a, b", "0.1"])
    '"#1","a, b",0.1'
    """
    return ",".join(
        '"' + cell.replace('"', '""') + '"' if re.search(r'[,"#;]', cell) else cell
        for cell in cells
    )


def _column_remedy(name: str, known: tuple[str, ...]) -> str:
    """The closest known column, or how to name one; a different unit changes its values too."""
    remedy, quantity = suggestion(name, known), name.rpartition("_")[0]
    if not remedy.startswith("Did you mean"):
        return f"{remedy} To read it as one of them, begin the file: # column: ONE = 1 * {name}"
    if not quantity or remedy.removeprefix("Did you mean ").rpartition("_")[0] != quantity:
        return remedy
    return f"{remedy} If so, convert its values to that unit."
