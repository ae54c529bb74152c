"""The robust fit: gross errors move it little, and the scale is that of the others."""

import numpy as np
from problems import Linear

from identknee.calibrate.fit import Fit, fit, fit_student, student_scales
from identknee.calibrate.problem import Problem
from identknee.model.parameters import ligament_parameters
from identknee.runs.declare import Array

TRUTH = np.array([10.0, 18.0, 1.0, -2.0])
N = 200
UNITS = np.arange(N) % 2
SIZES = np.array([0.3, 2.0])


def problem_with(gross: float) -> Linear:
    """Two kinds of errors, and every nineteenth value wrong by `gross` of their sizes."""
    generator = np.random.default_rng(5)
    matrix = generator.normal(size=(N, 4))
    errors = SIZES[UNITS] * generator.normal(size=N)
    errors[::19] += gross * SIZES[UNITS[::19]]
    parameters = ligament_parameters(["a", "b"], [8.0, 15.0], [0.0, 0.0])
    return Linear(parameters=parameters, matrix=matrix, data=matrix @ TRUTH + errors)


def search(problem: Problem, start: Array) -> Fit:
    return fit(problem, start)


def test_gross_errors_move_a_robust_fit_little() -> None:
    start = np.array([8.0, 15.0, 0.0, 0.0])
    clean, wrong = problem_with(0.0), problem_with(100.0)
    robust = fit_student(wrong, UNITS, start, search).theta
    without = fit_student(clean, UNITS, start, search).theta
    plain = fit(wrong, start).theta
    assert np.abs(robust - without).max() < 0.1
    assert np.abs(plain - without).max() > 0.5


def test_the_scales_are_those_of_the_values_that_are_not_wrong() -> None:
    wrong = problem_with(100.0)
    found = fit_student(wrong, UNITS, np.array([8.0, 15.0, 0.0, 0.0]), search)
    scales, weights = student_scales(wrong, UNITS, found.theta)
    # A Student's t with four degrees of freedom has a scale of 0.8 of a normal error's size.
    np.testing.assert_allclose(scales / SIZES, 0.9, atol=0.2)
    assert weights[::19].max() < 0.01
    assert np.median(weights) > 0.9


def test_where_it_began_and_what_it_took_are_those_of_the_whole() -> None:
    start = np.array([8.0, 15.0, 0.0, 0.0])
    found = fit_student(problem_with(100.0), UNITS, start, search)
    np.testing.assert_array_equal(found.start, start)
    assert found.n_simulations > fit(problem_with(100.0), start).n_simulations
