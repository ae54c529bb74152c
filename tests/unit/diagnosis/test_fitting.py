"""Fits of a laxity model that a diagnosis rests on."""

from typing import Any

import numpy as np
import pytest
from small_knee import small_protocol

from identknee.calibrate.bounded_least_squares import ConstrainedFit
from identknee.diagnosis import fitting
from identknee.diagnosis.fitting import FittedModel, base_model, best_fit_from, descended
from identknee.diagnosis.noise_model import build_noise_model
from identknee.runs.declare import Array
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee

SD = 0.3
# A fit ends where a step predicts less than its tolerance of the deviance.
SAME_FIT = 1e-3


@pytest.fixture(scope="module")
def fitted(reference: Knee) -> FittedModel:
    """The base model at its own laxity."""
    model = base_model(reference, small_protocol())
    laxity = model.simulate(model.parameters.center)
    noise = build_noise_model(np.full((laxity.n, 5), SD), laxity.is_measured, correlation=0.3)
    return best_fit_from(model, laxity, noise, [_beside(model.parameters.center)])


def _beside(theta: Array) -> Array:
    """Ligaments a tenth stiffer."""
    return np.concatenate([1.1 * theta[:4], theta[4:]])


def test_steps_that_know_how_a_valley_bends_end_at_the_same_minimum(
    fitted: FittedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("identknee.diagnosis.fitting.STRAIGHT_STEPS", 1)
    start = _beside(fitted.model.parameters.center)
    again = best_fit_from(fitted.model, fitted.laxity, fitted.noise, [start])
    assert fitted.outcome is again.outcome is Outcome.MINIMUM
    assert again.deviance == pytest.approx(fitted.deviance, abs=SAME_FIT)
    assert again.constrained.n_simulations > 2


def test_a_fit_that_joins_another_is_not_continued(fitted: FittedModel) -> None:
    start = _beside(fitted.model.parameters.center)
    ends = [fitted.evaluation]
    again = best_fit_from(fitted.model, fitted.laxity, fitted.noise, [start], ends=ends)
    assert again.deviance > fitted.deviance
    assert again.constrained.n_simulations < fitted.constrained.n_simulations


def test_a_start_given_twice_is_fitted_once(
    fitted: FittedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[Array] = []

    def counted(problem: Any, start: Array, *how: Any) -> ConstrainedFit:
        begun.append(start)
        return descended(problem, start, *how)

    monkeypatch.setattr(fitting, "descended", counted)
    start = _beside(fitted.model.parameters.center)
    starts = [start, fitted.theta, np.array(start)]
    best_fit_from(fitted.model, fitted.laxity, fitted.noise, starts, most_steps=1)
    assert len(begun) == 2


def test_a_fit_from_where_another_ended_begins_with_its_evaluation(fitted: FittedModel) -> None:
    model, known = fitted.model, fitted.evaluation
    again = best_fit_from(model, fitted.laxity, fitted.noise, [known.theta], known=[known])
    assert again.evaluation is known
    assert again.constrained.n_simulations == 1
