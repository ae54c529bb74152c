"""Models of both sides of a kink, and the step to where the highest of them is lowest."""

import numpy as np
import pytest

from identknee.calibrate.bounded_least_squares import KinkModels, minimise_max_model
from identknee.calibrate.problem import Evaluation
from identknee.runs.declare import Array

ANYWHERE = (np.full(2, -np.inf), np.full(2, np.inf))
ONES = np.ones(2)


def _side(theta: list[float], sign: float) -> Evaluation:
    """Distances from (1, 1) and a residual whose slope by the first parameter has a sign."""
    at = np.array(theta)
    residuals = np.append(at - 1.0, 3.0 + 0.5 * sign * at[0])
    jacobian = np.vstack([np.eye(2), [0.5 * sign, 0.0]])
    return Evaluation(theta=at, residuals=residuals, jacobian=jacobian)


def _models(at: Evaluation, *others: Evaluation, length: float = 1.0) -> Array:
    kinks = KinkModels()
    for other in others:
        kinks.remember(other)
    return kinks.models(at, ONES, length=length, slack=0.0)


def test_the_step_ends_on_the_kink_between_two_sides() -> None:
    models = _models(_side([0.3, 0.0], 1.0), _side([-0.2, 0.1], -1.0))
    step, height = minimise_max_model(models, ANYWHERE, None, 1e-9)
    np.testing.assert_allclose(step.step, [-0.3, 1.0], atol=1e-6)
    assert height == pytest.approx(10.0, abs=1e-8)


def test_the_multiplier_is_that_of_the_kink() -> None:
    """With the second parameter held, the first stays on the kink: only the held one pulls."""
    models = _models(_side([0.3, 0.0], 1.0), _side([-0.2, 0.1], -1.0))
    plane = np.array([0.0, 1.0]), 0.4
    step, height = minimise_max_model(models, ANYWHERE, plane, 1e-9)
    np.testing.assert_allclose(step.step, [-0.3, 0.4], atol=1e-6)
    assert height == pytest.approx(10.36, abs=1e-8)
    assert step.multiplier == pytest.approx(-0.6, abs=1e-6)


def test_one_model_gives_the_step_of_gauss_and_newton() -> None:
    at = _side([0.3, 0.0], 1.0)
    step, height = minimise_max_model(_models(at), ANYWHERE, None, 1e-9)
    exact, left, _, _ = np.linalg.lstsq(at.jacobian, -at.residuals)
    np.testing.assert_allclose(step.step, exact, atol=1e-12)
    assert height == pytest.approx(float(left[0]))


@pytest.mark.parametrize(
    ("theta", "sign", "length"),
    [
        ([-9.0, 0.0], -1.0, 1.0),  # too far away
        ([-0.2, 0.1], -1.0, 9.0),  # the step is none that a search ends with
        ([0.3, 0.0], -1.0, 1.0),  # the same place
        ([0.4, 0.0], -3.0, 1.0),  # between it and here the deviance bends downward
    ],
)
def test_points_that_say_nothing_of_a_kink_are_left_out(
    theta: list[float], sign: float, length: float
) -> None:
    at = _side([0.3, 0.0], 1.0)
    other = _side(theta, sign)
    if sign == -3.0:
        other = Evaluation(theta=other.theta, residuals=at.residuals + 1.0, jacobian=other.jacobian)
    assert len(_models(at, other, length=length)) == 1
