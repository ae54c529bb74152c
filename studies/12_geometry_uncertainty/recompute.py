"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import rounded, study_knee
from compute import DIGITS, replicate_row

import identknee as ik

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    for name, part in record["knees"].items():
        knee = study_knee(name)
        for row in part["fits"]:
            task = {key: row[key] for key in ("kind", "size", "replicate")}
            entry = f"{name}, {row['kind']} {row['size']:g}, replicate {row['replicate']}"
            yield entry, row, partial(fitted, knee, task)


def fitted(knee: ik.Knee, task: Row) -> Row:
    """One fit as the record keeps it."""
    row: Row = rounded(replicate_row(knee, task), DIGITS)
    return row
