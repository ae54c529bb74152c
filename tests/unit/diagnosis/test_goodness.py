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

from identknee.diagnosis.goodness import (
    Check,
    cauchy_combination,
    neighbours_on_curves,
    nested_check,
    omnibus_check,
    replicate_patterns,
    smooth_patterns,
    succession_check,
)
from identknee.diagnosis.projection import base_projector
from identknee.runs.arrays import Array

N_NULLS = 400
LEVEL = 0.05
BOUND = 4 * np.sqrt(LEVEL * (1 - LEVEL) / N_NULLS)
INVARIANT = 1e-9
FIT = linear_fit()
FLEXION, LOADS, CURVES = protocol()
NOISE = unit_noise()
SMOOTH = NOISE.whiten(smooth_patterns(LOADS, FLEXION, everything()))
WIDER = FIT.projector.with_columns(SMOOTH)
NEIGHBOURS = neighbours_on_curves(CURVES, everything())

CHECKS: dict[str, Callable[[Array], Check]] = {
    "omnibus": lambda r: omnibus_check(r, FIT.projector),
    "smooth": lambda r: nested_check(r, FIT.projector, WIDER),
    "smooth, noise unknown": lambda r: nested_check(r, FIT.projector, WIDER, noise_degrees=None),
    "succession": lambda r: succession_check(r, FIT.projector, NEIGHBOURS),
    "succession after smooth parameters": lambda r: succession_check(r, WIDER, NEIGHBOURS),
    "succession, noise unknown": lambda r: succession_check(
        r, FIT.projector, NEIGHBOURS, is_scale_known=False
    ),
}


@pytest.mark.parametrize("name", CHECKS)
def test_noise_alarms_as_often_as_stated(name: str) -> None:
    nulls = FIT.residuals(np.random.default_rng(1), N_NULLS)
    p_values = np.array([CHECKS[name](r).p_value for r in nulls])
    assert np.mean(p_values < LEVEL) == pytest.approx(LEVEL, abs=BOUND)
    assert np.mean(p_values) == pytest.approx(0.5, abs=4 / np.sqrt(12 * N_NULLS))


@pytest.mark.parametrize("name", [x for x in CHECKS if "unknown" in x])
def test_the_size_of_unknown_noise_does_not_matter(name: str) -> None:
    residuals = FIT.residuals(np.random.default_rng(2), 1)[0]
    one, other = CHECKS[name](residuals), CHECKS[name](3 * residuals)
    assert one.p_value == pytest.approx(other.p_value, rel=INVARIANT)


def misfit(size: float) -> Array:
    """Noise and an unlisted smooth misfit of internal rotation, whitened."""
    shape = np.zeros((63, 5))
    shape[:, 4] = size * np.abs(LOADS[:, 0] / 10) * FLEXION / 60
    noise = FIT.residuals(np.random.default_rng(3), 1)[0]
    return np.asarray(noise + FIT.projector.padded(NOISE.whiten(shape[everything()])))


def test_smooth_misfit_is_seen_by_what_is_made_for_it_first() -> None:
    """Small against all noise, large against that of smooth patterns and neighbours."""
    found = {name: check(misfit(3.0)).p_value for name, check in CHECKS.items()}
    assert found["smooth"] < 0.01 * found["omnibus"]
    assert max(found["smooth"], found["smooth, noise unknown"]) < 1e-3
    large = {name: check(misfit(10.0)).p_value for name, check in CHECKS.items()}
    assert large.pop("succession after smooth parameters") > LEVEL
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


def test_replicates_measure_the_noise_whatever_its_size() -> None:
    """Lack of fit against pure error, with the textbook's degrees of freedom."""
    generator = np.random.default_rng(6)
    group = np.repeat(np.arange(20), 3)
    measured = np.ones((60, 5), dtype=bool)
    projector = base_projector(generator.standard_normal((300, N_PARAMETERS)))
    columns = replicate_patterns(group, measured)
    wider = projector.with_columns(columns)
    assert columns.shape == (300, 100)
    nulls = 2.5 * generator.standard_normal((N_NULLS, 300))
    checks = [nested_check(noise, projector, wider, noise_degrees=None) for noise in nulls]
    # 100 means, 8 parameters that do not follow them: all 100 stay to be tested.
    assert checks[0].degrees_of_freedom == 100
    rate = np.mean([x.p_value < LEVEL for x in checks])
    assert rate == pytest.approx(LEVEL, abs=BOUND)
    lack = columns @ generator.normal(0, 3, 100) + 2.5 * generator.standard_normal(300)
    assert nested_check(lack, projector, wider, noise_degrees=None).p_value < 1e-4


def test_neighbours_pass_over_missing_values_and_share_unloaded_trials() -> None:
    assert len(NEIGHBOURS) == 6 * 10 * 5
    measured = everything()
    measured[CURVES[0].trials[3], 2] = False
    fewer = neighbours_on_curves(CURVES, measured)
    assert len(fewer) == len(NEIGHBOURS) - 1
    rows = np.full((63, 5), -1)
    rows[measured] = np.arange(314)
    left, right = rows[CURVES[0].trials[[2, 4]], 2]
    assert [left, right] in fewer.tolist()


def test_patterns_cover_smooth_misfit_of_any_load_and_no_missing_rows() -> None:
    """One constant and five shapes of each of two loads, three powers of flexion, five columns."""
    patterns = smooth_patterns(LOADS, FLEXION, everything())
    assert patterns.shape == (315, 11 * 3 * 5)
    assert smooth_patterns(LOADS[FLEXION == 0], np.zeros(21), everything()[:21]).shape == (
        105,
        11 * 5,
    )


def test_patterns_that_cannot_be_tested_are_refused() -> None:
    residuals = FIT.residuals(np.random.default_rng(8), 1)[0]
    with pytest.raises(ValueError, match="explain every pattern"):
        nested_check(residuals, WIDER, WIDER.with_columns(SMOOTH))
    everything_out = FIT.projector.with_columns(np.eye(len(residuals)))
    with pytest.raises(ValueError, match="leave no residuals"):
        nested_check(residuals, FIT.projector, everything_out, noise_degrees=None)


def test_combined_probabilities_hold_under_dependence() -> None:
    assert cauchy_combination([0.02, 0.02, 0.02]) == pytest.approx(0.02, rel=1e-12)
    assert cauchy_combination([1e-30, 0.5]) == pytest.approx(2e-30, rel=1e-6)
    assert cauchy_combination([0.0, 1.0]) < 1e-300
    nulls = FIT.residuals(np.random.default_rng(9), N_NULLS)
    names = ("omnibus", "smooth", "succession")
    combined = [cauchy_combination([CHECKS[x](r).p_value for x in names]) for r in nulls]
    assert np.mean(np.array(combined) < LEVEL) == pytest.approx(LEVEL, abs=BOUND)
