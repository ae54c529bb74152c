"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import laboratory
import slack_lengths
from common.records import BUNDLES
from compute import KNEES, MEASURED, plan_row

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again.

    Closed intervals of the knees with a capsule one by one, and each calibration, plan and
    single step of the other two.
    """
    for name in KNEES:
        for row in record["knees"][name]["plans"]:
            for parameter, ends in row["ends"].items():
                if None not in ends:
                    yield (
                        f"{name}, {row['plan']}, {parameter}",
                        {"ends": ends},
                        partial(interval, {"knee": name, "plan": row["plan"]}, parameter),
                    )
    for row in record["knees"][BUNDLES]["calibrations"]:
        task = {"seed": row["seed"], "way": row["way"]}
        yield (
            f"{BUNDLES}, {task['seed']}, {task['way']}",
            row,
            partial(slack_lengths.calibrated, task),
        )
    part = record["knees"][MEASURED]
    theta = part["found"]["theta"]
    for row in part["plans"]:
        task = {"plan": row["plan"], "theta": theta}
        yield f"{MEASURED}, {row['plan']}", row, partial(laboratory.plan_row, task)
    for step, row in zip(({}, *part["advice"]["steps"]), part["steps"], strict=True):
        task = {"step": step, "theta": theta}
        yield f"{MEASURED}, step {row['kind']}", row, partial(laboratory.step_row, task)


def interval(task: Row, parameter: str) -> Row:
    """The ends of one interval."""
    return {"ends": plan_row(task, [parameter])["ends"][parameter]}
