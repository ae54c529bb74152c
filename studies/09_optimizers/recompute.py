"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import study_knee
from compute import problem_of, search_row, starts_of

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    budget = record["head"]["settings"]["budget"]
    for name, part in record["knees"].items():
        knee = study_knee(name)
        problem = problem_of(knee)
        names, starts = starts_of(problem, name, quick=False)
        for method, rows in part["methods"].items():
            for i, row in enumerate(rows):
                item = (i, names[i], starts[i].tolist())
                again = partial(search_row, problem, method, budget, item)
                yield f"{name}, {method} {i} from {names[i]}", row, again
