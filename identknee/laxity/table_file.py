"""The text of a laxity table: cells, curves of a rig, statements in comment lines, and angles.

OpenSim storages (``.sto``, ``.mot``) are read as tables: their heads state the unit of angles.
"""

import csv
import io
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum, unique
from pathlib import Path
from typing import NoReturn, Self, TextIO

import numpy as np

from identknee.laxity.data_frame import NAME, Frame, frame_text, is_frame, statement_near
from identknee.laxity.protocol import (
    ABSOLUTE,
    DIRECTIONS,
    FLEXION_LIMITS_DEG,
    SAME_FLEXION_DEG,
    STRAY,
    TYPICAL,
    WAYS,
    ZEROS,
    Protocol,
    zero_fault,
)
from identknee.laxity.spreadsheets import (
    COUNT,
    DEG,
    NAMELESS,
    THOUSAND,
    header_below,
    is_unit_row,
    number_remedy,
    opened_text,
    wrong_unit,
)
from identknee.laxity.translations import COMPONENTS, DEFINITIONS, Translations
from identknee.runs.declare import Array
from identknee.runs.errors import InputError, closest, suggestion
from identknee.runs.files import PathLike, check_readable
from identknee.runs.findings import Finding, finding

COLUMN = re.compile(
    r"column\s*:\s*(\w+)\s*=\s*(?:([0-9.]+)\s*(?=[+-]))?([+-]?)\s*(?:([^*]+?)\s*\*)?\s*(-?)\s*(\S.*)",
    re.IGNORECASE,
)
SEPARATOR = re.compile(r'"?sep\s*=\s*([^\w\s"]|[ \t])"?[,;\t]*', re.IGNORECASE)
BETWEEN_CELLS = ",;\t|"
ROW = "trial"
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
        What stands between cells: a comma or, where the header or Excel's own first line says so, a
        semicolon, a tab or a bar. Only then may numbers have a decimal comma.
    sources
        Column in the file, the factor of its values, and what is added to them, by the name that it
        is read under.
    turns
        Whole turns that are added to a cell [deg], by line and column.
    in_radians
        What makes radians of the angles of a storage, as a clause, by column.
    findings
        What was done to the numbers of the file.
    """

    def __init__(self, path: Path, file: TextIO, places: Sequence[str] = ()) -> None:
        self.path = path
        self._places = places
        self.comments: list[tuple[int, str]] = []
        self.delimiter = ","
        self.sources: dict[str, tuple[str, float, float]] = {}
        self.turns: dict[tuple[int, str], float] = {}
        self.in_radians: dict[str, str] = {}
        self.findings: list[Finding] = []
        self._lines = self._data_lines(file)
        self._decimals: dict[str, bool] = {}
        self.header_line, names = self._header()
        self._is_counted = NAMELESS.fullmatch(names[0]) is not None
        self._names = names
        first = 1 if self._is_counted else 0
        self.columns = {x: i for i, x in enumerate(names) if x and i >= first}

    @classmethod
    @contextmanager
    def open(cls, path: PathLike | Frame) -> Iterator[Self]:
        """The file at `path`, or the data frame, its header read.

        In an OpenSim storage (``.sto``, ``.mot``) the lines above the column names are comments,
        and cells that say nan are blank.

        Raises
        ------
        InputError
            If it cannot be read or has no header.
        """
        if is_frame(path):
            text, places = frame_text(path)
            yield cls(Path(NAME), io.StringIO(text), places)
            return
        checked = check_readable(path)
        with opened_text(checked) as file:
            is_storage = checked.suffix.lower() in SUFFIXES
            yield cls(checked, io.StringIO(as_csv(file, checked)) if is_storage else file)

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
        unknown = [x for x in self.columns if x not in known]
        if unknown:
            self._check_header(known)
        named = self._names[1 if self._is_counted else 0 :]
        if "" in named:
            self.refuse(self.header_line, "", "a column has no name", "Name it or remove it.")
        if twice := next((x for x in named if named.count(x) > 1), ""):
            self.refuse(self.header_line, twice, "two columns have this name", "Remove one.")
        for name in unknown:
            remedy = _column_remedy(name, known)
            self.refuse(self.header_line, name, "this column is unknown", remedy)
        for name in required:
            if name not in self.columns:
                remedy = "Add it; every row needs it."
                if self._is_storage:
                    remedy = f"Say which it is above endheader: # column: {name} = 1 * ITS_NAME."
                elif self._is_counted and name == ROW:
                    remedy = f"If the first column has the names of trials, call it {ROW}."
                self.refuse(self.header_line, name, "this column is missing", remedy)

    def _check_header(self, known: Sequence[str]) -> None:
        """Refuse a first row that has no names of columns, where a later one has or none can."""
        words = {x for name in self.columns for x in name.split()}
        if len(self.columns) == 1 and len(words & set(known)) > 1:
            why = "cells are separated by spaces, which are not read"
            self.refuse(self.header_line, "", why, "Save the table with commas or tabs.")
        if not any(x in known for x in self.columns):
            line = header_below(self._lines, known, self.delimiter)
            if line is not None:
                why = f"the column names stand in {self.place(line)}"
                self.refuse(self.header_line, "", why, "Begin every line above it with #.")

    def read_opposite_columns(self, opposites: Mapping[str, str]) -> None:
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

    def read_renamed_columns(self) -> None:
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
            numbers = () if found is None else (x for x in (found[2], found[4]) if x is not None)
            if found is None or not all(NUMBER.fullmatch(x) for x in numbers):
                remedy = "Write for example: # column: internal_deg = -57.3 * rotation."
                self.refuse(line, "", f"{text!r} does not say which column is which", remedy)
            name, source = found[1], found[6]
            if source not in self.columns:
                self.refuse(
                    line, "", f"there is no column {source}", suggestion(source, self.columns)
                )
            if name in self.columns and name != source:
                self.refuse(line, "", f"{name} is there already", "Remove one of the two.")
            sign = -1.0 if (found[3] == "-") != bool(found[5]) else 1.0
            self._read_as(name, source, sign * float(found[4] or 1.0), float(found[2] or 0.0))

        if self._is_storage:
            if "time" in self.columns:
                self._read_as("time_s", "time", 1.0)
            self._count_in_degrees()

    def _count_in_degrees(self) -> None:
        """Read the angles of an OpenSim storage in degrees, however they are counted there."""
        how = counted((text for _, text in self.comments), self.path.suffix)
        if how is Counted.CONTRADICTED:
            why = (
                "this .mot file has no version, so that OpenSim reads degrees despite inDegrees=no"
            )
            self.refuse(1, "", why, "Write version=1 if these are radians, else inDegrees=yes.")
        if how is Counted.DEGREES:
            return
        turned = []
        for name in [x for x in self.columns if x.endswith("_deg")]:
            source, factor, offset = self.sources.get(name, (name, 1.0, 0.0))
            # A factor that makes degrees of radians says itself what it is for.
            if not IN_DEGREES[0] <= abs(factor) <= IN_DEGREES[1]:
                self.sources[name] = source, factor * DEG, offset
                turned.append(name)
        why = NOT_SAID
        if how is Counted.RADIANS:
            said = (text for _, text in self.comments if text.startswith(COUNTED_BY))
            why = f"the line {next(said, 'Angles are in radians.')} makes them radians for OpenSim"
        self.in_radians = dict.fromkeys(turned, why)
        if turned and how is Counted.RADIANS_UNSAID:
            self.findings.append(
                finding("angles-in-radians", "data", {"columns": ", ".join(turned)})
            )

    @property
    def _is_storage(self) -> bool:
        return self.path.suffix.lower() in SUFFIXES

    def _read_as(self, name: str, source: str, factor: float, offset: float = 0.0) -> None:
        before, known, added = self.sources.pop(source, (source, 1.0, 0.0))
        self.columns[name] = self.columns.pop(source)
        self.sources[name] = before, known * factor, added * factor + offset

    def rows(self) -> Iterator["TableRow"]:
        """The rows below the header, in their order."""
        is_first = True
        for line, text in self._lines:
            cells = self._split(line, text)
            if any(cells):
                n_columns = len(self._names)
                if len(cells) < n_columns or any(cells[n_columns:]):
                    self.refuse(
                        line,
                        "",
                        f"there are {len(cells)} cells under {n_columns} columns",
                        self._cell_remedy,
                    )
                if self._is_counted and not COUNT.fullmatch(cells[0]):
                    remedy = "Name it or remove it."
                    named = self._names[0]
                    why = "this column does not count rows" if named else "a column has no name"
                    self.refuse(self.header_line, named, why, remedy)
                if not (is_first and is_unit_row(cells)):
                    yield TableRow(self, line, cells)
                elif found := wrong_unit(self._under_own_names, cells):
                    name, unit = found
                    why = f"the row of units says {unit}"
                    self.refuse(
                        line, name, why, "Convert the column, or say it in a line # column."
                    )
                is_first = False

    @property
    def _cell_remedy(self) -> str:
        remedy = "Give each column one cell, blank where there is nothing to say"
        if self.delimiter != ",":
            return f"{remedy}."
        remedy += ", and put cells that hold a comma in quotes."
        return f"{remedy} Where numbers have decimal commas, put semicolons between cells."

    @property
    def _under_own_names(self) -> dict[str, int]:
        """Position of the columns that keep their names, which no comment line renames."""
        return {x: place for x, place in self.columns.items() if x not in self.sources}

    def is_other_decimal(self, text: str) -> bool:
        """Whether a number has another decimal sign than one before, and one may be no such sign.

        In a table with decimal commas 1.000 may be a thousand.
        """
        own = next((x for x in ",." if x in text), "")
        if not own:
            return False
        may_be_thousand = THOUSAND.fullmatch(text) is not None
        self._decimals[own] = self._decimals.get(own, False) or may_be_thousand
        return len(self._decimals) > 1 and any(self._decimals.values())

    def refuse(self, line: int, column: str, why: str, remedy: str) -> NoReturn:
        """Raise the error about a place in this file."""
        row = self.place(line)
        raise InputError(self.path, f"{row}, column {column}" if column else row, why, remedy)

    def place(self, line: int) -> str:
        """What messages call a line: its number in a file, the index of a row of a data frame."""
        return self._places[line - 1] if line <= len(self._places) else f"row {line}"

    def _header(self) -> tuple[int, list[str]]:
        stated = ""
        for line, text in self._lines:
            # Excel's own first line says what stands between cells.
            if not stated and (found := SEPARATOR.fullmatch(text)):
                stated = found[1]
                if stated not in BETWEEN_CELLS:
                    why = f"{stated!r} is not read as what stands between cells"
                    self.refuse(line, "", why, "Save the table with commas or semicolons.")
                continue
            if stated and stated not in text:
                why = f"the first line says {stated!r} between cells, and the header has none"
                self.refuse(line, "", why, "Correct the first line, or remove it.")
            used = next((x for x in ";\t" if x in text and "," not in text), ",")
            self.delimiter = stated or used
            names = self._split(line, text)
            while names and not names[-1]:
                names.pop()
            if names:
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
class TableRow:
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
            if self.file.is_other_decimal(text):
                why = f"{text} has another decimal sign than numbers before"
                self.refuse(column, why, "Write all alike, and none with a sign for thousands.")
            value = float(plain)
            if abs(value) != float("inf"):
                _, factor, offset = self.file.sources.get(column, ("", 1.0, 0.0))
                turn = self.file.turns.get((self.line, column), 0.0)
                # Zero stays without a sign.
                return (
                    value
                    if (factor, offset, turn) == (1.0, 0.0, 0.0)
                    else (0.0 + factor * value + offset + turn)
                )
            self.refuse(column, f"{text} is too large to be a number here", "Check its exponent.")
        remedy = number_remedy(text) or "Write a number, such as 2.5."
        if blank_where and not number_remedy(text):
            remedy = f"Write a number, or leave the cell blank where {blank_where}."
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
            remedy = "Write a number in every row, also where cells were merged: 0 if it is zero."
            self.refuse(column, "the cell is blank", remedy)
        return value

    def refuse(self, column: str, why: str, remedy: str) -> NoReturn:
        """Raise the error about a cell of this row."""
        self.file.refuse(
            self.line, self.file.sources.get(column, (column, 1.0, 0.0))[0], why, remedy
        )


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
    close = closest(name, known)
    found = LIGAMENT_FORCE.fullmatch(name)
    if found and name.lower() != close.lower():
        own, factor = f"{found[1]}_tension_N", 1000 if found[2] else 1
        return (
            f"A ligament's tension is read from the columns {own} and sd_{own}. For the first, "
            f"begin the file: # column: {own} = {factor} * {name}"
        )
    if re.match(r"t(ime)?($|[_\W])", name, re.IGNORECASE):
        return f"To read a series, write with the factor to seconds: # column: {TIME} = 1 * {name}"
    if not close:
        return f"{remedy} To read it as one of them, begin the file: # column: ONE = 1 * {name}"
    if not quantity or close.rpartition("_")[0] != quantity:
        return remedy
    return f"{remedy} If so, convert its values to that unit."


TIME = "time_s"
# A column named after a ligament, whose name has at least two capitals as in ACL or dMCL.
LIGAMENT_FORCE = re.compile(r"(\w*[A-Z]\w*[A-Z]\w*?)[._](?i:tension|force|load)(?:[._](k?)N)?")
LEVELS = (50.0, 100.0)  # % of the load that every ramp reaches
# A load reverses where it goes back by this share of its range; less is sensor noise.
TURN = 0.2
# Two loads are ramped if the second changes by this share of the first, both relative to `TYPICAL`.
SECOND = 0.5
# A load that varies by less than this share of `TYPICAL` is held.
HELD = 0.2
# Flexion that changes more than this while loads are held may be in radians.
MAY_BE_RADIANS = 0.1
# Least standard deviation of a loading curve: no sensor resolves less [mm, deg].
LEAST_SD = 1e-3


def mean_curves(
    path: Path,
    ramps: Sequence[str],
    samples: Array,
    levels: Sequence[float] = LEVELS,
    angles: Sequence[float] = (),
) -> tuple[tuple[str, ...], Array]:
    """Trials of a laxity table from samples over time: their names and rows.

    The load of a ramp that changes most is the one that it is about; where loads are held and the
    knee is flexed, flexion takes its place, and a row is one of `angles`. Each way that it
    goes, up or down, crosses a level of it once: a row has the mean of all crossings. Its standard
    deviations are the spread of the crossings about these means, over all levels of the ramp, so
    that half a loop's width and what differs from one cycle to the next are errors. A ramp that
    crosses each level once has those of the others.

    Parameters
    ----------
    path
        The file, for messages.
    ramps
        The ramp that each sample belongs to.
    samples
        Time, flexion, loads and coordinates, shape ``(n, 12)``; NaN where not measured.
    levels
        Levels of the load [% of what every cycle reaches].
    angles
        Flexion angles at which a ramp of flexion is read [deg]; every 15 deg where there are none.

    Returns
    -------
    names, rows
        The trials, and flexion, loads, coordinates and standard deviations, shape ``(k, 16)``; NaN
        where no ramp crosses a level twice.

    Raises
    ------
    InputError
        If time goes back, no load of a ramp is ramped or two are, or flexion changes with a load.
    """
    names: list[str] = []
    rows: list[Array] = []
    spreads: list[Array] = []
    for ramp in dict.fromkeys(ramps):
        own = samples[[i for i, x in enumerate(ramps) if x == ramp]]
        axis = _ramp_load(path, ramp, own)
        if axis is None:
            crossed = _crossed_angles(path, ramp, own[:, 1:], angles)
        else:
            crossed = _crossings(own[:, 1:], axis, levels)
        deviations = [x - x.mean(axis=0) for _, x in crossed]
        n_free = sum(len(x) - 1 for x in deviations)
        squares = sum((x**2).sum(axis=0) for x in deviations)
        for load, values in crossed:
            rows.append(values.mean(axis=0))
            rows[-1][0 if axis is None else 1 + axis] = load
            way = "flexion" if axis is None else WAYS[axis][0 if load > 0.0 else 1]
            names.append(f"{ramp}_{way}{load if axis is None else abs(load):.3g}")
        spreads += [squares / n_free if n_free else np.full(11, np.nan)] * len(crossed)
    variance = np.array(spreads)[:, 6:]
    has_one = np.asarray(np.isfinite(variance).any(axis=1))
    typical = variance[has_one].mean(axis=0) if has_one.any() else np.nan
    sd = np.sqrt(np.where(has_one[:, None], variance, typical))
    return tuple(names), np.hstack([rows, np.maximum(sd, LEAST_SD)])


def is_held(samples: Array) -> bool:
    """Whether loads are held in these samples of a ramp while the knee is flexed."""
    # Percentiles, because a rig may let a held load stray for a moment.
    low, high = np.percentile(samples[:, 2:7], (5.0, 95.0), axis=0)
    is_still = np.all((high - low) / TYPICAL < HELD)
    return bool(is_still and np.ptp(samples[:, 1]) > SAME_FLEXION_DEG)


def _crossed_angles(
    path: Path, ramp: str, values: Array, angles: Sequence[float]
) -> list[tuple[float, Array]]:
    """Each flexion angle of a ramp of flexion, and the values where it is crossed."""
    flexion = values[:, 0]
    wanted = angles or default_angles(float(flexion.min()), float(flexion.max()))
    ends = _turning_points(flexion)
    found = [(x, _crossed(values, 0, x, ends)) for x in wanted]
    reached = [(x, np.array(rows)) for x, rows in found if rows]
    if not reached:
        why = f"flexion goes from {flexion.min():.3g} to {flexion.max():.3g} deg"
        raise InputError(path, f"ramp {ramp}", why, "State angles between them: # angles: 30, 60.")
    return reached


def _ramp_load(path: Path, ramp: str, samples: Array) -> int | None:
    """Index of the load that varies in a ramp; None where flexion does and loads are held."""
    where = f"ramp {ramp}"
    if (np.diff(samples[:, 0]) < 0.0).any():
        why, remedy = "time goes back", "Give each ramp a name of its own in a column trial."
        raise InputError(path, where, why, remedy)
    if is_held(samples):
        return None
    changes = np.ptp(samples[:, 1:7], axis=0)
    if changes[0] > SAME_FLEXION_DEG:
        why = f"flexion changes by {changes[0]:.1f} deg while a load changes"
        remedy = (
            "Give each angle, or each load that is held while flexing, a name in a column trial."
        )
        raise InputError(path, where, why, remedy)
    shares = changes[1:] / TYPICAL
    second, first = (int(x) for x in np.argsort(shares)[-2:])
    if shares[first] < STRAY:
        why = f"no load changes by more than {100 * STRAY:.0f} % of a usual test's"
        remedy = "Give the samples while a load grows."
        if changes[0] > MAY_BE_RADIANS:
            why += f", and flexion by {changes[0]:.2g} deg"
            remedy += (
                " If flexion is in radians, write: # column: flexion_deg = 57.29578 * ITS_NAME."
            )
        raise InputError(path, where, why, remedy)
    if shares[second] > SECOND * shares[first]:
        words = " and ".join(f"{DIRECTIONS[x][0]} ({changes[1 + x]:.3g})" for x in (first, second))
        why, remedy = f"two loads change: {words}", "Name each load's ramp in a column trial."
        raise InputError(path, where, why, remedy)
    return first


def _crossings(values: Array, axis: int, levels: Sequence[float]) -> list[tuple[float, Array]]:
    """Each level of the load, and the values where it is crossed, one row a crossing."""
    load = values[:, 1 + axis]
    ends = _turning_points(load)
    found = []
    for sign in (-1.0, 1.0):
        farthest = sign * load[ends]
        top = farthest.max()
        if top < STRAY * np.ptp(load):
            continue
        reached = farthest[farthest > 0.5 * top].min()
        for level in levels:
            at = sign * reached * level / 100.0
            if rows := _crossed(values, 1 + axis, at, ends):
                found.append((at, np.array(rows)))
    return found


def _crossed(values: Array, column: int, at: float, ends: Sequence[int]) -> list[list[float]]:
    """The values where a column crosses a level, one row a crossing between two of its turns."""
    rows = []
    for i, j in itertools.pairwise(ends):
        first, last = sorted((values[i, column], values[j, column]))
        if not first <= at <= last:
            continue
        branch = values[i : j + 1]
        order = np.argsort(branch[:, column], kind="stable")
        along, columns = branch[order, column], branch[order].T
        known = ~np.isnan(columns)
        rows.append(
            [
                float(np.interp(at, along[is_there], x[is_there])) if is_there.any() else np.nan
                for x, is_there in zip(columns, known, strict=True)
            ]
        )
    return rows


def _turning_points(load: Array) -> list[int]:
    """Samples at which the load turns, the first and the last among them."""
    least = TURN * np.ptp(load)
    ends, low, high = [0], 0, 0
    way = 0
    for i, value in enumerate(load.tolist()):
        low, high = (i if value < load[low] else low), (i if value > load[high] else high)
        if way >= 0 and value < load[high] - least:
            ends += [high] if high > ends[-1] else []
            way, low, high = -1, i, i
        elif way <= 0 and value > load[low] + least:
            ends += [low] if low > ends[-1] else []
            way, low, high = 1, i, i
    last = low if way < 0 else high
    return [*ends, last] if last > ends[-1] else ends


# Five errors can share a correlation above -1/4 only: their covariance must stay positive.
CORRELATION_LIMITS = (-0.25, 1.0)
STATEMENT = re.compile(
    r"(within_trial_correlation|zero|column|levels|angles|translations)\s*:\s*(.*)", re.IGNORECASE
)


# Statements that change what numbers mean, and their usual words.
MEANINGS: Mapping[str, Sequence[str]] = {
    "translations": DEFINITIONS,
    "zero": ZEROS,
    "within_trial_correlation": (),
}
ALMOST = re.compile(r"(\w+)\s*([:=]?)\s*(?:(?:as|are|is)\s+)?(.*)")


def correlation_fault(value: float) -> tuple[str, str] | None:
    """What is wrong with a within-trial correlation, and its remedy; None if all is well."""
    low, high = CORRELATION_LIMITS
    if low < value < high:
        return None
    why = f"the within-trial correlation is {value:g}"
    return why, f"It must lie above {low:g} and below {high:g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Statements:
    """What the comment lines of a table say.

    Attributes
    ----------
    comments
        Those that state nothing.
    correlation
        Within-trial correlation of the errors.
    zero
        What coordinates are counted from.
    translations
        Definition of the translations.
    is_definition_stated
        Whether the file says it.
    """

    comments: tuple[str, ...]
    correlation: float
    zero: str
    translations: Translations
    is_definition_stated: bool


def statements(file: CellFile, protocol: Protocol, coordinates: Array) -> Statements:
    """What the comment lines of a table say, checked against its coordinates."""
    free: list[str] = []
    stated: dict[str, str] = {
        "within_trial_correlation": "0",
        "zero": "absolute",
        "translations": COMPONENTS,
    }
    lines: dict[str, int] = {}
    for line, text in file.comments:
        found = STATEMENT.fullmatch(text)
        if found is None:
            _check_no_statement(file, line, text)
            free.append(text)
            continue
        if found[1].lower() in {"column", "levels", "angles"}:
            continue
        # A spreadsheet pads every line with separators.
        name, value = found[1].lower(), found[2].rstrip(",; ")
        if name in lines:
            file.refuse(
                line, "", f"{name} is stated in {file.place(lines[name])} too", "Remove one."
            )
        lines[name], stated[name] = line, value
    try:
        correlation = float(stated["within_trial_correlation"])
    except ValueError:
        correlation = math.nan
    if fault := correlation_fault(correlation):
        file.refuse(lines["within_trial_correlation"], "", fault[0], f"{fault[1]}.")
    word = stated["zero"].lower()
    zero = word if word in ZEROS else stated["zero"]
    if fault := zero_fault(zero, protocol, coordinates):
        file.refuse(lines["zero"], "", fault[0], f"{fault[1]}.")
    return Statements(
        comments=tuple(free),
        correlation=correlation,
        zero=zero,
        translations=_translations(file, stated["translations"], lines, zero),
        is_definition_stated="translations" in lines,
    )


def _check_no_statement(file: CellFile, line: int, text: str) -> None:
    """Refuse a comment that looks like a statement about the numbers, and would not be read."""
    found = ALMOST.match(text)
    name = "" if found is None else statement_near(found[1], MEANINGS)
    if found is None or not name:
        return
    _, sign, value = found.groups()
    if sign or value.partition(" ")[0].rstrip(",;.").lower() in MEANINGS[name]:
        file.refuse(line, "", f"{text!r} states nothing", f"Write: # {name}: {value}.")


def _translations(file: CellFile, stated: str, lines: Mapping[str, int], zero: str) -> Translations:
    line = lines.get("translations", 0)
    found = next((x for x in DEFINITIONS if x == stated.lower()), None)
    if found is None:
        words = ", ".join(DEFINITIONS)
        file.refuse(
            line, "", f"{stated!r} is not a definition of translations", f"Choose one of {words}."
        )
    if found != COMPONENTS and zero != ABSOLUTE:
        why = f"translations as {found} can be read only where coordinates are absolute"
        file.refuse(line, "", why, f"The table counts them from {zero}: convert them before.")
    return found


def levels(file: CellFile) -> tuple[float, ...]:
    """Levels of the load at which loading curves are read [% of what every cycle reaches]."""
    remedy = "Write percentages above 0, such as: # levels: 50, 100."
    known = _stated_numbers(file, "levels", (1e-9, 100.0), "are not levels of a load", remedy)
    return known or LEVELS


def angles(file: CellFile) -> tuple[float, ...]:
    """Flexion angles at which a ramp of flexion is read [deg]; none where the file states none."""
    remedy = "Write degrees, such as: # angles: 0, 30, 60, 90."
    return _stated_numbers(file, "angles", FLEXION_LIMITS_DEG, "are not flexion angles", remedy)


def _stated_numbers(
    file: CellFile, name: str, limits: tuple[float, float], why: str, remedy: str
) -> tuple[float, ...]:
    """The numbers that a comment line states, each once; none where there is no such line."""
    for line, text in file.comments:
        said, _, words = text.partition(":")
        if said.strip().lower() == name:
            numbers = [x for x in re.split(r"[,;%\s]+", words) if x]
            known = tuple(float(x) for x in numbers if NUMBER.fullmatch(x))
            if (
                known
                and len(known) == len(numbers)
                and limits[0] <= min(known) <= max(known) <= limits[1]
            ):
                return tuple(dict.fromkeys(known))
            file.refuse(line, "", f"{words.strip()!r} {why}", remedy)
    return ()


SUFFIXES, MOTION, END = (".sto", ".mot"), ".mot", "endheader"
COUNTED_BY, NOT_SAID = "inDegrees", "no line inDegrees states the unit of angles"
# A factor that turns radians into degrees, to the digits that people write.
IN_DEGREES = (57.2, 57.4)
_STATED = re.compile(r"(\w+)[ \t=]+(.*)")


@unique
class Counted(Enum):
    """Unit of the angles of a storage, and whether its head states it."""

    DEGREES = "degrees"
    RADIANS = "radians"
    # No line says so, and OpenSim takes them for radians.
    RADIANS_UNSAID = "radians unsaid"
    # OpenSim takes them for degrees whatever the line says.
    CONTRADICTED = "contradicted"


def as_csv(file: TextIO, path: Path) -> str:
    """An OpenSim storage with its head as comments, line by line; cells that say nan are blank.

    Raises
    ------
    InputError
        If nothing ends its head.
    """
    lines, is_head = [], True
    for line in file:
        words = ["" if x.lower() == "nan" else x for x in line.split()]
        lines.append(f"# {line.strip().lstrip('# ')}" if is_head else "\t".join(words))
        is_head = is_head and line.strip().lower() != END
    if is_head:
        why = f"no line {END} ends its head"
        raise InputError(path, "", why, f"Write {END} on a line above the column names.")
    return "\n".join(lines)


def counted(head: Iterable[str], suffix: str) -> Counted:
    """How OpenSim counts the angles of a storage with these lines of its head.

    As OpenSim 4 reads them: ``inDegrees`` with ``yes`` or ``y`` states degrees and with any other
    word radians, and where it is missing angles are radians. Of old files, without a version, the
    head may say "Angles are in degrees.", and those called ``.mot`` have degrees whatever they say.

    Examples
    --------
    >>> counted(["version=1", "inDegrees=yes"], ".sto").value, counted([], ".mot").value
    ('degrees', 'degrees')
    >>> counted(["version=1"], ".mot").value
    'radians unsaid'
    """
    lines = [x.strip() for x in head]
    stated = {found[1]: found[2].strip() for x in lines if (found := _STATED.fullmatch(x))}
    word = stated.get(COUNTED_BY)
    is_old = re.match(r"[1-9]", stated.get("version", "0")) is None
    said = None if word is None else word.lower() in {"yes", "y"}
    if is_old and suffix.lower() == MOTION:
        return Counted.CONTRADICTED if said is False else Counted.DEGREES
    if is_old and said is None:
        words = {"Angles are in degrees.": True, "Angles are in radians.": False}
        said = next((words[x] for x in lines if x in words), None)
    if said is None:
        return Counted.RADIANS_UNSAID
    return Counted.DEGREES if said else Counted.RADIANS


WHOLE_TURN, STRAIGHT = 360.0, 180.0
# Larger angles of a knee are unlikely: a whole turn is taken off them.
LIKELY_DEG = 90.0
# Angles that are all beyond this, positive and negative ones, lie around half a turn.
NEAR_HALF = 150.0


def flexion_turns(values: Array) -> Array:
    """Turns to add to flexion angles [deg]: a whole one where only that gives a possible angle.

    Examples
    --------
    >>> flexion_turns(np.array([357.0, 2.0, 90.0, 200.0])).tolist()
    [-360.0, 0.0, 0.0, 0.0]
    """
    low, high = FLEXION_LIMITS_DEG
    turns = np.zeros(len(values))
    for turn in (-WHOLE_TURN, WHOLE_TURN):
        is_meant = (values + turn >= low) & (values + turn <= high)
        turns[is_meant & ~((values >= low) & (values <= high))] = turn
    return turns


def is_from_straight(values: Array) -> bool:
    """Whether flexion angles [deg] are counted from a straight knee at 180 deg.

    All of them are possible if counted so, and some are impossible otherwise.

    Examples
    --------
    >>> is_from_straight(np.array([178.0, 150.0, -176.0])), is_from_straight(np.array([2.0, 170.0]))
    (True, False)
    """
    known = values[~np.isnan(values)]
    low, high = FLEXION_LIMITS_DEG
    counted = STRAIGHT - known % WHOLE_TURN
    turned = known + flexion_turns(known)
    beyond = (turned < low) | (turned > high)
    return bool(beyond.any() and np.all((counted >= low) & (counted <= high)))


def is_negative(values: Array) -> bool:
    """Whether flexion angles [deg] grow towards negative values.

    All of them are possible if counted so, and some are impossible otherwise.

    Examples
    --------
    >>> is_negative(np.array([2.0, -30.0, -90.0])), is_negative(np.array([-30.0, 60.0]))
    (True, False)
    """
    known = values[~np.isnan(values)]
    low, high = FLEXION_LIMITS_DEG
    turned = known + flexion_turns(known)
    return bool((turned < low).any() and np.all((-turned >= low) & (-turned <= high)))


def coordinate_turns(values: Array) -> Array:
    """Turns to add to the values of an angle [deg], so that the column has no jump of a turn.

    Values beyond half a turn are turned back to what a knee may have. Where all are near half a
    turn, on either side of it, as changes from a zero can be, they are cut where the widest gap is.

    Examples
    --------
    >>> coordinate_turns(np.array([358.0, 3.0, 12.0])).tolist()
    [-360.0, 0.0, 0.0]
    >>> coordinate_turns(np.array([178.0, -179.0, -171.0])).tolist()
    [-360.0, 0.0, 0.0]
    >>> coordinate_turns(np.array([200.0, 12.0])).tolist()
    [0.0, 0.0]
    """
    none = np.zeros(len(values))
    known = values[~np.isnan(values)]
    half = WHOLE_TURN / 2.0
    is_within = np.abs(known) <= half
    is_split = bool(known.size) and np.abs(known).min() >= NEAR_HALF and np.ptp(known) > half
    if is_within.all() and not is_split:
        return none
    around = np.sort(known % WHOLE_TURN)
    gaps = np.diff(np.r_[around, around[0] + WHOLE_TURN])
    first = around[(int(np.argmax(gaps)) + 1) % len(around)]
    lifted = first + (known - first) % WHOLE_TURN
    lifted -= WHOLE_TURN * np.round(np.median(lifted) / WHOLE_TURN)
    turns = WHOLE_TURN * np.round((lifted - known) / WHOLE_TURN)
    turned = known + turns
    is_likely = bool(np.all(np.abs(turned[~is_within]) <= LIKELY_DEG))
    if np.ptp(turned) > half or not is_likely or np.abs(turns).max() > WHOLE_TURN:
        return none
    none[~np.isnan(values)] = turns
    return none


def default_angles(low: float, high: float, step: float = 15.0) -> tuple[float, ...]:
    """Flexion angles [deg] at which a ramp between two of them is read.

    Examples
    --------
    >>> default_angles(3.0, 62.0), default_angles(17.0, 25.0)
    ((15.0, 30.0, 45.0, 60.0), (21.0,))
    """
    first, last = int(np.ceil(low / step)), int(np.floor(high / step))
    found = tuple(step * k for k in range(first, last + 1))
    return found or ((low + high) / 2.0,)
