"""Each check alarms as often as stated under noise, and for the misfit it is made for."""

from collections.abc import Callable

import numpy as np
import pytest
from linear_data import (
    N_PARAMETERS,
    everything,
    linear_fit,
    protocol,
    unit_noise,
)

from identknee.diagnosis.misfit import (
    ResidualTest,
    cauchy_combination,
    nested_check,
    omnibus_check,
    process_check,
    process_errors,
    smooth_patterns,
)
from identknee.runs.declare import Array

N_NULLS = 400
LEVEL = 0.05
BOUND = 4 * np.sqrt(LEVEL * (1 - LEVEL) / N_NULLS)
INVARIANT = 1e-9
FIT = linear_fit()
FLEXION, LOADS, _ = protocol()
NOISE = unit_noise()
SMOOTH = NOISE.whiten(smooth_patterns(LOADS, FLEXION, everything()))
WIDER = FIT.projector.with_columns(SMOOTH)
ERRORS = process_errors(LOADS, FLEXION, everything(), np.ones(315))
WHITENED = FIT.projector.padded(NOISE.whiten(ERRORS))

CHECKS: dict[str, Callable[[Array], ResidualTest]] = {
    "omnibus": lambda r: omnibus_check(r, FIT.projector),
    "smooth": lambda r: nested_check(r, FIT.projector, WIDER),
    "process": lambda r: process_check(r, FIT.projector, WHITENED),
}


@pytest.mark.parametrize("name", CHECKS)
def test_noise_alarms_as_often_as_stated(name: str) -> None:
    nulls = FIT.residuals(np.random.default_rng(1), N_NULLS)
    p_values = np.array([CHECKS[name](r).p_value for r in nulls])
    assert np.mean(p_values < LEVEL) == pytest.approx(LEVEL, abs=BOUND)
    assert np.mean(p_values) == pytest.approx(0.5, abs=4 / np.sqrt(12 * N_NULLS))


def misfit(size: float) -> Array:
    """Noise and an unlisted smooth misfit of internal rotation, whitened."""
    shape = np.zeros((63, 5))
    shape[:, 4] = size * np.abs(LOADS[:, 0] / 10) * FLEXION / 60
    noise = FIT.residuals(np.random.default_rng(3), 1)[0]
    return np.asarray(noise + FIT.projector.padded(NOISE.whiten(shape[everything()])))


def test_smooth_misfit_is_seen_by_what_is_made_for_it_first() -> None:
    """Small against all noise, large against that of smooth patterns."""
    found = {name: check(misfit(3.0)).p_value for name, check in CHECKS.items()}
    assert found["smooth"] < 0.01 * found["omnibus"]
    assert found["smooth"] < 1e-3
    assert found["process"] < 0.1 * found["smooth"]
    large = {name: check(misfit(10.0)).p_value for name, check in CHECKS.items()}
    assert max(large.values()) < 1e-3


@pytest.mark.parametrize("name", CHECKS)
def test_which_near_equivalent_fit_was_found_does_not_matter(name: str) -> None:
    moved = FIT.jacobian @ np.random.default_rng(4).normal(0, 5, N_PARAMETERS)
    one, other = CHECKS[name](misfit(3.0)), CHECKS[name](misfit(3.0) + moved)
    assert one.p_value == pytest.approx(other.p_value, abs=INVARIANT)


def test_noise_estimated_from_few_values_alarms_as_often_as_stated() -> None:
    """A chi-square threshold would alarm in a third of such data sets."""
    generator = np.random.default_rng(5)
    degrees = 20
    sd = np.sqrt(generator.chisquare(degrees, N_NULLS) / degrees)
    nulls = FIT.residuals(generator, N_NULLS) / sd[:, None]
    rates = [
        np.mean([omnibus_check(r, FIT.projector, noise_degrees=x).p_value < LEVEL for r in nulls])
        for x in (degrees, np.inf)
    ]
    assert rates[0] == pytest.approx(LEVEL, abs=BOUND)
    assert rates[1] > 0.2


def test_patterns_cover_smooth_misfit_of_any_load_and_no_missing_rows() -> None:
    """One constant and five shapes of each of two loads, three powers of flexion, five columns."""
    patterns = smooth_patterns(LOADS, FLEXION, everything())
    assert patterns.shape == (315, 11 * 3 * 5)
    assert smooth_patterns(LOADS[FLEXION == 0], np.zeros(21), everything()[:21]).shape == (
        105,
        11 * 5,
    )


def covariance_of_processes(loads: Array, flexion: Array) -> Array:
    """By the definition, trial by trial."""
    whole = np.zeros((len(loads), len(loads)))
    along = flexion / np.ptp(flexion) / 2.0
    for load in loads.T[np.any(loads != 0, axis=0)]:
        scaled = np.c_[along, load / np.abs(load).max() / 0.5]
        apart = ((scaled[:, None] - scaled) ** 2).sum(axis=2)
        whole += np.exp(-0.5 * apart) * np.outer(load != 0, load != 0)
    return whole


def test_errors_of_smooth_processes_have_their_covariance() -> None:
    """A coordinate that was not measured has none, nor has a trial without load."""
    sd = np.random.default_rng(11).uniform(0.2, 0.5, 63 * 2)
    measured = np.zeros((63, 5), bool)
    measured[:, [1, 4]] = True
    errors = process_errors(LOADS, FLEXION, measured, sd)
    trial, coordinate = np.nonzero(measured)
    expected = covariance_of_processes(LOADS, FLEXION)[np.ix_(trial, trial)]
    expected = expected * np.outer(sd, sd) * (coordinate[:, None] == coordinate)
    assert errors @ errors.T == pytest.approx(expected, abs=1e-6)
    assert process_errors(0.0 * LOADS, FLEXION, measured, sd).shape == (126, 0)


@pytest.mark.slow
def test_errors_of_processes_at_many_places_are_those_at_few() -> None:
    """Twenty times as many loads, each a little different, add no error of a process."""
    generator = np.random.default_rng(12)
    flexion, loads = np.repeat(FLEXION, 20), np.repeat(LOADS, 20, axis=0)
    loads = loads * generator.uniform(0.5, 1.0, loads.shape)
    errors = process_errors(loads, flexion, np.ones((len(loads), 1), bool), np.ones(len(loads)))
    assert errors @ errors.T == pytest.approx(covariance_of_processes(loads, flexion), abs=1e-3)
    assert errors.shape[1] < 100


def test_what_parameters_explain_leaves_nothing_to_test() -> None:
    residuals = FIT.residuals(np.random.default_rng(8), 1)[0]
    explained = FIT.projector.with_columns(WHITENED)
    assert process_check(residuals, explained, WHITENED).p_value == 1.0


def test_patterns_that_cannot_be_tested_are_refused() -> None:
    residuals = FIT.residuals(np.random.default_rng(8), 1)[0]
    with pytest.raises(ValueError, match="every pattern"):
        nested_check(residuals, WIDER, WIDER.with_columns(SMOOTH))


def test_combined_probabilities_hold_under_dependence() -> None:
    assert cauchy_combination([0.02, 0.02, 0.02]) == pytest.approx(0.02, rel=1e-12)
    assert cauchy_combination([1e-30, 0.5]) == pytest.approx(2e-30, rel=1e-6, abs=0.0)
    assert cauchy_combination([0.0, 1.0]) < 1e-300
    nulls = FIT.residuals(np.random.default_rng(9), N_NULLS)
    combined = [cauchy_combination([check(r).p_value for check in CHECKS.values()]) for r in nulls]
    assert np.mean(np.array(combined) < LEVEL) == pytest.approx(LEVEL, abs=BOUND)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_small_probability_among_several_counts_as_often_as_was_looked(n: int) -> None:
    """Beside tests that say nothing (1/2, whose cotangent is zero) it is n times as probable."""
    assert cauchy_combination([1e-4, *(n - 1) * [0.5]]) == pytest.approx(n * 1e-4, rel=1e-3)
    assert cauchy_combination(n * [0.03]) == pytest.approx(0.03)
    exact = np.mean(1.0 / np.tan(np.pi * np.array([0.01, 0.9])))
    assert cauchy_combination([0.01, 0.9]) == pytest.approx(0.5 - np.arctan(exact) / np.pi)
