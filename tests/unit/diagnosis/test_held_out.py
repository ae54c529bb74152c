"""Held-out prediction of linear models, where everything has a closed form."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from linear_laxity import (
    N_VALUES,
    SD,
    LinearLaxity,
    drawn,
    linear_folds,
    linear_observations,
    smooth_columns,
)
from scipy.optimize import least_squares
from scipy.stats import multivariate_normal
from tolerances import CLOSED_FORM

from identknee.diagnosis.gain import (
    DIRECTION,
    FAMILIES,
    FLEXION,
    Fold,
    FoldStatus,
    Observations,
    elpd_difference,
    held_out,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array
from identknee.runs.schema import summary_of

# Solutions of systems with a condition number of some thousand.
SOLVED = 1e4 * CLOSED_FORM


def problem(seed: int = 0, n: int = 4) -> LinearLaxity:
    theta = np.linspace(-1.0, 2.0, n)
    return drawn(smooth_columns(n, 3), theta, linear_observations(), seed)


def exact(made: LinearLaxity, fold: Fold) -> tuple[Array, Array, Array]:
    """Errors, their sds and log densities of the held trials, from the joint Gaussian."""
    observations = linear_observations()
    mean, covariance = made.marginal(observations)
    held = fold.held[observations.trial]
    weights = np.linalg.solve(covariance[np.ix_(~held, ~held)], covariance[np.ix_(~held, held)]).T
    expected = mean[held] + weights @ (made.measured - mean)[~held]
    spread = covariance[np.ix_(held, held)] - weights @ covariance[np.ix_(~held, held)]
    errors = made.measured[held] - expected
    densities = []
    for i in range(0, len(errors), 5):
        block = slice(i, i + 5)
        density = multivariate_normal(cov=spread[block, block]).logpdf(errors[block])
        densities.append(float(density))
    return errors, np.sqrt(np.diag(spread)), np.array(densities)


def test_the_prediction_of_a_linear_model_is_exact() -> None:
    made, observations = problem(), linear_observations()
    folds = linear_folds()
    found = held_out(made, observations, made.fitted(observations), folds)
    assert found.families == FAMILIES
    for fold, score in zip(folds, found.scores, strict=True):
        errors, sds, densities = exact(made, fold)
        held = fold.held[observations.trial]
        assert score.status is FoldStatus.SCORED
        assert score.errors[held] == pytest.approx(errors, rel=SOLVED, abs=SOLVED)
        assert score.predicted[held] == pytest.approx(sds, rel=SOLVED)
        assert score.log_density[fold.held] == pytest.approx(densities, rel=SOLVED, abs=SOLVED)
        assert np.isnan(score.errors[~held]).all()
        assert np.isnan(score.log_density[~fold.held]).all()


def test_where_the_refits_start_does_not_matter() -> None:
    made, observations, folds = problem(), linear_observations(), linear_folds()
    near = held_out(made, observations, made.fitted(observations), folds)
    far = held_out(made, observations, np.full(4, -20.0), folds)
    for one, other in zip(near.scores, far.scores, strict=True):
        assert one.theta == pytest.approx(other.theta, rel=SOLVED, abs=SOLVED)
        held = one.fold.held
        assert one.log_density[held] == pytest.approx(other.log_density[held], rel=SOLVED)


def test_errors_are_as_large_as_predicted() -> None:
    observations, folds = linear_observations(), linear_folds()[:3]
    squares = []
    for seed in range(40):
        made = problem(seed)
        for score in held_out(made, observations, made.fitted(observations), folds).scores:
            held = score.fold.held[observations.trial]
            squares.append(np.mean((score.errors[held] / score.predicted[held]) ** 2))
    # Correlated within a trial: some 60 independent values in a fold.
    assert np.mean(squares) == pytest.approx(1.0, abs=5 * np.sqrt(2 / 60 / len(squares)))


def test_root_mean_squares_pool_the_folds_asked_for() -> None:
    made, observations, folds = problem(), linear_observations(), linear_folds()
    found = held_out(made, observations, made.fitted(observations), folds)
    flexion = np.concatenate([exact(made, fold)[0] for fold in folds[:3]]).reshape(-1, 5)
    of_flexion = found.rmse(FLEXION)
    assert of_flexion.mm == pytest.approx(np.sqrt(np.mean(flexion[:, :3] ** 2)), rel=SOLVED)
    assert of_flexion.deg == pytest.approx(np.sqrt(np.mean(flexion[:, 3:] ** 2)), rel=SOLVED)
    assert of_flexion.noise == pytest.approx(np.sqrt(np.mean(flexion**2)) / SD, rel=SOLVED)
    assert summary_of(found.rmse(folds=folds[:3])) == summary_of(of_flexion)
    assert found.rmse().noise != of_flexion.noise
    sds = np.concatenate([exact(made, fold)[1] for fold in folds[:3]])
    expected = found.expected_rmse(FLEXION)
    assert expected.noise == pytest.approx(np.sqrt(np.mean(sds**2)) / SD, rel=SOLVED)
    assert expected.noise > 1
    nothing = found.rmse(DIRECTION, folds=folds[:3])
    assert np.isnan([nothing.mm, nothing.deg, nothing.noise]).all()


def test_a_bound_holds_a_parameter_in_every_fold() -> None:
    columns, observations = smooth_columns(3, 5), linear_observations()
    made = drawn(columns, np.array([1.0, 2.0, -3.0]), observations, 0)
    bounded = replace(made, lower=0.0)
    without = replace(made, columns=columns[:, :2], lower=0.0)
    folds = linear_folds()
    held = held_out(bounded, observations, np.array([1.0, 2.0, 0.0]), folds)
    free = held_out(without, observations, np.array([1.0, 2.0]), folds)
    for one, other in zip(held.scores, free.scores, strict=True):
        assert one.theta[2] == 0
        assert one.log_density == pytest.approx(other.log_density, rel=SOLVED, nan_ok=True)


def test_a_fold_without_which_a_parameter_is_not_seen_is_not_scored() -> None:
    observations, folds = linear_observations(), linear_folds()
    columns = smooth_columns(3, 5)
    columns[~folds[0].held[observations.trial], 2] = 0.0
    made = drawn(columns, np.ones(3), observations, 0)
    found = held_out(made, observations, made.fitted(observations), folds)
    statuses = [x.status for x in found.scores]
    assert statuses == [FoldStatus.NOT_IDENTIFIED] + 7 * [FoldStatus.SCORED]
    assert np.isnan(found.scores[0].theta).all()
    # One that no trial sees is no reason to give up any fold.
    blind = replace(made, columns=columns * [1.0, 1.0, 0.0])
    again = held_out(blind, observations, np.ones(3), folds)
    assert all(x.is_scored for x in again.scores)


def test_what_only_the_prior_tells_is_no_reason_where_nothing_hangs_on_it() -> None:
    """Few trials leave directions of many parameters to the prior; they may not matter."""
    observations, folds = linear_observations(), linear_folds()
    columns = smooth_columns(3, 5)
    columns[~folds[0].held[observations.trial], 2] = 0.0
    columns[:, 2] *= 0.1 * SD / (np.abs(columns[:, 2]).max() * problem().prior_sd)
    made = drawn(columns, np.ones(3), observations, 0)
    found = held_out(made, observations, made.fitted(observations), folds)
    assert all(x.is_scored for x in found.scores)
    # The prior's share is part of what the prediction expects.
    assert found.expected_rmse(FLEXION).noise > 1


def test_a_fold_in_which_nothing_was_measured_is_not_scored() -> None:
    observations, folds = linear_observations(), linear_folds()
    alone = Fold(family=FLEXION, name="one more", held=np.arange(64) == 63)
    wider = replace(observations, n_trials=64)
    longer = [replace(x, held=np.r_[x.held, False]) for x in folds[:1]]
    made = problem()
    found = held_out(made, wider, made.fitted(observations), [alone, *longer])
    assert [x.status for x in found.scores] == [FoldStatus.NOT_MEASURED, FoldStatus.SCORED]


@dataclass(frozen=True)
class NoPrediction:
    """A model that cannot predict the data."""

    parameters: Parameters

    def residuals(self, theta: Array) -> Array:
        return np.full(N_VALUES, np.inf * np.sign(theta[0]))

    def jacobian(self, theta: Array) -> Array:
        raise AssertionError


def test_a_model_without_a_prediction_fails_every_fold() -> None:
    found = held_out(
        NoPrediction(problem().parameters), linear_observations(), np.ones(4), linear_folds()
    )
    assert all(x.status is FoldStatus.FAILED for x in found.scores)
    assert np.isnan(found.rmse().noise)
    assert found.n_simulations == 1


def test_the_difference_of_two_models_is_the_sum_over_trials() -> None:
    observations, folds = linear_observations(), linear_folds()
    after = drawn(smooth_columns(4, 3), np.array([1.0, -1.0, 1.0, 0.4]), observations, 0)
    before = replace(after, columns=after.columns[:, :3])
    scored = [held_out(x, observations, x.fitted(observations), folds) for x in (before, after)]
    found = elpd_difference(*scored)
    gains = np.full((len(folds), 63), np.nan)
    for i, fold in enumerate(folds):
        gains[i, fold.held] = exact(after, fold)[2] - exact(before, fold)[2]
    flexion = found.families[0]
    assert flexion.difference == pytest.approx(np.nansum(gains[:3]), rel=SOLVED)
    by_trial = np.nanmean(gains, axis=0)
    assert found.difference == pytest.approx(by_trial.sum(), rel=SOLVED)
    assert found.se == pytest.approx(np.sqrt(63) * np.std(by_trial, ddof=1), rel=SOLVED)
    assert found.difference > 3 * found.se
    assert all(x.folds and x.difference > 2.0 * x.se for x in found.families)
    assert found.folds == folds
    back = elpd_difference(scored[1], scored[0])
    assert back.difference == -found.difference
    assert all(x.difference < 0.0 for x in back.families)


def test_folds_that_say_nothing_of_the_difference_do_not_count() -> None:
    observations, folds = linear_observations(), linear_folds()
    columns = smooth_columns(4, 3)
    at_zero = folds[0].held[observations.trial]
    # Seen at one angle only, and there in a direction of its own.
    columns[:, 3] = np.where(at_zero, np.random.default_rng(0).standard_normal(N_VALUES), 0.0)
    after = drawn(columns, np.ones(4), observations, 0)
    before = replace(after, columns=columns[:, :3])
    scored = [held_out(x, observations, x.fitted(observations), folds) for x in (before, after)]
    flexion, direction, extremes = elpd_difference(*scored).families
    assert [fold.name for fold, _ in flexion.not_scored] == ["0 deg"]
    assert flexion.not_scored[0][1] == FoldStatus.NOT_IDENTIFIED.sentence
    assert set(flexion.folds).isdisjoint(flexion.without_signature)
    assert len(flexion.folds) + len(flexion.without_signature) == 2
    assert direction.difference > 2.0 * direction.se
    assert extremes.difference > 2.0 * extremes.se
    same = elpd_difference(scored[0], scored[0])
    assert same.difference == 0
    assert np.isnan(same.se)
    assert not any(x.folds for x in same.families)


def test_models_scored_on_different_folds_are_refused() -> None:
    made, observations, folds = problem(), linear_observations(), linear_folds()
    theta = made.fitted(observations)
    one, other = (held_out(made, observations, theta, x) for x in (folds[:3], folds[:2]))
    with pytest.raises(ValueError, match="different folds"):
        elpd_difference(one, other)


@dataclass(frozen=True, kw_only=True)
class BentLaxity:
    """The same with responses that bend, so that no one step ends a fit."""

    straight: LinearLaxity

    @property
    def parameters(self) -> Parameters:
        return self.straight.parameters

    def residuals(self, theta: Array) -> Array:
        return self.straight.residuals(theta + 0.3 * theta**3)

    def jacobian(self, theta: Array) -> Array:
        return np.asarray(self.straight.columns * (1.0 + 0.9 * theta**2))


def test_a_fold_is_fitted_to_the_end_and_not_by_one_step() -> None:
    """From a start far off, as a fold that held much of the data has it; scipy has the answer."""
    observations, columns = linear_observations(), smooth_columns(4, 3)
    truth = np.array([-1.0, 0.5, 1.0, 1.5])
    errors = np.random.default_rng(2).standard_normal(N_VALUES)
    measured = columns @ (truth + 0.3 * truth**3) + observations.noise.factor @ errors
    made = BentLaxity(straight=LinearLaxity(columns=columns, measured=measured))
    folds = [x for x in linear_folds() if x.family == FLEXION]
    found = held_out(made, observations, truth + np.array([1.0, -1.5, 1.0, 1.0]), folds)
    for fold, score in zip(folds, found.scores, strict=True):
        best = least_squares(_rows_kept(made, observations, fold), truth, xtol=1e-12, ftol=1e-12)
        sd = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
        # The refit may leave a hundredth of the deviance: a tenth of a standard deviation.
        assert np.abs((score.theta - best.x) / sd).max() < 0.15


def _rows_kept(
    made: BentLaxity, observations: Observations, fold: Fold
) -> Callable[[Array], Array]:
    """Whitened residuals of the values kept, then those of the priors, by theta."""
    kept = np.flatnonzero(~fold.held[observations.trial])
    factor = np.linalg.cholesky(observations.noise.covariance[np.ix_(kept, kept)])

    def rows(theta: Array) -> Array:
        white = np.linalg.solve(factor, made.residuals(theta)[kept])
        return np.concatenate([white, (theta - 0.5) / made.straight.prior_sd])

    return rows
