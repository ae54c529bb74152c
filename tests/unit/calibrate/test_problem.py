from collections.abc import Callable

import numpy as np
import pytest
from problems import linear, plain_parameters, sloppy_springs

from identknee.calibrate.problem import ProblemWithPriors, restricted
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array

# Central differences of smooth functions of order one, step 1e-6.
DIFFERENCE = 1e-8


def differences(residuals: Callable[[Array], Array], theta: Array, step: float = 1e-6) -> Array:
    columns = [
        (residuals(theta + step * e) - residuals(theta - step * e)) / (2 * step)
        for e in np.eye(theta.size)
    ]
    return np.stack(columns, axis=1)


def test_restricted_problem_is_a_slice_of_the_whole() -> None:
    whole = sloppy_springs()
    part = restricted(whole, ["PCL.stiffness_kN", "MCL.reference_strain_pct"], whole.start)
    theta = part.free.restrict(whole.start) + 0.1
    assert part.parameters.n == 6
    assert "PCL.stiffness_kN" not in part.parameters.names
    expected = whole.start + 0.1
    expected[1], expected[7] = whole.start[1], whole.start[7]
    np.testing.assert_array_equal(part.free.expand(theta), expected)
    np.testing.assert_array_equal(part.residuals(theta), whole.residuals(expected))
    np.testing.assert_array_equal(
        part.jacobian(theta), np.delete(whole.jacobian(expected), [1, 7], axis=1)
    )


def test_restricting_refuses_unknown_names_and_leaves_something_free() -> None:
    problem = linear(2)
    with pytest.raises(ValueError, match="no parameter 'y'"):
        restricted(problem, ["y"], problem.start)
    with pytest.raises(ValueError, match="one free"):
        restricted(problem, problem.parameters.names, problem.start)


def test_prior_rows_and_their_derivatives() -> None:
    springs = sloppy_springs()
    problem, theta = ProblemWithPriors(problem=springs), springs.start
    rows = problem.residuals(theta)[-8:]
    center = problem.parameters.center
    np.testing.assert_allclose(rows[:4], np.log(theta[:4] / center[:4]) / 0.35, rtol=1e-14)
    np.testing.assert_allclose(rows[4:], (theta[4:] - center[4:]) / 2.0, rtol=1e-14)
    np.testing.assert_allclose(
        problem.jacobian(theta), differences(problem.residuals, theta), atol=DIFFERENCE
    )


def test_lognormal_prior_excludes_zero() -> None:
    springs = sloppy_springs()
    problem, theta = ProblemWithPriors(problem=springs), np.array(springs.start)
    theta[0] = 0.0
    assert np.all(np.isinf(problem.residuals(theta)))


def test_all_closed_form_jacobians_are_derivatives() -> None:
    from problems import EASY

    for problem in EASY:
        np.testing.assert_allclose(
            problem.jacobian(problem.start),
            differences(problem.residuals, problem.start),
            atol=20 * DIFFERENCE,
            err_msg=problem.name,
        )


def test_plain_parameters_are_parameters() -> None:
    assert isinstance(plain_parameters(2), Parameters)
