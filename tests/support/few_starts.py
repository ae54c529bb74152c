"""Verbs that begin their searches at few points: for tests of what is made of a fit.

Whether it is the lowest is tested where the searches are.
"""

from typing import Any

import pytest

from identknee.calibrate.fit import Fit
from identknee.identify.optimum import REACH_OF_HOPS, with_fits_from
from identknee.runs.declare import Array

# Beside the first, and in each of as many rounds of hops.
FEW, FEW_ROUNDS = 2, 1


def use_few_starts(patch: pytest.MonkeyPatch) -> None:
    """Searches of verbs begin at three points in place of seventeen, and hop once."""
    for module in ("identify.optimum", "verbs.fit"):
        patch.setattr(f"identknee.{module}.with_fits_from", _with_few_fits)
    for module in ("identify.optimum", "diagnosis.base_fit"):
        patch.setattr(f"identknee.{module}.N_HOPS", FEW)
        patch.setattr(f"identknee.{module}.REACH_OF_HOPS", REACH_OF_HOPS[:FEW_ROUNDS])
    patch.setattr("identknee.diagnosis.base_fit.N_ELSEWHERE", FEW)
    patch.setattr("identknee.identify.profile.profile.N_STARTS", FEW)


def _with_few_fits(problem: Any, first: Fit, points: Array, **how: Any) -> tuple[Fit, ...]:
    return with_fits_from(problem, first, points[[0, -1]], **how)
