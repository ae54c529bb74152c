"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import study_knee
from compute import RAMPS, all_vertices, one_ramp, seed63, table2

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    for name, part in record["knees"].items():
        knee = study_knee(name)
        yield f"{name}, Table 2", part["table2"], partial(table2, knee)
        yield f"{name}, 63 trials", part["seed63"], partial(seed63, knee)
        yield f"{name}, all vertices", part["contact_points"], partial(all_vertices, knee)
        for number, ramp in enumerate(part["ramps"]):
            task = (knee, ramp["flexion_deg"], *RAMPS[number % len(RAMPS)])
            yield f"{name}, ramp {number}", ramp, partial(one_ramp, task)
