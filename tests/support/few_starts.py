"""Verbs that begin their searches at few points: for tests of what is made of a fit.

Whether it is the lowest is tested where the searches are.
"""

from typing import Any

import pytest

from identknee.calibrate.fit import Fit
from identknee.identify.optimum import N_STARTS, with_fits_from
from identknee.runs.arrays import Array

# Beside the first.
FEW = 2


def use_few_starts(patch: pytest.MonkeyPatch) -> None:
    """Searches of verbs begin at three points in place of seventeen."""
    _use(patch, _with_few_fits, FEW)


def use_all_starts(patch: pytest.MonkeyPatch) -> None:
    """Searches of verbs begin where they do elsewhere."""
    _use(patch, with_fits_from, N_STARTS)


def _with_few_fits(problem: Any, first: Fit, points: Array, **how: Any) -> tuple[Fit, ...]:
    return with_fits_from(problem, first, points[[0, -1]], **how)


def _use(patch: pytest.MonkeyPatch, search: Any, n: int) -> None:
    for module in ("identify.optimum", "verbs.fit"):
        patch.setattr(f"identknee.{module}.with_fits_from", search)
    patch.setattr("identknee.identify.profile.profile.N_STARTS", n)
