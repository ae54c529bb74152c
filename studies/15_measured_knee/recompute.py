"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import rounded
from compute import DIGITS, as_it_is

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again.

    Fits of a real table end in a valley, where the last bits of a processor decide: they are not
    among them.
    """
    for name, part in record["knees"].items():
        yield f"{name}, as it is", part["as_it_is"], partial(again, name)


def again(knee: str) -> Row:
    """The knee before any fit, as the record keeps it."""
    row: Row = rounded(as_it_is(knee), DIGITS)
    return row
