"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import study_knee
from compute import ODD_STUDY, as_it_is, diagnosed, fitted

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    seed = record["head"]["settings"]["seed"]
    for name, part in record["knees"].items():
        knee = study_knee(name)
        yield f"{name}, as it is", part["as_it_is"], partial(as_it_is, knee)
        if "fit" in part:
            yield f"{name}, fit", part["fit"], partial(fitted, knee, seed)
        for key, without in (("diagnoses", ""), ("without_odd_study", ODD_STUDY)):
            for row in part.get(key, ()):
                sd = row["assumed_sd"]
                entry = f"{name}, {key} at {'the printed sds' if sd is None else sd}"
                yield entry, row, partial(diagnosed, knee, sd, seed, without)
