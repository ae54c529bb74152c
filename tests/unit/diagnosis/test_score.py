"""The max-score test: false alarms, naming, and what must not change it."""

from dataclasses import replace

import numpy as np
import pytest
from linear_data import N_PARAMETERS, LinearFit, library, linear_fit, signature
from scipy.stats import norm

from identknee.diagnosis.misfit import Projector
from identknee.diagnosis.score import (
    LEVEL,
    N_DRAWS,
    CandidateScore,
    Scale,
    ScoreTest,
    _corrected,
    score_test,
)
from identknee.runs.declare import Array

N_NULLS = 4000
# Of the rate of false alarms: binomial, and that of the simulated quantile.
STANDARD_ERROR = np.sqrt(LEVEL * (1 - LEVEL) * (1 / N_NULLS + 1 / N_DRAWS))
# Of statistics at residuals moved along the parameters.
INVARIANT = 1e-9


@pytest.fixture(scope="module")
def fit() -> LinearFit:
    return linear_fit()


@pytest.fixture(scope="module", params=["known", "unknown"])
def maximum(request: pytest.FixtureRequest, fit: LinearFit) -> ScoreTest:
    scale: Scale = request.param
    return score_test(fit.projector, library(3), seed=1, scale=scale)


def candidate(test: ScoreTest, residuals: Array, name: str) -> CandidateScore:
    return next(x for x in test.evaluate(residuals).candidates if x.name == name)


def planted(fit: LinearFit, name: str, root: float, seed: int, variant: str = "") -> Array:
    """Noise and an effect that stands out by `root`, its amplitudes alike."""
    effect = next(x for x in library(3) if x.name == name and x.variant == variant)
    amplitude = np.ones(effect.n_parameters)
    size = np.linalg.norm(fit.projector.project(effect.columns) @ amplitude)
    noise = fit.residuals(np.random.default_rng(seed), 1)[0]
    return np.asarray(noise + fit.projector.padded(effect.columns @ amplitude) * root / size)


def test_false_alarms_are_as_rare_as_stated(fit: LinearFit, maximum: ScoreTest) -> None:
    nulls = fit.residuals(np.random.default_rng(2), N_NULLS)
    rate = np.mean(maximum.max_scores(nulls) > maximum.quantile)
    assert rate == pytest.approx(LEVEL, abs=4 * STANDARD_ERROR)
    p_values = np.array([maximum.p_value(x) for x in maximum.max_scores(nulls)])
    # Kolmogorov-Smirnov at about 1e-4, both samples of the same size.
    levels = np.linspace(0.01, 0.99, 99)
    share = np.mean(p_values[:, None] <= levels, axis=0)
    assert np.abs(share - levels).max() < 2.2 * np.sqrt(1 / N_NULLS + 1 / N_DRAWS)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-7])
def test_what_rounding_leaves_of_an_exact_table_has_no_pattern(
    fit: LinearFit, maximum: ScoreTest, size: float
) -> None:
    residuals = size * planted(fit, library(3)[0].name, 30.0, seed=3, variant=library(3)[0].variant)
    assert maximum.evaluate(residuals).p_value > 0.9


def test_noise_of_unknown_size_needs_the_test_that_says_so(fit: LinearFit) -> None:
    """Without prior rows, whose size is known, the test is exact at any size of the noise."""
    bare = Projector(basis=np.linalg.qr(fit.jacobian[: fit.n_data])[0])
    noise = 1.7 * np.random.default_rng(4).standard_normal((N_NULLS, fit.n_data))
    rates = {}
    for scale in ("known", "unknown"):
        found = score_test(bare, library(3), seed=1, scale=scale)
        rates[scale] = np.mean(found.max_scores(noise) > found.quantile)
    assert rates["unknown"] == pytest.approx(LEVEL, abs=4 * STANDARD_ERROR)
    assert rates["known"] > 0.5


@pytest.mark.parametrize(
    ("name", "variant"),
    [("plain0", ""), ("plain1", ""), ("many1", ""), ("pair", ""), ("grid", "7")],
)
def test_a_planted_effect_is_found_and_named(
    fit: LinearFit, maximum: ScoreTest, name: str, variant: str
) -> None:
    found = maximum.evaluate(planted(fit, name, 9.0, seed=5, variant=variant))
    assert found.candidates[0].name == name
    assert found.candidates[0].variant == variant
    assert found.max_score > found.quantile
    assert found.p_value < 0.01
    scores = [x.score for x in found.candidates]
    assert scores == sorted(scores, reverse=True)


def test_amplitudes_come_with_their_error(fit: LinearFit) -> None:
    found = score_test(fit.projector, library(3), seed=1)
    effect = found.signature("plain1", "")
    errors = []
    for seed in range(200):
        best = candidate(found, planted(fit, "plain1", 9.0, seed), "plain1")
        truth = 9.0 / np.linalg.norm(effect.projected)
        errors.append((best.amplitude[0] - truth) / np.sqrt(best.covariance[0, 0]))
    assert abs(np.mean(errors)) < 5 / np.sqrt(200)
    assert np.std(errors) == pytest.approx(1.0, abs=5 / np.sqrt(400))


def test_which_near_equivalent_fit_was_found_does_not_matter(
    fit: LinearFit, maximum: ScoreTest
) -> None:
    residuals = planted(fit, "many0", 6.0, seed=6)
    here = maximum.evaluate(residuals)
    moved = fit.jacobian @ np.random.default_rng(7).normal(0, 5, N_PARAMETERS)
    there = maximum.evaluate(residuals + moved)
    assert [x.name for x in here.candidates] == [x.name for x in there.candidates]
    for one, other in zip(here.candidates, there.candidates, strict=True):
        assert one.score == pytest.approx(other.score, abs=INVARIANT)
        assert one.gain == pytest.approx(other.gain, abs=INVARIANT)
        assert one.p_value == other.p_value
        np.testing.assert_allclose(one.amplitude, other.amplitude, atol=INVARIANT)


def test_without_the_projector_the_fit_passes_for_an_effect(fit: LinearFit) -> None:
    """A mutation: residuals of another near-equivalent fit then raise false alarms."""
    nothing = Projector(basis=np.zeros((len(fit.jacobian), 0)))
    mutant = score_test(nothing, library(3), seed=1)
    moved = fit.jacobian @ np.full(N_PARAMETERS, 1.0)
    noise = fit.residuals(np.random.default_rng(8), 1)[0]
    difference = mutant.evaluate(noise + moved).max_score - mutant.evaluate(noise).max_score
    assert abs(difference) > 0.1
    nulls = fit.residuals(np.random.default_rng(9), 500) + moved
    assert np.mean(mutant.max_scores(nulls) > mutant.quantile) > 3 * LEVEL


def test_signs_of_amplitudes_matter(fit: LinearFit) -> None:
    """The same data without the rule: the impossible sign is named."""
    residuals = -planted(fit, "plain1", 9.0, seed=5)
    signed = score_test(fit.projector, library(3), seed=1)
    free = score_test(
        fit.projector, [replace(x, sign=np.zeros_like(x.sign)) for x in library(3)], seed=1
    )
    assert free.evaluate(residuals).candidates[0].name == "plain1"
    assert candidate(signed, residuals, "plain1").score < 0.1


def test_variants_count_as_the_looks_they_are_worth(fit: LinearFit) -> None:
    """Twelve that resemble one another are worth fewer, copies of one are worth one."""
    found = score_test(fit.projector, library(3), seed=1)
    factor = found.trials_factors[found.names.index("grid")]
    assert 2 < factor < 12
    plain = library(3)[0]
    nulls = fit.residuals(np.random.default_rng(10), 400)
    scores = np.array([candidate(found, r, "grid").score for r in nulls])
    assert np.mean(scores > norm.isf(LEVEL)) == pytest.approx(
        LEVEL, abs=4 * np.sqrt(LEVEL * (1 - LEVEL) / 400)
    )
    copies = [replace(plain, variant=str(i)) for i in range(5)]
    assert score_test(fit.projector, copies, seed=1).trials_factors[0] == pytest.approx(
        1.0, abs=0.2
    )


def test_with_equal_evidence_the_effect_with_fewer_looks_leads(fit: LinearFit) -> None:
    one = next(x for x in library(3) if x.name == "grid" and x.variant == "7")
    both = score_test(fit.projector, [*library(3), replace(one, name="known site")], seed=1)
    found = both.evaluate(planted(fit, "grid", 9.0, seed=5, variant="7"))
    assert [x.name for x in found.candidates[:2]] == ["known site", "grid"]
    more_likely = norm.logsf(found.candidates[1].score) - norm.logsf(found.candidates[0].score)
    factor = both.trials_factors[both.names.index("grid")]
    assert more_likely == pytest.approx(np.log(factor), rel=1e-6)


def test_the_same_seed_gives_the_same_test(fit: LinearFit) -> None:
    one, other = (score_test(fit.projector, library(3), seed=4, n_draws=200) for _ in range(2))
    np.testing.assert_array_equal(one.null, other.null)


def test_an_empty_library_is_refused(fit: LinearFit) -> None:
    with pytest.raises(ValueError, match="one signature"):
        score_test(fit.projector, [], seed=0)


def test_an_unseen_effect_alone_raises_no_alarm(fit: LinearFit) -> None:
    dead = score_test(fit.projector, [signature(np.zeros((fit.n_data, 1)), "dead")], seed=0)
    found = dead.evaluate(fit.residuals(np.random.default_rng(1), 1)[0])
    assert found.max_score == 0.0
    assert found.p_value == 1.0


def test_no_simulated_p_value_is_zero(fit: LinearFit) -> None:
    """Draws that reach a score, the data themselves counted: 1 of n + 1 where none of n does.

    B. Phipson and G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 9 (2010) 39,
    doi:10.2202/1544-6115.1585.
    """
    test = score_test(fit.projector, library(3), seed=1, n_draws=99)
    assert test.p_value(np.inf) == pytest.approx(0.01)
    assert test.p_value(-np.inf) == 1.0
    # Nine of 99 draws are as high as the ninth highest: with the data themselves ten of 100.
    assert test.p_value(float(test.null[-9])) == pytest.approx(0.1)


def test_an_effect_of_one_sign_scores_on_its_own_side(fit: LinearFit) -> None:
    """A structure that pulls is no explanation of a push, whichever way its column points."""
    columns = np.random.default_rng(5).standard_normal((fit.n_data, 1))
    column = fit.projector.padded(columns[:, 0])
    for sign in (1, -1):
        one = signature(columns, "one", sign=sign, prior_sd=1e3)
        test = score_test(fit.projector, [one], seed=1)
        seen, unseen = (test.evaluate(factor * sign * column) for factor in (0.5, -0.5))
        assert seen.max_score > 4.0
        assert unseen.max_score == 0.0
        (amplitude,) = seen.candidates[0].amplitude
        assert amplitude == pytest.approx(0.5 * sign, rel=1e-3)
        assert unseen.candidates[0].amplitude.tolist() == [0.0]


def test_effects_that_explain_nothing_score_zero_in_the_order_of_the_library() -> None:
    """The root of a rounding error is about 1e-8, and differs between processors."""
    z_scores = np.array([[0.0, 1e-9, 2e-8, 1e-5, 2.0]])
    np.testing.assert_allclose(
        _corrected(z_scores, np.ones(5)), [[0.0, 0.0, 0.0, 1e-5, 2.0]], rtol=1e-5
    )
