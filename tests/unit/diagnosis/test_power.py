"""The power the test claims is the power it has."""

import numpy as np
import pytest
from linear_data import library, linear_fit, signature
from scipy.stats import norm

from identknee.diagnosis.score import (
    Cell,
    ScoreTest,
    classify_effect,
    detectable_amplitude,
    detection_power,
    project_signature,
    score_test,
)

FIT = linear_fit()
N_DATA_SETS = 1000


@pytest.fixture(scope="module")
def maximum() -> ScoreTest:
    return score_test(FIT.projector, library(3), seed=1)


def test_one_amplitude_is_found_from_the_quantile_and_its_noise(maximum: ScoreTest) -> None:
    """At the quantile plus 1.28 standard errors in nine of ten data sets."""
    effect = maximum.signature("plain1", "")
    found = detectable_amplitude(maximum, effect, 0) * np.linalg.norm(effect.projected)
    # The tenth percentile of 1,000 draws is good to 0.054 standard errors.
    assert found == pytest.approx(maximum.quantile + norm.isf(0.1), abs=4 * 0.054)


def test_a_variant_is_found_only_beyond_the_looks_that_all_are_worth(maximum: ScoreTest) -> None:
    effect = maximum.signature("grid", "7")
    factor = maximum.trials_factors[maximum.names.index("grid")]
    # Amplitudes of either sign: half the probability on each side.
    needed = norm.isf(norm.sf(maximum.quantile) / factor / 2) + norm.isf(0.1)
    found = detectable_amplitude(maximum, effect, 0) * np.linalg.norm(effect.projected)
    assert found == pytest.approx(needed, abs=4 * 0.054)


@pytest.mark.parametrize(("name", "variant"), [("plain0", ""), ("many2", ""), ("pair", "")])
def test_stated_power_is_the_share_found(maximum: ScoreTest, name: str, variant: str) -> None:
    effect = maximum.signature(name, variant)
    amplitude = np.zeros(effect.n_parameters)
    amplitude[0] = detectable_amplitude(maximum, effect, 0)
    stated = detection_power(maximum, effect, amplitude)
    assert stated == pytest.approx(0.9, abs=0.01)
    data = FIT.residuals(np.random.default_rng(2), N_DATA_SETS)
    data = data + FIT.projector.padded(effect.signature.columns @ amplitude)
    share = np.mean(maximum.max_scores(data) > maximum.quantile)
    # Binomial errors of both; other effects add a few alarms of their own.
    bound = 4 * np.sqrt(0.09 * 2 / N_DATA_SETS)
    assert stated - bound < share < stated + bound + 0.02


def test_an_effect_that_leaves_no_trace_is_never_found(maximum: ScoreTest) -> None:
    dead = project_signature(FIT.projector, signature(np.zeros((FIT.n_data, 1)), "plain0"))
    assert detectable_amplitude(maximum, dead, 0) == np.inf
    assert detection_power(maximum, dead, np.array([1e6])) == 0.0


def test_silence_means_something_only_where_the_test_has_power() -> None:
    assert classify_effect(is_significant=True, power=0.2) is Cell.MISSPECIFIED
    assert classify_effect(is_significant=True, power=0.9) is Cell.INSPECT
    assert classify_effect(is_significant=False, power=0.9) is Cell.EXCLUDED
    assert classify_effect(is_significant=False, power=0.2) is Cell.INCONCLUSIVE
    assert len({x.sentence for x in Cell}) == 4
