"""The test of ranks, and replicates of a problem whose posterior is known to be right."""

import numpy as np
import pytest
from problems import Linear, plain_parameters
from sbc_replicates import N_DRAWS, ranked, simultaneous_level

MATRIX = np.array([[1.0, 0.5], [0.0, 0.8], [1.0, -1.0]])
PARAMETERS = plain_parameters(2, -50.0, 50.0)
REPLICATES = 24


def test_even_ranks_are_not_rare_and_uneven_ones_are() -> None:
    generator = np.random.default_rng(0)
    levels = [simultaneous_level(generator.integers(0, 101, 300), 100) for _ in range(20)]
    # Uniform if the band is exact: the mean of 20 has a standard error of 0.065.
    assert abs(np.mean(levels) - 0.5) < 5 * 0.065
    crowded = np.where(generator.uniform(size=300) < 0.2, generator.integers(0, 5, 300), 50)
    assert simultaneous_level(crowded, 100) < 1e-3
    narrow = generator.binomial(100, 0.5, size=300)
    assert simultaneous_level(narrow, 100) < 1e-3


def replicate(number: int, understated: float) -> np.ndarray:
    generator = np.random.default_rng(number)
    truth = 2.0 * generator.normal(size=2)
    data = MATRIX @ truth + generator.normal(size=3)
    problem = Linear(parameters=PARAMETERS, matrix=MATRIX * understated, data=data * understated)
    row = ranked(problem, truth, seed=number)
    assert row["n_simulations"] < 3000
    assert row["rhat"] <= 1.05
    return np.asarray(row["ranks"])


@pytest.mark.slow
def test_a_right_posterior_passes_and_an_understated_noise_does_not() -> None:
    for understated, is_right in ((1.0, True), (3.0, False)):
        ranks = np.array([replicate(i, understated) for i in range(REPLICATES)])
        assert ranks.max() <= N_DRAWS
        levels = [simultaneous_level(column, N_DRAWS) for column in ranks.T]
        assert (min(levels) > 0.05 / 2) is is_right
