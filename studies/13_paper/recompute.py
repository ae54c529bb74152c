"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from compute import before_any_fit, one_course, one_way, small_errors, smallest_step

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    draws = record["head"]["settings"]["draws"]
    for name, part in record["knees"].items():
        yield f"{name}, before any fit", part["before_any_fit"], partial(before_any_fit, name)
        yield f"{name}, small errors", part["small_errors"], partial(small_errors, name, draws)
        yield f"{name}, one-way", part["one_way"], partial(one_way, name)
        yield f"{name}, smallest step", part["smallest_step"], partial(smallest_step, name)
        for start, rows in part["course"].items():
            for row in rows:
                entry = f"{name}, course from {start}, seed {row['seed']}"
                yield entry, row, partial(one_course, (name, start, row["seed"]))
