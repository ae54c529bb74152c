"""Verbs that begin their searches at few points: for tests of what is made of a fit.

Whether it is the lowest is tested where the searches are.
"""

from typing import Any

import pytest

from identknee.calibrate.fit import Fit
from identknee.identify.optimum import N_HOPS, N_STARTS, REACH_OF_HOPS, with_fits_from
from identknee.runs.arrays import Array

# Beside the first, and in each of as many rounds of hops.
FEW, FEW_ROUNDS = 2, 1


def use_few_starts(patch: pytest.MonkeyPatch) -> None:
    """Searches of verbs begin at three points in place of seventeen, and hop once."""
    _use(patch, _with_few_fits, FEW, FEW, FEW_ROUNDS)


def use_all_starts(patch: pytest.MonkeyPatch) -> None:
    """Searches of verbs begin where they do elsewhere."""
    _use(patch, with_fits_from, N_STARTS, N_HOPS, len(REACH_OF_HOPS))


def _with_few_fits(problem: Any, first: Fit, points: Array, **how: Any) -> tuple[Fit, ...]:
    return with_fits_from(problem, first, points[[0, -1]], **how)


def _use(patch: pytest.MonkeyPatch, search: Any, n: int, n_hops: int, n_rounds: int) -> None:
    for module in ("identify.optimum", "verbs.fit"):
        patch.setattr(f"identknee.{module}.with_fits_from", search)
    patch.setattr("identknee.identify.optimum.N_HOPS", n_hops)
    patch.setattr("identknee.identify.optimum.REACH_OF_HOPS", REACH_OF_HOPS[:n_rounds])
    patch.setattr("identknee.identify.profile.profile.N_STARTS", n)
