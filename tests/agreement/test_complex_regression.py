"""The Complex method from the recoverable starts still ends where it did: two seeds of ten."""

import pytest
from complex_errors import (
    IG4_LEAST_ERROR,
    IG4_RMSE,
    LARGEST_ERROR,
    LARGEST_RMSE,
    LARGEST_SHARE,
    RECOVERABLE,
    STARTS,
    Run,
    complex_runs,
    values,
)
from knees import model

SEEDS = (0, 1)
# Two seeds scatter more than the ten that the limits were set for.
ROOM = 1.5


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return complex_runs(model("reference"), STARTS, SEEDS)


@pytest.mark.parametrize("start", RECOVERABLE)
def test_parameters_are_nearly_recovered(runs: list[Run], start: str) -> None:
    stiffness, strain = LARGEST_ERROR[start]
    assert values(runs, start, "kN").mean() <= ROOM * stiffness
    assert values(runs, start, "percent").mean() <= ROOM * strain


@pytest.mark.parametrize("start", RECOVERABLE)
def test_every_run_fits_the_laxity(runs: list[Run], start: str) -> None:
    assert values(runs, start, "mm").max() <= ROOM * LARGEST_RMSE[0]
    assert values(runs, start, "deg").max() <= ROOM * LARGEST_RMSE[1]


@pytest.mark.parametrize("start", ["IG2", "IG3"])
@pytest.mark.parametrize("unit", ["mm", "deg"])
def test_the_fit_is_much_better_than_its_start(runs: list[Run], start: str, unit: str) -> None:
    share = values(runs, start, unit) / values(runs, start, f"start_{unit}")
    assert share.max() <= ROOM * LARGEST_SHARE


def test_from_the_far_start_the_laxity_fits_and_the_parameters_do_not(runs: list[Run]) -> None:
    assert values(runs, "IG4", "mm").max() <= ROOM * IG4_RMSE[0]
    assert values(runs, "IG4", "deg").max() <= ROOM * IG4_RMSE[1]
    assert values(runs, "IG4", "kN").min() >= IG4_LEAST_ERROR / ROOM
