"""Starts fill the bounds evenly, or stand at the distance that was asked."""

import numpy as np
import pytest
from problems import LIGAMENTS, REFERENCE, plain_parameters

from identknee.identify.sweep import (
    distance,
    distance_units,
    shell_starts,
    sobol_starts,
    unit_groups,
)
from identknee.model.parameters import Parameters, ligament_parameters

KNEE = ligament_parameters(LIGAMENTS, REFERENCE[:4].tolist(), REFERENCE[4:].tolist())
ROUNDING = 1e-12


def test_sobol_starts_fill_the_bounds_evenly() -> None:
    starts = sobol_starts(KNEE, 1024, seed=1)
    unit = (starts - KNEE.lower) / (KNEE.upper - KNEE.lower)
    # Each of 16 slices of a parameter holds a sixteenth of a scrambled net, exactly.
    for column in unit.T:
        assert np.all(np.histogram(column, 16, (0.0, 1.0))[0] == 64)


@pytest.mark.parametrize("n", [1, 5, 64])
def test_sobol_starts_stay_when_there_are_more(n: int) -> None:
    assert np.array_equal(sobol_starts(KNEE, n, seed=4), sobol_starts(KNEE, 200, seed=4)[:n])
    assert not np.array_equal(sobol_starts(KNEE, n, seed=5), sobol_starts(KNEE, n, seed=4))


def test_shells_have_the_distance_asked_in_every_unit() -> None:
    distances = [0.0, 0.5, 2.0]
    starts = shell_starts(KNEE, 60, center=REFERENCE, distances=distances, seed=2)
    away = np.abs(starts - REFERENCE)
    wanted = np.resize(distances, 60)
    assert np.allclose(away[:, :4].mean(axis=1), wanted, atol=ROUNDING)
    assert np.allclose(away[:, 4:].mean(axis=1), wanted, atol=ROUNDING)
    assert np.allclose(distance(starts, REFERENCE, KNEE), wanted, atol=ROUNDING)
    assert np.all((starts >= KNEE.lower) & (starts <= KNEE.upper))
    fewer = shell_starts(KNEE, 7, center=REFERENCE, distances=distances, seed=2)
    assert np.array_equal(fewer, starts[:7])


def test_the_papers_guesses_are_as_far_as_it_says() -> None:
    guess = np.array([8.0] * 4 + [4.0] * 4)
    # Table 1 of the paper: 3.6 kN and 3.5 %.
    assert distance(guess, REFERENCE, KNEE) == pytest.approx(3.575)


def test_parameters_of_other_units_count_in_typical_steps() -> None:
    mixed = Parameters(
        names=("A.stiffness_kN", "A.offset_mm"),
        center=np.array([10.0, 0.0]),
        lower=np.array([0.0, -50.0]),
        upper=np.array([40.0, 50.0]),
        prior_sd=np.array([0.35, 4.0]),
        is_log=np.array([True, False]),
    )
    assert distance_units(mixed).tolist() == [1.0, 4.0]
    assert unit_groups(mixed).tolist() == [0, 1]
    assert float(distance([11.0, 8.0], mixed.center, mixed)) == 2.0


def test_bounds_without_room_are_named() -> None:
    with pytest.raises(ValueError, match=r"x0\.value_pct.*x1\.value_pct.*\b9"):
        shell_starts(plain_parameters(2, -1.0, 1.0), 1, center=np.zeros(2), distances=[9.0])


def test_mistakes_are_named() -> None:
    with pytest.raises(ValueError, match=" 1, got 0"):
        sobol_starts(KNEE, 0)
    with pytest.raises(ValueError, match="0 or more"):
        shell_starts(KNEE, 3, center=REFERENCE, distances=[-1.0])
    open_ended = plain_parameters(1, -np.inf, 1.0)
    with pytest.raises(ValueError, match=r"x0\.value_pct.*finite"):
        sobol_starts(open_ended, 4)
