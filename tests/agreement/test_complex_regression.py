"""The Complex method from the paper's starts still ends where it did: one seed of ten."""

import pytest
from complex_errors import (
    IG4_LEAST_ERROR,
    IG4_RMSE,
    LARGEST_ERROR,
    LARGEST_RMSE,
    LARGEST_SHARE,
    RECOVERABLE,
    Run,
    complex_runs,
    values,
)
from knees import model
from slow_cases import some_slow

SEEDS = (0,)
# One seed scatters more than the ten that the limits were set for.
ROOM = 1.5
# Contact points, of 1,500: it is the search that is held to the limits.
N_POINTS = 120


def runs_from(start: str) -> list[Run]:
    return complex_runs(model("reference", N_POINTS), [start], SEEDS)


@pytest.mark.parametrize("start", some_slow(RECOVERABLE, RECOVERABLE[1:]))
def test_laxity_is_fitted_and_parameters_nearly_recovered(start: str) -> None:
    runs = runs_from(start)
    stiffness, strain = LARGEST_ERROR[start]
    assert values(runs, start, "kN").mean() <= ROOM * stiffness
    assert values(runs, start, "percent").mean() <= ROOM * strain
    for unit, largest in zip(("mm", "deg"), LARGEST_RMSE, strict=True):
        assert values(runs, start, unit).max() <= ROOM * largest
        # The first start fits well enough for the share to say nothing.
        if start != "IG1":
            share = values(runs, start, unit) / values(runs, start, f"start_{unit}")
            assert share.max() <= ROOM * LARGEST_SHARE


@pytest.mark.slow
def test_from_the_far_start_the_laxity_fits_and_the_parameters_do_not() -> None:
    runs = runs_from("IG4")
    assert values(runs, "IG4", "mm").max() <= ROOM * IG4_RMSE[0]
    assert values(runs, "IG4", "deg").max() <= ROOM * IG4_RMSE[1]
    assert values(runs, "IG4", "kN").min() >= IG4_LEAST_ERROR / ROOM
