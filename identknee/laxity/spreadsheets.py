"""Traces of spreadsheets and other programs in a table, and the remedies that messages give.

Encodings, rows of units, numbers turned into dates, thousands separators, and radians said to be
degrees.
"""

import io
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from identknee.runs.declare import Array
from identknee.runs.errors import InputError

DEG = 57.29577951308232
# Protocols use multiples of STEP [deg]. Different angles that all lie within CLOSE of multiples are
# not there by chance. A single angle must lie within EXACTLY, rounding to 1e-4 rad.
STEP, CLOSE, EXACTLY = 5.0, 0.05, 0.003
# No knee flexes farther [deg].
FARTHEST = 165.0


def is_in_radians(values: Array) -> bool:
    """Whether flexion angles are round numbers of degrees written in radians.

    A single angle must agree to many digits, and must not be a round number as it is written.

    Examples
    --------
    >>> is_in_radians(np.array([0.0, 0.5236, 1.0472])), is_in_radians(np.array([0.0, 0.5, 1.0]))
    (True, False)
    >>> is_in_radians(np.array([0.43633, 0.43633])), is_in_radians(np.array([0.44, 0.44]))
    (True, False)
    """
    known = values[~np.isnan(values) & (values != 0.0)]
    turned = DEG * known
    if not turned.size or turned.min() < STEP / 2.0 or turned.max() > FARTHEST:
        return False
    step = np.round(turned / STEP)
    off = np.abs(turned - STEP * step)
    if len(np.unique(step)) > 1:
        return bool(np.all(off < CLOSE))
    is_round = np.abs(known - np.round(known, 2)) < 1e-3
    return bool(np.all(off < EXACTLY) and not is_round.any())


# First bytes of Excel workbooks, .xlsx and .xls.
WORKBOOK = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
# First bytes of packed files: gzip, bzip2, xz, zstandard and 7z.
PACKED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf")
# Byte-order marks of UTF-16; other text is read as UTF-8.
WIDE = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
LOOKED_AT = 512  # bytes
# Names of a column in which pandas or R number the rows; it may have none.
NAMELESS = re.compile(r"(Unnamed: \d+|index|level_0|rownames)?")
COUNT = re.compile(r"[0-9]+")
# Names of units in lower case, without brackets and without what multiplies factors, by the ending
# of column names.
UNITS = {
    "deg": ("deg", "degs", "degree", "degrees", "°", "º"),
    "mm": ("mm", "millimetre", "millimetres", "millimeter", "millimeters"),
    "Nm": ("nm",),
    "N": ("n", "newton", "newtons"),
    "s": ("s", "sec", "second", "seconds"),
}
OTHER_UNITS = frozenset(
    (
        *("rad", "radian", "radians", "m", "cm", "in", "inch", "inches", "µm", "um", "kn"),
        *("nmm", "ncm", "knm", "kgm", "kgfm", "kgcm", "kgfcm", "inlb", "inlbf", "lbin", "lbfin"),
        *("ftlb", "ftlbf", "lbft", "lbfft", "kg", "kgf", "kp", "lb", "lbs", "lbf"),
        *("ms", "min", "-", "1", ""),
    )
)
_TIMES = re.compile(r"(?<=\w)\s*[·⋅•×.*\s-]\s*(?=\w)")
# A number whose point or comma may be a decimal sign or a thousands separator.
THOUSAND = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}([ ,.'’\u00a0\u202f][0-9]{3})+([.,][0-9]+)?")
_DATE = re.compile(
    r"[0-9]{1,4}[-./ ]+([0-9]{1,2}|[^\W\d]{3,9}\.?)([-./ ]+[0-9]{2,4}.*)?"
    r"|[^\W\d]{3}\.?[- ][0-9]{1,4}"
)
_WITH_UNIT = re.compile(r"[+-]?[0-9.]+\s*(mm|deg|°|º|N|Nm|N·m|degrees)")
# Days since 1900, as a spreadsheet counts the dates of today.
DAYS = (30_000, 60_000)
A_DATE = "A spreadsheet may have made a date of it: enter it again, in a cell of numbers."
A_GAP = "If it stands for a missing value, leave the cell blank."


def is_code(value: float) -> bool:
    """Whether a value may stand for a missing one, such as -999."""
    digits = f"{abs(value):g}"
    return len(digits) > 1 and set(digits) == {"9"}


def opened_text(path: Path) -> TextIO:
    """The text of a table, open for reading in the encoding that its first bytes show.

    Raises
    ------
    InputError
        If it is a workbook, or packed.
    """
    with path.open("rb") as file:
        start = file.read(LOOKED_AT)
    if start.startswith(PACKED) or (path.suffix.lower() == ".zip" and start.startswith(WORKBOOK)):
        raise InputError(path, "", "this is a packed file, not a table of text", "Unpack it.")
    if start.startswith(WORKBOOK):
        why = "this is a workbook, not a table of text"
        raise InputError(path, "", why, "Save its sheet as CSV.")
    encoding = WIDE.get(start[:2], "utf-8-sig")
    if encoding != "utf-16":
        return path.open(encoding=encoding, newline="")
    try:
        return io.StringIO(path.read_bytes().decode(encoding), newline="")
    except UnicodeDecodeError as error:
        why = "the text is not the UTF-16 that it begins as"
        raise InputError(path, "", why, "Save the table as CSV in UTF-8.") from error


def unit_of(word: str) -> str | None:
    """The unit that a cell names, as column names spell it; None where it names no unit.

    A unit that no column has is returned in lower case, without what multiplies its factors.

    Examples
    --------
    >>> unit_of("[N·m]"), unit_of("(Degrees)"), unit_of("n.mm"), unit_of("varus")
    ('Nm', 'deg', 'nmm', None)
    """
    plain = _TIMES.sub("", _without_brackets(word).lower())
    for unit, names in UNITS.items():
        if plain in names:
            return unit
    return plain if plain in OTHER_UNITS else None


def _without_brackets(word: str) -> str:
    return word.strip().strip("[]()").strip()


def is_unit_row(cells: Sequence[str]) -> bool:
    """Whether the cells of a row name units and nothing else, the first aside.

    Examples
    --------
    >>> is_unit_row(["", "deg", "N", "mm"]), is_unit_row(["a", "0", "-", "mm"])
    (True, False)
    """
    units = [unit_of(x) for x in cells[1:]]
    return None not in units and sum(x in UNITS or x in ("rad", "m", "cm") for x in units) > 1


def wrong_unit(columns: Mapping[str, int], cells: Sequence[str]) -> tuple[str, str] | None:
    """A column whose unit in a row of units is not that of its name, and the cell; else None."""
    for name, place in columns.items():
        unit, own = unit_of(cells[place]), name.rpartition("_")[2]
        if own in UNITS and unit in {*UNITS, *OTHER_UNITS} - {"-", "1", "", own}:
            return name, _without_brackets(cells[place])
    return None


def number_remedy(text: str) -> str:
    """What to do about a cell that is nearly a number; empty where it is not.

    Examples
    --------
    >>> number_remedy("1 234.5")
    'Write it without a sign for thousands.'
    >>> number_remedy("1.5 deg")
    "Write the number alone: the unit is in the column's name."
    """
    if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", text):
        return "Write it with a decimal point."
    if re.fullmatch(r"[\u2212\u2012\u2013\u2014][0-9.]+", text):
        return "Write the minus sign as a plain hyphen."
    if _THOUSANDS.fullmatch(text):
        return "Write it without a sign for thousands."
    if _WITH_UNIT.fullmatch(text):
        return "Write the number alone: the unit is in the column's name."
    if _DATE.fullmatch(text):
        return A_DATE
    return ""


def is_day(value: float) -> bool:
    """Whether a value may be a day of our time, as a spreadsheet counts days.

    Examples
    --------
    >>> is_day(45323.0), is_day(453.23)
    (True, False)
    """
    return DAYS[0] <= value <= DAYS[1] and value == int(value)


def header_below(
    lines: Iterable[tuple[int, str]], known: Iterable[str], between: str
) -> int | None:
    """The line among the next few in which the column names stand; None where none has them."""
    names = set(known)
    for (line, text), _ in zip(lines, range(20), strict=False):
        cells = {x.strip().strip('"') for x in re.split(rf"[{re.escape(between)};\t]", text)}
        if len(cells & names) > 1:
            return line
    return None
