"""Statistics of chains against sequences whose autocorrelation is known, and against ArviZ."""

import emcee
import numpy as np
import pytest

from identknee.identify.posterior.posterior import (
    autocorrelation_time,
    bulk_ess,
    effective_draws,
    mean_error,
    normal_scores,
    quantile_error,
    split_rhat,
    tail_ess,
)
from identknee.runs.declare import Array

# Of tau from 4 x 16 walkers x 2,000 steps: sqrt(2 (2 M + 1) / N), M = 5 tau, five times.
TAU_ERROR = 0.2


def autoregressive(coefficient: float, shape: tuple[int, int, int], seed: int = 0) -> Array:
    """Sequences with autocorrelation ``coefficient ** lag``: tau = (1 + c) / (1 - c)."""
    generator = np.random.default_rng(seed)
    noise = generator.normal(size=shape)
    values = np.empty(shape)
    values[..., 0] = noise[..., 0]
    for step in range(1, shape[2]):
        values[..., step] = (
            coefficient * values[..., step - 1] + np.sqrt(1 - coefficient**2) * noise[..., step]
        )
    return values


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_a_known_sequence(coefficient: float) -> None:
    values = autoregressive(coefficient, (4, 16, 2000))
    expected = (1 + coefficient) / (1 - coefficient)
    assert autocorrelation_time(values) == pytest.approx(expected, rel=TAU_ERROR)
    assert effective_draws(values) == pytest.approx(values.size / expected, rel=TAU_ERROR)


def test_it_agrees_with_emcee() -> None:
    values = autoregressive(0.8, (1, 32, 4000), seed=3)
    theirs = emcee.autocorr.integrated_time(values[0].T[:, :, None], quiet=True)[0]
    # Theirs counts from the mean of each walker, which takes away about tau / steps.
    assert autocorrelation_time(values) == pytest.approx(theirs, rel=0.02)


def test_there_are_never_more_effective_draws_than_draws() -> None:
    alternating = np.tile([1.0, -1.0], (4, 8, 50))
    assert autocorrelation_time(alternating) == 1.0


def test_a_quantity_that_never_moves_has_no_effective_draws() -> None:
    constant = np.ones((4, 8, 50))
    assert autocorrelation_time(constant) == np.inf
    assert effective_draws(constant) == 0.0
    assert quantile_error(constant, 0.5) == np.inf


def test_walkers_that_keep_to_their_places_count_as_correlated() -> None:
    """Counted from each walker's own mean they would look independent."""
    generator = np.random.default_rng(5)
    values = generator.normal(size=(4, 16, 500)) + 10.0 * generator.normal(size=(4, 16, 1))
    assert autocorrelation_time(values) > 50.0


def test_rhat_sees_ensembles_at_different_places_and_of_different_spread() -> None:
    generator = np.random.default_rng(1)
    together = generator.normal(size=(4, 16, 500))
    assert split_rhat(together) < 1.001
    apart = together + np.array([0.0, 0.0, 0.0, 0.5])[:, None, None]
    assert split_rhat(apart) > 1.01
    wider = together * np.array([1.0, 1.0, 1.0, 2.0])[:, None, None]
    assert split_rhat(wider) > 1.01
    drifting = together + np.linspace(-0.5, 0.5, 500)
    assert split_rhat(drifting) > 1.01
    assert split_rhat(together[:, :, :1]) == np.inf


def number(found: object) -> float:
    """ArviZ 0.23 and 1.x wrap one number differently."""
    return float(np.ravel(np.asarray(found))[0])


def test_bulk_tail_and_rhat_agree_with_arviz_where_walkers_are_independent() -> None:
    """Then walkers may be called chains; ensembles of one walker are the same chains here."""
    arviz = pytest.importorskip("arviz")
    values = autoregressive(0.6, (8, 1, 4000), seed=7)
    chains = values[:, 0]
    assert bulk_ess(values).sum() == pytest.approx(number(arviz.ess(chains)), rel=0.1)
    theirs = number(arviz.ess(chains, method="tail", prob=(0.05, 0.95)))
    assert tail_ess(values).sum() == pytest.approx(theirs, rel=0.15)
    assert split_rhat(values) == pytest.approx(number(arviz.rhat(chains)), abs=1e-3)
    assert mean_error(values) * values.std() == pytest.approx(
        number(arviz.mcse(chains, method="mean")), rel=0.1
    )
    for probability in (0.025, 0.5, 0.975):
        theirs = number(arviz.mcse(chains, method="quantile", prob=probability))
        assert quantile_error(values, probability) == pytest.approx(theirs, rel=0.15)


def test_flattened_draws_would_hide_what_is_counted_here() -> None:
    """The measured trap: walkers in one row look independent because neighbours are."""
    values = autoregressive(0.95, (4, 16, 1000), seed=2)
    flattened = values.transpose(0, 2, 1).reshape(4, 1, -1)
    assert effective_draws(flattened) > 5 * effective_draws(values)


def test_rhat_sees_a_shift_of_heavy_tails_because_it_counts_ranks() -> None:
    """Of a Cauchy variable the variance is infinite, and plain R-hat sees no shift.

    The case for ranks of Vehtari et al. (2021), section 3: one ensemble of four lies elsewhere.
    """
    arviz = pytest.importorskip("arviz")
    generator = np.random.default_rng(3)
    values = generator.standard_cauchy((4, 1, 2000))
    assert split_rhat(values) < 1.005
    values[0] += 1.5
    within = values.var(axis=(1, 2), ddof=1).mean()
    plain = np.sqrt(1.0 + np.var(values.mean(axis=(1, 2)), ddof=1) / within)
    assert plain < 1.01
    assert split_rhat(values) > 1.03
    assert split_rhat(values) == pytest.approx(number(arviz.rhat(values[:, 0])), abs=1e-3)


def test_rhat_sees_heavy_tails_that_are_wider_by_folded_ranks() -> None:
    arviz = pytest.importorskip("arviz")
    generator = np.random.default_rng(4)
    values = generator.standard_cauchy((4, 1, 2000))
    values[0] *= 3.0
    assert split_rhat(values) > 1.05
    assert split_rhat(values) == pytest.approx(number(arviz.rhat(values[:, 0])), abs=1e-3)


def test_scores_of_ranks_are_those_of_blom() -> None:
    """The expected order statistics of normal draws, to a hundredth: (i - 3/8) / (n + 1/4)."""
    draws = np.random.default_rng(6).normal(size=(20_000, 12))
    expected = np.sort(draws, axis=1).mean(axis=0)
    values = np.array([7.0, 1.0, 3.0, 9.0, 0.5, 4.0, 6.0, 2.0, 8.0, 11.0, 10.0, 5.0])
    found = normal_scores(values.reshape(1, 2, 6)).ravel()
    np.testing.assert_allclose(np.sort(found), expected, atol=0.03)
    np.testing.assert_array_equal(np.argsort(found), np.argsort(values))
