"""The Fisher information against closed forms, and its floors against errors put in on purpose."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from problems import Linear, linear, plain_parameters, sloppy_springs
from tolerances import CLOSED_FORM

from identknee.calibrate.problem import Problem, ProblemWithPriors
from identknee.identify.information import (
    Information,
    combination,
    information,
    spectrum,
)
from identknee.model.parameters import Parameters, ligament_parameters
from identknee.runs.declare import Array

# Central differences of closed forms over steps of 1e-1 to 1e-6.
DIFFERENCES = 1e-8


@dataclass(frozen=True, kw_only=True)
class Disturbed:
    """A problem whose Jacobian goes through a function of theta and Jacobian."""

    problem: Problem
    disturb: Callable[[Array, Array], Array]

    @property
    def parameters(self) -> Parameters:
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        return self.problem.residuals(theta)

    def jacobian(self, theta: Array) -> Array:
        return self.disturb(theta, self.problem.jacobian(theta))


def _jittery(size: float) -> Callable[[Array, Array], Array]:
    """Errors of this size that any change of theta changes, and that repeat themselves."""

    def disturb(theta: Array, jacobian: Array) -> Array:
        seed = np.frombuffer(theta.tobytes(), np.uint32)
        return jacobian + size * np.random.default_rng(seed).standard_normal(jacobian.shape)

    return disturb


@pytest.fixture(scope="module")
def springs() -> Information:
    problem = sloppy_springs()
    return information(problem, problem.minimum)


def test_it_is_that_of_a_linear_problem() -> None:
    problem = linear()
    found = information(problem, problem.minimum)
    matrix = problem.jacobian(problem.minimum)
    # Parameters in %, of which a typical step is 2.
    scaled = 4.0 * matrix.T @ matrix
    np.testing.assert_allclose(found.eigenvalues, np.linalg.eigvalsh(scaled)[::-1], rtol=1e-11)
    rebuilt = found.eigenvectors * found.eigenvalues @ found.eigenvectors.T
    np.testing.assert_allclose(rebuilt, scaled, atol=1e-11 * scaled.max())
    covariance = np.linalg.inv(matrix.T @ matrix)
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.sd, sd, rtol=1e-9)
    np.testing.assert_allclose(found.correlation, covariance / np.outer(sd, sd), atol=1e-9)
    np.testing.assert_allclose(found.matrix, matrix.T @ matrix, rtol=CLOSED_FORM, atol=1e-10)
    assert found.condition == pytest.approx(np.linalg.cond(matrix) ** 2, rel=1e-9)
    assert found.n_above_noise == problem.parameters.n


def test_floors_of_exact_derivatives_are_those_of_differences(springs: Information) -> None:
    assert springs.n_above_noise == 8
    assert springs.noise.rounding <= 1e-13 * np.sqrt(springs.eigenvalues[0])
    assert (springs.floors <= DIFFERENCES**2 * springs.eigenvalues[0]).all()
    assert (springs.noise.steps > 0).all()
    assert springs.n_simulations <= 8 * 6 * 4 + 3 * 8 + 1


@pytest.mark.parametrize("size", [1e-6, 1e-3])
def test_errors_that_change_with_theta_are_seen(size: float) -> None:
    """Largest singular value of m x n errors: sqrt(m) + sqrt(n) of their size, within a third."""
    problem = sloppy_springs()
    found = information(Disturbed(problem=problem, disturb=_jittery(size)), problem.minimum)
    expected = size * 3.0 * (np.sqrt(100) + np.sqrt(8))
    assert 0.6 * expected <= found.noise.rounding <= 1.1 * expected
    assert (found.floors >= found.noise.rounding**2).all()


def test_a_wrong_derivative_is_seen() -> None:
    problem = sloppy_springs()

    def disturb(theta: Array, jacobian: Array) -> Array:
        return jacobian * np.where(np.arange(8) == 5, 1.01, 1.0)

    found = information(Disturbed(problem=problem, disturb=disturb), problem.minimum)
    column = np.linalg.norm(found.jacobian[:, 5])
    error = np.linalg.norm(found.noise.errors, axis=0)
    assert error[5] == pytest.approx(0.01 / 1.01 * column, rel=1e-6)
    assert np.delete(error, 5).max() <= DIFFERENCES * column
    expected = (error[5] * found.eigenvectors[5]) ** 2
    np.testing.assert_allclose(found.floors, expected, rtol=1e-3, atol=1e-9)


def _sum_only() -> Linear:
    matrix = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    return Linear(parameters=plain_parameters(3), matrix=matrix, data=np.zeros(3))


def test_an_undetermined_direction_is_below_its_floor() -> None:
    found = information(_sum_only(), np.ones(3))
    assert found.n_above_noise == 2
    assert found.condition == np.inf
    assert found.sd[:2].tolist() == [np.inf, np.inf]
    assert found.sd[2] == pytest.approx(1.0)
    expected = [[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(found.correlation, expected, atol=1e-12)
    assert set(found.combination(2).split()) >= {"+0.71", "-0.71", "x0.value_pct", "x1.value_pct"}


def test_fewer_residuals_than_parameters_are_no_obstacle() -> None:
    problem = Linear(parameters=plain_parameters(3), matrix=np.ones((1, 3)), data=np.zeros(1))
    found = information(problem, np.zeros(3))
    assert found.n_above_noise == 1
    assert np.isinf(found.sd).all()
    assert found.collinearity() == np.inf


def test_collinearity_is_that_of_the_angle_between_columns() -> None:
    """Equation 10 for two columns: 1 / sqrt(1 - |cosine|)."""
    cosine = 0.99
    matrix = np.array([[1.0, 7.0 * cosine, 0], [0.0, 7.0 * np.sqrt(1 - cosine**2), 0], [0, 0, 3.0]])
    problem = Linear(parameters=plain_parameters(3), matrix=matrix, data=np.zeros(3))
    found = information(problem, np.zeros(3))
    names = problem.parameters.names
    assert found.collinearity(names[:2]) == pytest.approx((1 - cosine) ** -0.5)
    assert found.collinearity([names[0], names[2]]) == pytest.approx(1.0)
    most = found.collinear_sets(2)[0]
    assert most.parameters == names[:2]
    assert most.collinearity == pytest.approx(10.0)
    assert [x.parameters for x in found.collinear_sets(3)] == [names]
    with pytest.raises(ValueError, match=r"2 to 3 .*4"):
        found.collinear_sets(4)


def test_a_parameter_without_influence_is_collinear_with_all() -> None:
    problem = Linear(parameters=plain_parameters(2), matrix=np.diag([1.0, 0.0]), data=np.zeros(2))
    assert information(problem, np.zeros(2)).collinearity() == np.inf


def test_at_a_bound_differences_go_inward() -> None:
    problem = sloppy_springs()
    upper = np.array(problem.parameters.upper)
    upper[[0, 5]] = problem.minimum[[0, 5]]
    bounded = replace(problem, parameters=replace(problem.parameters, upper=upper))
    found = information(bounded, problem.minimum)
    assert np.isfinite(found.noise.steps).all()
    assert np.linalg.norm(found.noise.errors) <= 1e-4 * np.sqrt(found.eigenvalues[0])


def test_prior_units_count_what_the_prior_says() -> None:
    problem = sloppy_springs()
    priors = ProblemWithPriors(problem=problem)
    at_center = problem.parameters.center
    both = information(priors, at_center, scaling="prior")
    data = information(problem, at_center, scaling="prior")
    np.testing.assert_allclose(both.eigenvalues, data.eigenvalues + 1.0, rtol=1e-9)


def test_names_come_largest_first() -> None:
    parameters = ligament_parameters(["ACL", "PCL"], [1, 1], [1, 1])
    text = combination(parameters.names, np.array([0.05, 0.8, -0.0, -0.59]))
    assert text == "+0.80 PCL.stiffness_kN -0.59 PCL.reference_strain_pct"


def test_the_spectrum_keeps_the_digits_of_small_eigenvalues() -> None:
    """Products of columns 1e-9 apart in size lose them: 1e-18 beside 1."""
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    values, vectors = spectrum(turn[:, :3] * np.array([1.0, 1e-9, 1e-5]))
    np.testing.assert_allclose(values, [1.0, 1e-10, 1e-18], rtol=1e-6)
    assert (vectors[np.argmax(np.abs(vectors), axis=0), range(3)] > 0).all()


def test_bad_input_is_refused() -> None:
    problem = linear()
    with pytest.raises(ValueError, match=r"x0\.value_pct.*11.*-10.*10"):
        information(problem, problem.minimum * 0 + 11.0)
    with pytest.raises(ValueError, match="scaling 'box'"):
        information(problem, problem.minimum, scaling="box")  # type: ignore[arg-type]
    silent = replace(problem, residuals_at=lambda theta: np.full(3, np.inf))
    with pytest.raises(ValueError, match=r"prediction.*theta"):
        information(silent, problem.minimum)
