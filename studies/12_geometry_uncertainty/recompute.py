"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import rounded, study_knee
from compute import DIGITS, replicate_row

import identknee as ik
from identknee.runs.record import Outcome

Row = dict[str, Any]
ENDS = {Outcome.MINIMUM.value, Outcome.START_FAILED.value}


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again.

    Fits that ended in a valley or at a cliff are left out: a processor's last bits say where.
    """
    for name, part in record["knees"].items():
        knee = study_knee(name)
        for row in part["fits"]:
            if row["outcome"] not in ENDS:
                continue
            task = {key: row[key] for key in ("kind", "size", "replicate")}
            entry = f"{name}, {row['kind']} {row['size']:g}, replicate {row['replicate']}"
            yield entry, row, partial(fitted, knee, task)


def fitted(knee: ik.Knee, task: Row) -> Row:
    """One fit as the record keeps it."""
    row: Row = rounded(replicate_row(knee, task), DIGITS)
    return row
