"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from compute import plan_row

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again: closed intervals, one by one."""
    for name, part in record["knees"].items():
        for row in part["plans"]:
            for parameter, ends in row["ends"].items():
                if None not in ends:
                    yield (
                        f"{name}, {row['plan']}, {parameter}",
                        {"ends": ends},
                        partial(interval, {"knee": name, "plan": row["plan"]}, parameter),
                    )


def interval(task: Row, parameter: str) -> Row:
    """The ends of one interval."""
    return {"ends": plan_row(task, [parameter])["ends"][parameter]}
