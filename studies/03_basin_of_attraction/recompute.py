"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from common.records import rounded, study_knee
from compute import PARTS, SEED, problem_of, starts_of

import identknee as ik
from identknee.calibrate.fit import fit

METHOD = "least-squares"
AT_TRUTH = 1e-3
Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again.

    Single searches by least squares that ended at the truth: where another one stops hangs on the
    last bits of its way, and one by Complex takes longer than all others together.
    """
    for name, part in record["knees"].items():
        knee = study_knee(name)
        problem = problem_of(knee)
        for wanted in (x for x in PARTS if x.method == METHOD):
            first = part["parts"][wanted.name]["first"]
            starts = starts_of(problem, wanted.design, wanted.numbers[name])
            for i, (end, kind) in enumerate(zip(first["ends"], first["kinds"], strict=True)):
                if not np.allclose(end, part["truth"], rtol=AT_TRUTH):
                    continue
                row = {"start": first["starts"][i], "end": end, "kind": kind}
                yield f"{name}, {wanted.name} {i}", row, partial(searched, problem, starts[i], i)


def searched(problem: ik.LaxityResiduals, start: ik.runs.Array, number: int) -> Row:
    """One search of a sweep."""
    end = fit(problem, start, method=METHOD, seed=ik.identify.search_seed(SEED, number))
    kind = ik.identify.classify_end(problem, end).value
    row: Row = rounded({"start": start, "end": end.theta, "kind": kind}, 5)
    return row
