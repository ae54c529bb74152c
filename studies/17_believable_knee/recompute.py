"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from common.records import rounded
from compute import DIGITS, LIMITS, VARIANTS, at_fit, ended, knee_of, table

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again: each fit at its parameters."""
    for knee, part in record["knees"].items():
        parts = ("fits", "structures", "without_limits", "structures_unknown")
        for row in (x for name in parts for x in part[name]):
            variant, structure = row.get("variant", LIMITS), row.get("structure", "")
            task = {"knee": knee, "variant": variant, "structure": structure}
            again = partial(fit_again, task, row["theta"])
            yield f"{knee}, {structure or variant}", {x: row[x] for x in COMPARED}, again


COMPARED = (
    "n_with_equilibrium",
    "chi_square",
    "terms",
    "rmse",
    "mean_contact_N",
    "forces_N",
    "contact_N",
    "largest_strain_pct",
    "implausible",
)


def fit_again(task: Row, theta: dict[str, float]) -> Row:
    """Deviance, errors, forces and contact at the parameters of a fit, without the search."""
    knee = knee_of(task["knee"], VARIANTS[task["variant"]], task["structure"])
    found = at_fit(ended(knee, table(), np.array(list(theta.values()))))
    row: Row = rounded({x: found[x] for x in COMPARED}, DIGITS)
    return row
