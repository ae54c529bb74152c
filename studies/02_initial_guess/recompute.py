"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from compute import branch_counts, fit_row, profile

import identknee as ik

METHOD = "least-squares"
Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again.

    Branches over 1,000 parameter sets take too long to be among them, and a search by Complex of
    an older build of the kernel need not be that of a newer one: it hangs on the last bits.
    """
    budget = record["head"]["settings"]["budget"]
    for name, part in record["knees"].items():
        yield f"{name}, profile", part["profile"], partial(profile, name)
        for row in part[METHOD]:
            task = {"knee": name, "method": METHOD, "budget": budget}
            task |= {key: row[key] for key in ("start", "seed")}
            yield f"{name}, from {row['start']}, seed {row['seed']}", row, partial(fit_row, task)
        ends = np.array([row["theta"] for row in part["complex"]])
        start = np.array(part["profile"]["starts"]["IG4"])[None]
        for where, thetas in (("IG4", start), ("ends of the Complex fits", ends)):
            counts = part["branches"][where]
            again = partial(branch_counts, name, thetas, ik.runs.serial)
            yield f"{name}, branches at {where}", counts, again
