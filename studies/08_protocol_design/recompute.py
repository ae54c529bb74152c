"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from compute import advice

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    for name, part in record["knees"].items():
        for made, found in part["made"].items():
            for criterion, row in found["advice"].items():
                again = partial(advice, ((name, made), criterion))
                yield f"{name}, {made}, {criterion}", row, again
