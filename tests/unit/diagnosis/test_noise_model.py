"""Whitening against its definition, and noise estimated from curves that a model misfits."""

import tracemalloc

import numpy as np
import pytest
from linear_data import everything, protocol, unit_noise
from tolerances import CLOSED_FORM

from identknee.checks.data_noise import Curve, estimate_correlation, estimate_scale
from identknee.diagnosis import noise_model
from identknee.diagnosis.noise_model import build_noise_model
from identknee.runs.declare import Array

N_DATA_SETS = 60
# Solving with a covariance of condition about 1e4 costs as many digits.
SOLVED = 1e-9


def errors(seed: int, correlation: float) -> Array:
    """Of 63 trials, unit variance."""
    shared = np.full((5, 5), correlation) + (1 - correlation) * np.eye(5)
    draws = np.random.default_rng(seed).standard_normal((63, 5))
    return np.asarray(draws @ np.linalg.cholesky(shared).T)


def misfit() -> Array:
    """Ten times the noise and alike in all coordinates, smooth along every curve."""
    flexion, loads, _ = protocol()
    along = loads.sum(axis=1) / 10
    shape = along - 0.5 * along**2 + 2 * along**3
    return np.asarray(10 * np.outer(shape * (1 + flexion / 60), np.ones(5)))


def test_whitened_errors_are_independent_with_variance_one() -> None:
    generator = np.random.default_rng(0)
    measured = generator.random((63, 5)) < 0.8
    sd = generator.uniform(0.1, 2.0, (63, 5))
    noise = build_noise_model(sd, measured, correlation=0.4)
    halfway = noise.whiten(noise.covariance)
    np.testing.assert_allclose(noise.whiten(halfway.T), np.eye(measured.sum()), atol=CLOSED_FORM)
    rows, columns = np.nonzero(measured)
    shared = noise.covariance / np.outer(sd[measured], sd[measured])
    expected = np.where(rows[:, None] == rows, 0.4, 0.0)
    expected[(rows[:, None] == rows) & (columns[:, None] == columns)] = 1.0
    np.testing.assert_allclose(shared, expected, atol=CLOSED_FORM)


def test_nuisances_in_the_covariance_are_nuisances_fitted_with_their_prior() -> None:
    generator = np.random.default_rng(1)
    nuisance, spread = generator.standard_normal((315, 40)), generator.uniform(0.1, 2.0, 40)
    values = generator.standard_normal(315)
    plain = unit_noise()
    whole = build_noise_model(
        np.ones((63, 5)), everything(), correlation=0.3, nuisance=nuisance, nuisance_sd=spread
    )
    rows = np.vstack([plain.whiten(nuisance), np.diag(1 / spread)])
    data = np.concatenate([plain.whiten(values), np.zeros(40)])
    fitted, *_ = np.linalg.lstsq(rows, data, rcond=None)
    least = np.sum((data - rows @ fitted) ** 2)
    assert np.sum(whole.whiten(values) ** 2) == pytest.approx(least, rel=SOLVED)


def test_further_values_are_whitened_given_the_others() -> None:
    generator = np.random.default_rng(4)
    nuisance, beside = generator.standard_normal((315, 20)), generator.standard_normal((7, 20))
    spread = generator.uniform(0.1, 2.0, 20)
    noise = build_noise_model(
        np.ones((63, 5)),
        everything(),
        correlation=0.3,
        nuisance=nuisance,
        nuisance_sd=spread,
        beside=beside,
    )
    common = np.vstack([nuisance, beside]) * spread
    covariance = common @ common.T
    covariance[:315, :315] = noise.covariance
    covariance[315:, 315:] += np.eye(7)
    table = noise.whiten(covariance[:315])
    rows = np.vstack([table, noise.whiten_beside(covariance[315:], table)])
    table = noise.whiten(rows.T[:315])
    whitened = np.vstack([table, noise.whiten_beside(rows.T[315:], table)])
    np.testing.assert_allclose(whitened, np.eye(322), atol=SOLVED)


@pytest.mark.parametrize("most", [1, 37, 100])
@pytest.mark.parametrize("n_nuisances", [0, 30])
def test_whitened_in_blocks_is_whitened_at_once(
    n_nuisances: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    generator = np.random.default_rng(2)
    measured = generator.random((63, 5)) < 0.8
    m = int(measured.sum())
    nuisance, spread = generator.standard_normal((m, n_nuisances)), np.full(n_nuisances, 0.1)
    values = generator.standard_normal((m, 3))
    monkeypatch.setattr(noise_model, "BLOCK", most)
    noise = build_noise_model(
        generator.uniform(0.5, 2.0, (63, 5)),
        measured,
        correlation=0.3,
        nuisance=nuisance,
        nuisance_sd=spread,
    )
    expected = np.linalg.solve(noise.factor, values)
    np.testing.assert_allclose(noise.whiten(values), expected, atol=CLOSED_FORM)
    np.testing.assert_allclose(noise.whiten(values[:, 0]), expected[:, 0], atol=CLOSED_FORM)
    np.testing.assert_allclose(noise.scale, np.diag(noise.factor), atol=CLOSED_FORM)
    some = generator.random(m) < 0.5
    among = np.linalg.cholesky(noise.covariance[np.ix_(some, some)])
    expected = np.linalg.solve(among, values[some])
    np.testing.assert_allclose(noise.of(some).whiten(values[some]), expected, atol=CLOSED_FORM)


def test_four_times_the_values_need_four_times_the_memory() -> None:
    peaks = []
    for n in (300, 1200):
        sd, nuisance = np.ones((n, 5)), np.random.default_rng(3).standard_normal((5 * n, 10))
        tracemalloc.start()
        noise = build_noise_model(
            sd, sd > 0.0, correlation=0.3, nuisance=nuisance, nuisance_sd=np.ones(10)
        )
        noise.whiten(nuisance)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # With the square of their number it were sixteen times.
    assert peaks[1] < 6.0 * peaks[0]


@pytest.mark.parametrize("truth", [0.0, 0.3, 0.6])
def test_correlation_is_found_under_misfit(truth: float) -> None:
    curves = protocol()[2]
    found = [
        estimate_correlation(errors(seed, truth) + misfit(), everything(), curves)
        for seed in range(N_DATA_SETS)
    ]
    # About 36 degrees of freedom and ten pairs: a data set is good to 0.08 or better.
    assert np.mean(np.array(found, dtype=float)) == pytest.approx(
        truth, abs=5 * 0.08 / np.sqrt(N_DATA_SETS)
    )


def test_correlation_does_not_need_the_right_size_of_the_noise() -> None:
    curves = protocol()[2]
    values, sizes = errors(3, 0.3) + misfit(), np.array([0.1, 1.0, 7.0, 2.0, 0.5])
    plain = estimate_correlation(values, everything(), curves)
    assert plain is not None
    scaled = estimate_correlation(values * sizes, everything(), curves)
    assert scaled == pytest.approx(plain, rel=SOLVED)


def test_short_curves_have_a_polynomial_of_lower_degree() -> None:
    """Five points leave room for a square; three are too few."""
    _, loads, curves = protocol()
    short = [Curve(trials=x.trials[::2][:5], load=x.load[::2][:5]) for x in curves]
    smooth = np.outer(10 * (loads.sum(axis=1) / 10) ** 2, np.ones(5))
    found = [
        estimate_correlation(errors(seed, 0.3) + smooth, everything(), short)
        for seed in range(N_DATA_SETS)
    ]
    assert np.mean(np.array(found, dtype=float)) == pytest.approx(
        0.3, abs=5 * 0.15 / np.sqrt(N_DATA_SETS)
    )
    shorter = [Curve(trials=x.trials[:3], load=x.load[:3]) for x in curves]
    assert estimate_correlation(errors(0, 0.3), everything(), shorter) is None


def test_missing_values_do_not_enter() -> None:
    curves = protocol()[2]
    measured = np.random.default_rng(5).random((63, 5)) < 0.85
    measured[:, 4] = False
    values = np.where(measured, errors(4, 0.3), np.nan)
    found = estimate_correlation(values, measured, curves)
    assert found is not None
    assert abs(found - 0.3) < 0.4
    scale = estimate_scale(values, measured, curves)
    assert scale is not None
    assert abs(np.log(scale.sd)) < 4 / np.sqrt(2 * scale.degrees_of_freedom)


def test_the_size_of_the_noise_is_found_under_misfit_and_outliers() -> None:
    curves = protocol()[2]
    found, degrees = [], 0.0
    for seed in range(N_DATA_SETS):
        values = 0.3 * errors(seed, 0.3) + misfit()
        values[seed, 0] += 30.0
        scale = estimate_scale(values, everything(), curves)
        assert scale is not None
        found.append(np.log(scale.sd / 0.3))
        degrees = scale.degrees_of_freedom
    assert degrees > 40
    # An outlier is on up to ten of the 210 contrasts, which moves their 68 % quantile by 5 %.
    assert abs(np.mean(found)) < 0.05 + 5 / np.sqrt(2 * degrees * N_DATA_SETS)


def test_the_degrees_of_freedom_are_those_of_the_spread_over_data_sets() -> None:
    curves, n = protocol()[2], 400
    scales = [estimate_scale(errors(seed, 0.0), everything(), curves) for seed in range(n)]
    logs = [np.log(x.sd) for x in scales if x is not None]
    degrees = scales[0].degrees_of_freedom if scales[0] is not None else np.nan
    # The variance over 400 data sets is good to 7 %; neighbouring contrasts hang together.
    assert 0.5 / np.var(logs) == pytest.approx(degrees, rel=0.35)


def test_too_few_points_give_no_size_of_the_noise() -> None:
    curve = protocol()[2][0]
    assert estimate_scale(errors(0, 0.0)[:, :2], everything()[:, :2], [curve]) is None


def test_wrong_settings_are_refused() -> None:
    sd = np.ones((63, 5))
    with pytest.raises(ValueError, match=r"correlation.* 1"):
        build_noise_model(sd, everything(), correlation=1.0)
    with pytest.raises(ValueError, match=r"deviation.* 0"):
        build_noise_model(0 * sd, everything(), correlation=0.0)
    with pytest.raises(ValueError, match="must increase"):
        Curve(trials=np.array([0, 1]), load=np.array([1.0, 1.0]))
