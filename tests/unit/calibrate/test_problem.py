from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from data_files import DATA
from problems import linear, plain_parameters, sloppy_springs

from identknee.calibrate.problem import (
    LIGAMENT_TERM,
    NUISANCE_TERM,
    TABLE_TERM,
    BoundedProblem,
    ProblemWithPriors,
    evidence_terms,
    restricted,
    sum_of_squares,
    thin_svd,
    with_all_priors,
    with_nuisance_priors,
    with_priors_of,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array

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


def test_singular_values_of_columns_far_smaller_than_others_are_found() -> None:
    """LAPACK's divide and conquer does not converge on these columns of slack ligaments."""
    matrix = np.loadtxt(DATA / "slack_columns.csv", delimiter=",")
    left, size, right = thin_svd(matrix)
    np.testing.assert_allclose(left * size @ right, matrix, atol=1e-14)
    np.testing.assert_allclose(right @ right.T, np.eye(28), atol=1e-13)
    assert np.all(np.diff(size) <= 0.0)


def _with_nuisances() -> ProblemWithPriors:
    problem = linear(5)
    parameters = replace(problem.parameters, is_nuisance=np.arange(5) >= 3)
    return with_all_priors(BoundedProblem(problem=problem, parameters=parameters))


def test_the_terms_of_the_evidence_add_up_to_the_deviance() -> None:
    problem = _with_nuisances()
    theta = problem.parameters.center + 0.3
    terms = {x.name: x for x in evidence_terms(problem, theta)}
    whole = sum_of_squares(problem.residuals(theta))
    assert set(terms) == {TABLE_TERM, LIGAMENT_TERM, NUISANCE_TERM}
    assert sum(x.deviance for x in terms.values()) == pytest.approx(whole, rel=1e-12)
    assert sum(x.share for x in terms.values()) == pytest.approx(1.0, rel=1e-12)
    p = problem.parameters
    own = ((theta - p.center) / p.prior_sd)[3:]
    assert (terms[NUISANCE_TERM].n, terms[LIGAMENT_TERM].n) == (2, 3)
    assert terms[NUISANCE_TERM].deviance == pytest.approx(own @ own, rel=1e-12)
    of_nuisances = evidence_terms(with_nuisance_priors(problem.problem), theta)
    assert [x.name for x in of_nuisances] == [TABLE_TERM, NUISANCE_TERM]


def test_a_problem_gets_the_priors_that_another_one_has() -> None:
    whole = _with_nuisances()
    names = whole.parameters.names
    theta = whole.parameters.center + 0.3
    part = restricted(whole.problem, names[3:], theta)
    found = with_priors_of(part, with_nuisance_priors(whole.problem))
    assert found is part
    found = with_priors_of(part, whole)
    n_data = part.residuals(theta[:3]).size
    np.testing.assert_array_equal(
        found.residuals(theta[:3])[n_data:], whole.residuals(theta)[n_data : n_data + 3]
    )
