"""Trials under equal loads measure the noise, whatever the model gets wrong."""

from dataclasses import replace

import numpy as np
import pytest

from identknee.checks.data_noise import DataNoise, NoiseSource, noise_of
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.laxity.table import Laxity
from identknee.runs.declare import Array

SD = np.array([0.4, 0.4, 0.4, 0.7, 0.7])
CORRELATION = 0.3
ROUNDING = 1e-9
# Of 4 standard errors one in 16,000 lies outside.
FAR = 4.0


def repeated(times: int) -> Protocol:
    """Nine trials at three flexion angles, each so many times."""
    whole = load_protocol("seed63")
    once = whole.select(np.flatnonzero(np.isin(whole.loads[:, 0], (-10.0, 10.0)))[:6])
    rows = np.repeat(np.arange(once.n), times)
    return Protocol(
        name="repeated",
        trials=tuple(f"{once.trials[i]} {k}" for k, i in enumerate(rows)),
        flexion_deg=once.flexion_deg[rows],
        loads=once.loads[rows],
    )


def measured(times: int, *, seed: int, stated: float | None = None) -> Laxity:
    """Noise around values that differ from one set of equal trials to the next by far more."""
    protocol, generator = repeated(times), np.random.default_rng(seed)
    n_sets = protocol.n // times
    means = np.repeat(generator.normal(0.0, 20.0, (n_sets, 5)), times, axis=0)
    shared = np.full((5, 5), CORRELATION) + (1.0 - CORRELATION) * np.eye(5)
    errors = SD * (generator.standard_normal((protocol.n, 5)) @ np.linalg.cholesky(shared).T)
    sd = None if stated is None else np.full((protocol.n, 5), stated) * SD
    return Laxity(protocol=protocol, coordinates=means + errors, sd=sd)


def found(laxity: Laxity, misfit: Array | float = 0.0) -> DataNoise:
    noise = noise_of(laxity, laxity.coordinates - misfit)
    assert noise is not None
    assert noise.source is NoiseSource.REPLICATES
    return noise


def test_its_size_is_found_within_its_standard_error() -> None:
    times, n_seeds = 4, 40
    noise = [found(measured(times, seed=seed)) for seed in range(n_seeds)]
    degrees = 6 * (times - 1)
    for columns, true in ((slice(0, 3), 0.4), (slice(3, 5), 0.7)):
        n = len(SD[columns])
        ratios = np.array([x.sd[0, columns][0] / true for x in noise])
        # Columns that share a correlation tell less than independent ones do.
        one = np.sqrt((1 + (n - 1) * CORRELATION**2) / (2 * n * degrees))
        assert ratios.mean() == pytest.approx(1.0, abs=FAR * one / np.sqrt(n_seeds))
        assert ratios.std(ddof=1) == pytest.approx(one, rel=FAR / np.sqrt(2 * (n_seeds - 1)))
    assert noise[0].degrees_of_freedom == 5 * degrees


def test_what_the_errors_of_a_trial_share_is_found_too() -> None:
    values = [found(measured(5, seed=seed)).correlation for seed in range(40)]
    # Of one correlation from 24 degrees; the mean of ten that hang together is no worse.
    one = (1 - CORRELATION**2) / np.sqrt(24)
    assert np.mean(values) == pytest.approx(CORRELATION, abs=FAR * one / np.sqrt(40))


def test_no_wrong_model_changes_it() -> None:
    """A model is wrong alike in trials under equal loads."""
    laxity = measured(4, seed=1)
    misfit = np.repeat(np.random.default_rng(2).normal(0.0, 30.0, (6, 5)), 4, axis=0)
    one, other = found(laxity), found(laxity, misfit)
    np.testing.assert_allclose(other.sd, one.sd, rtol=ROUNDING)
    assert other.correlation == pytest.approx(one.correlation, rel=ROUNDING)


def test_it_is_weighed_with_what_is_stated() -> None:
    silent = found(measured(4, seed=3))
    stated = found(measured(4, seed=3, stated=1.25))
    assert stated.factors is not None
    assert silent.sd[0, 0] < stated.sd[0, 0] < 1.25 * SD[0]
    assert stated.source is NoiseSource.REPLICATES
    assert f"{stated.factors[0]:.2f} and {stated.factors[1]:.2f} times" in stated.sentence
    # Five times too much cannot be meant.
    mistaken = found(measured(4, seed=3, stated=5.0))
    np.testing.assert_allclose(mistaken.sd, silent.sd, rtol=ROUNDING)


def test_few_replicates_show_nothing() -> None:
    laxity = measured(2, seed=4, stated=1.0)
    few = noise_of(laxity, laxity.coordinates)
    assert few is not None
    assert few.source is NoiseSource.STATED


def test_trials_of_loading_and_of_unloading_are_not_equal() -> None:
    laxity = measured(4, seed=5)
    phase = ("loading", "unloading") * (laxity.n // 2)
    shift = np.where(np.array(phase) == "loading", 3.0, 0.0)[:, None]
    told = replace(laxity, coordinates=laxity.coordinates + shift, phase=phase)
    assert found(told).sd[0, 0] == pytest.approx(SD[0], rel=0.5)


def test_blank_cells_and_columns_are_passed_over() -> None:
    laxity = measured(8, seed=6)
    coordinates = np.array(laxity.coordinates)
    coordinates[::5, 1] = np.nan
    coordinates[:, 4] = np.nan
    noise = found(replace(laxity, coordinates=coordinates))
    assert noise.sd[1, 3] == pytest.approx(SD[3], rel=0.5)
    assert np.isnan(noise.sd[:, 4]).all()
