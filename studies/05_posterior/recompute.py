"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import rounded, study_knee
from compute import DIGITS, intervals, problem_of

import identknee as ik

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again.

    The samples themselves take too long.
    """
    for name, part in record["knees"].items():
        yield f"{name}, profiles", part["profiles"], partial(profiled, study_knee(name))


def profiled(knee: ik.Knee) -> Row:
    """Intervals as the record keeps them."""
    row: Row = rounded(intervals(problem_of(knee), ik.runs.serial), DIGITS)
    return row
