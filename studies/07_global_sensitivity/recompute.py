"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from common.records import study_knee
from compute import OVER_POSTERIOR, SEED, outputs_of, posterior_draws, row_of

import identknee as ik
from identknee.identify.sensitivity import Method, sensitivity

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again.

    The analyses over the posterior; those over the box take many simulations more.
    """
    for name, part in record["knees"].items():
        knee = study_knee(name)
        for method in OVER_POSTERIOR:
            again = partial(analysed, knee, method, part["posterior"]["n"])
            yield f"{name}, {method}", part[method], again


def analysed(knee: ik.Knee, method: Method, n: int) -> Row:
    """One analysis of `n` draws of the posterior, as the record keeps it."""
    outputs = outputs_of(knee)
    draws = posterior_draws(outputs.model, outputs.free.fixed_values, n)
    return row_of(sensitivity(outputs, draws, method=method, seed=SEED), 0.0)
