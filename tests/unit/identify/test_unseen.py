"""The unseen mass: estimated, and bounded more often than not too large."""

import numpy as np
import pytest

from identknee.identify.sweep import unseen_mass

REPLICATES = 400


def test_basins_seen_once_are_counted() -> None:
    found = unseen_mass(np.array([0, 0, 1, -1, 2, 0, 1, 3, -1]))
    assert (found.n, found.n_basins, found.n_once) == (7, 4, 2)
    assert found.estimate == pytest.approx(2 / 7)


def test_one_basin_leaves_the_rule_of_three() -> None:
    found = unseen_mass(np.zeros(10_000, int))
    assert found.estimate == 0.0
    assert found.upper == pytest.approx(1 - 0.025 ** (1 / 5000), rel=1e-6)
    assert found.upper < 0.01


def test_no_start_says_nothing() -> None:
    for labels in (np.array([-1, -1]), np.array([0])):
        assert unseen_mass(labels).upper == 1.0
    assert np.isnan(unseen_mass(np.array([-1])).estimate)


@pytest.mark.slow
def test_estimate_is_unbiased_and_limit_covers() -> None:
    """Two hundred basins whose volumes fall like 1/i, a hundred starts."""
    generator = np.random.default_rng(1)
    volumes = 1.0 / np.arange(1, 201)
    volumes /= volumes.sum()
    errors, covered = [], 0
    for _ in range(REPLICATES):
        labels = generator.choice(200, size=100, p=volumes)
        found = unseen_mass(labels)
        true = 1.0 - volumes[np.unique(labels)].sum()
        errors.append(found.estimate - true)
        covered += found.upper >= true
    # Good and Turing's estimate is that of one start fewer: its bias is below 1/n.
    standard_error = np.std(errors) / np.sqrt(REPLICATES)
    assert abs(np.mean(errors)) < 0.01 + 5 * standard_error
    assert covered >= 0.95 * REPLICATES
