"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from compute import case_row

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    for name, part in record["knees"].items():
        for row in part["cases"]:
            case = {key: row[key] for key in ("series", "effects", "wanted", "seed")}
            yield f"{name}, seed {row['seed']}", row, partial(case_row, case)
