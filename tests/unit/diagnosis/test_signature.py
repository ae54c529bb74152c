"""The statistic of one effect: against textbook scores, constrained least squares and its null."""

import numpy as np
import pytest
from linear_data import LinearFit, linear_fit, signature
from scipy.optimize import nnls
from scipy.stats import norm

from identknee.diagnosis.score import ProjectedSignature, Signature, project_signature
from identknee.runs.declare import Array

# Solving small systems of condition up to 1e4.
SOLVED = 1e-9
N_DRAWS = 20_000


def projected(
    fit: LinearFit, columns: Array, sign: int = 0, prior_sd: float = 1.0
) -> ProjectedSignature:
    return project_signature(fit.projector, signature(columns, "a", sign=sign, prior_sd=prior_sd))


def correlations(fit: LinearFit, found: ProjectedSignature, residuals: Array) -> Array:
    return np.asarray(fit.projector.project(residuals.T).T @ found.projected)


def test_one_signed_amplitude_has_the_usual_score() -> None:
    """With a weak prior the amplitude is that of the regression on everything at once."""
    fit, generator = linear_fit(), np.random.default_rng(1)
    column = generator.standard_normal((fit.n_data, 1))
    found = projected(fit, column, sign=1, prior_sd=1e4)
    residuals = fit.residuals(generator, 1) + 0.3 * fit.projector.padded(column)[:, 0]
    u = correlations(fit, found, residuals)
    textbook = u[0, 0] / np.linalg.norm(found.projected)
    # The table of the tail is interpolated in steps of 0.05.
    assert found.z_score(found.gain(u))[0] == pytest.approx(textbook, rel=1e-4)
    whole = np.hstack([fit.jacobian, fit.projector.padded(column)])
    regression, *_ = np.linalg.lstsq(whole, residuals[0], rcond=None)
    assert found.amplitude(u)[0, 0] == pytest.approx(regression[-1], rel=1e-6)
    covariance = np.linalg.inv(whole.T @ whole)[-1, -1]
    assert found.covariance[0, 0] == pytest.approx(covariance, rel=1e-6)


def test_the_wrong_sign_scores_nothing() -> None:
    fit, generator = linear_fit(), np.random.default_rng(2)
    column = generator.standard_normal((fit.n_data, 1))
    residuals = np.atleast_2d(-5 * fit.projector.padded(column)[:, 0])
    for sign, scores in ((1, False), (-1, True), (0, True)):
        found = projected(fit, column, sign=sign)
        u = correlations(fit, found, residuals)
        assert (found.z_score(found.gain(u))[0] > 10) == scores
        assert (found.amplitude(u)[0, 0] < -1) == scores


@pytest.mark.parametrize("seed", range(5))
def test_signed_amplitudes_are_those_of_constrained_least_squares(seed: int) -> None:
    """Nonnegative least squares with the prior as further rows."""
    fit, generator = linear_fit(), np.random.default_rng(seed)
    found = projected(fit, generator.standard_normal((fit.n_data, 3)), sign=1, prior_sd=0.1)
    residuals = fit.residuals(generator, 20)
    u = correlations(fit, found, residuals)
    gains, amplitudes = found.gain(u), found.amplitude(u)
    rows = np.vstack([found.projected, 10 * np.eye(3)])
    for draw, residual in enumerate(fit.projector.project(residuals.T).T):
        data = np.concatenate([residual, np.zeros(3)])
        expected, norm_left = nnls(rows, data)
        np.testing.assert_allclose(amplitudes[draw], expected, atol=SOLVED)
        assert gains[draw] == pytest.approx(data @ data - norm_left**2, abs=SOLVED * (data @ data))


@pytest.mark.parametrize(
    ("k", "sign", "prior_sd"), [(1, 0, 1.0), (1, 1, 1.0), (2, 1, 0.05), (8, 0, 0.05), (24, 0, 0.1)]
)
def test_z_scores_are_standard_normal_under_no_effect(k: int, sign: int, prior_sd: float) -> None:
    """So that effects with one and with many amplitudes compare."""
    fit, generator = linear_fit(), np.random.default_rng(k)
    columns = generator.standard_normal((fit.n_data, k)) * np.geomspace(1, 0.1, k)
    found = projected(fit, columns, sign=sign, prior_sd=prior_sd)
    u = correlations(fit, found, fit.residuals(generator, N_DRAWS))
    z_scores = found.z_score(found.gain(u))
    assert z_scores.min() >= 0
    for limit in (1.0, 2.0, 3.0):
        share, expected = np.mean(z_scores > limit), norm.sf(limit)
        # Binomial error, and 10 % for the three moments that stand for the distribution.
        bound = 5 * np.sqrt(expected / N_DRAWS) + 0.1 * expected
        assert share == pytest.approx(expected, abs=bound)


def test_what_the_parameters_explain_scores_nothing() -> None:
    fit, generator = linear_fit(), np.random.default_rng(4)
    bare = linear_fit().jacobian[: fit.n_data, :1]
    without_prior = LinearFit(
        jacobian=fit.jacobian,
        projector=fit.projector.with_columns(bare),
    )
    found = projected(without_prior, bare)
    assert not found.is_seen
    u = correlations(without_prior, found, fit.residuals(generator, 3))
    np.testing.assert_array_equal(found.z_score(found.gain(u)), 0.0)
    assert projected(fit, np.zeros((fit.n_data, 1))).share_left == 0.0


def test_wrong_signatures_are_refused() -> None:
    columns = np.ones((4, 1))
    with pytest.raises(ValueError, match=r"a: sign.*-1, 0 or 1"):
        Signature(name="a", variant="", columns=columns, prior_sd=np.ones(1), sign=np.array([2]))
    with pytest.raises(ValueError, match=r"a: .*prior_sd"):
        Signature(name="a", variant="", columns=columns, prior_sd=np.zeros(1), sign=np.array([0]))
    with pytest.raises(ValueError, match="6 amplitudes"):
        signature(np.ones((10, 7)), "a", sign=1)
