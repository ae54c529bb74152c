"""Pairs of parameters: an ellipse in closed form, bounds, and better fits on the way."""

import numpy as np
import pytest
from problems import ClosedForm, linear, plain_parameters

from identknee.calibrate.problem import with_bounds
from identknee.identify.profile.pairs import profile_pair
from identknee.identify.profile.result import SideStatus, chi2_threshold

# Of the threshold: twice the tolerance of an end's signed root, and what the fit may leave.
END = 4e-4
NAMES = ("x0.value_pct", "x2.value_pct")


def test_of_a_linear_problem_it_is_the_ellipse_of_its_covariance() -> None:
    problem = linear()
    found = profile_pair(problem, problem.minimum, NAMES)
    matrix = problem.jacobian(problem.minimum)
    covariance = np.linalg.inv(matrix.T @ matrix)[np.ix_([0, 2], [0, 2])]
    for level in (0.5, 0.95):
        away = found.contour(level) - problem.minimum[[0, 2]]
        rise = np.sum(away * np.linalg.solve(covariance, away.T).T, axis=1)
        np.testing.assert_allclose(rise, chi2_threshold(level, 2), rtol=END)
    assert all(ray.status is SideStatus.CLOSED for ray in found.rays)
    assert found.n_simulations < 24 * 20


def test_bounds_cut_the_set() -> None:
    problem = with_bounds(linear(), {"x0.value_pct": (-10.0, linear().minimum[0] + 0.05)})
    found = profile_pair(problem, linear().minimum, NAMES)
    cut = [ray for ray in found.rays if ray.status is SideStatus.OPEN_AT_BOUND]
    assert 0 < len(cut) < len(found.rays)
    for ray in cut:
        assert ray.end[0] == pytest.approx(problem.parameters.upper[0])
    assert np.isnan(found.contour(0.95)).any()


def test_a_better_fit_starts_it_over() -> None:
    wells = ClosedForm(
        name="wells",
        parameters=plain_parameters(2, -4.0, 4.0),
        start=np.zeros(2),
        minimum=np.array([2.0, 0.0]),
        lowest=0.0,
        residuals_at=lambda x: np.array([(x[0] ** 2 - 4) / 4, (x[0] - 2) / 4, x[1]]),
        jacobian_at=lambda x: np.array([[x[0] / 2, 0.0], [0.25, 0.0], [0.0, 1.0]]),
    )
    found = profile_pair(wells, np.array([-1.8, 0.0]), wells.parameters.names)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.optimum, [2.0, 0.0], atol=1e-3)


def test_the_wrong_pair_is_refused() -> None:
    problem = linear()
    with pytest.raises(ValueError, match=r"x0\.value_pct.*twice"):
        profile_pair(problem, problem.minimum, ("x0.value_pct", "x0.value_pct"))
    with pytest.raises(ValueError, match="parameter 'x9'"):
        profile_pair(problem, problem.minimum, ("x0.value_pct", "x9"))
