"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import rounded, study_knee
from compute import DIGITS, replicate_row, verdict_row

import identknee as ik

Row = dict[str, Any]
TASK = ("insertions_mm", "frames", "replicate")


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again.

    Those with exact insertions: over uncertain ones searches end on kinks of the model, where their
    number of simulations and the last digits hang on the processor and on what was computed before.
    """
    for name, part in record["knees"].items():
        knee = study_knee(name)
        for kind, make in (("fits", replicate_row), ("verdicts", verdict_row)):
            for row in (x for x in part[kind] if not x["insertions_mm"]):
                task = {key: row[key] for key in TASK}
                entry = f"{name}, {kind}, {', '.join(f'{x:g}' for x in task.values())}"
                yield entry, row, partial(made, make, knee, task)


def made(make: Callable[[ik.Knee, Row], Row], knee: ik.Knee, task: Row) -> Row:
    """One entry as the record keeps it."""
    row: Row = rounded(make(knee, task), DIGITS)
    return row
