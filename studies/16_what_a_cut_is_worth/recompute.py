"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from compute import plan_row

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    for name, part in record["knees"].items():
        for row in part["plans"]:
            yield (
                f"{name}, {row['plan']}",
                row,
                partial(plan_row, {"knee": name, "plan": row["plan"]}),
            )
