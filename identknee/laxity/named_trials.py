"""Laxity tables and trials by name: those that come with a subject, or a file."""

from pathlib import Path

from identknee.laxity.named_tables import TABLES
from identknee.laxity.protocol import BUILT_IN, Protocol, load_protocol
from identknee.laxity.table import Laxity, read_laxity
from identknee.laxity.table_file import OPENSIM
from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import PathLike

_TABLE_FILES = (".csv", *OPENSIM)

TrialsLike = Protocol | PathLike
"""A protocol, the name or file of one, or a laxity table whose trials are meant."""


def read_tests(given: TrialsLike) -> Protocol | Laxity:
    """The trials of a protocol or table, as a laxity table if they come from one.

    Parameters
    ----------
    given
        A protocol, the name of one (``"seed63"``), its TOML file, a laxity table (CSV), or the name
        of a subject that comes with measured laxity (``"s192803"``). The table need not hold any
        measured value.

    Raises
    ------
    InputError
        If there is nothing of this name, or the file breaks a rule.
    """
    if isinstance(given, Protocol):
        return given
    path = Path(given)
    if given in TABLES or path.suffix.lower() in _TABLE_FILES:
        return read_laxity(given, is_measured=False)
    if given not in BUILT_IN and path.suffix == "" and not path.exists():
        raise InputError(
            path,
            "",
            "there is no protocol and no file of this name",
            f"{suggestion(str(path), (*BUILT_IN, *TABLES))} "
            "Or give a protocol (TOML) or a laxity table (CSV).",
        )
    return load_protocol(given)


def read_trials(given: TrialsLike) -> Protocol:
    """The trials of a protocol or table; see `read_tests`.

    Examples
    --------
    >>> read_trials("drawer").n, read_trials("s192803").n
    (9, 25)
    """
    tests = read_tests(given)
    return tests.protocol if isinstance(tests, Laxity) else tests


def example_laxity(name: str) -> Laxity:
    """The measured laxity of a named subject, which comes with identknee.

    Parameters
    ----------
    name
        ``"s192803"``: 25 end points of a robotic knee simulator; ``"s192803_bundles"``, the same
        specimen, has the same table.

    Raises
    ------
    ValueError
        If there is no such table; the message lists them.

    Examples
    --------
    >>> example_laxity("s192803").n
    25
    """
    if name not in TABLES:
        raise ValueError(f"no laxity of {name!r} comes with identknee. {suggestion(name, TABLES)}")
    return read_laxity(name)
