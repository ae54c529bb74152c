"""Geodesics against straight lines and great circles, and every boundary by its name."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from problems import Cliff, ClosedForm, linear, plain_parameters, sloppy_springs

from identknee.calibrate.problem import restricted
from identknee.identify import information as geodesic
from identknee.identify.information import Boundary, Geodesic, geodesics, spectrum
from identknee.runs.declare import Array

# Steps of a tenth of a radian at most by the midpoint rule.
PATH = 2e-3


def _problem(
    residuals: Callable[[Array], Array], jacobian: Callable[[Array], Array], start: Array
) -> ClosedForm:
    return ClosedForm(
        name="surface",
        parameters=plain_parameters(start.size),
        start=start,
        minimum=start,
        lowest=0.0,
        residuals_at=residuals,
        jacobian_at=jacobian,
    )


def _sphere(size: float) -> ClosedForm:
    """Residuals on a sphere, the parameters its latitude and longitude in units of 10 degrees."""

    def residuals(x: Array) -> Array:
        lat, lon = x / 6.0
        return size * np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])

    def jacobian(x: Array) -> Array:
        lat, lon = x / 6.0
        by_lat = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
        by_lon = [-np.cos(lat) * np.sin(lon), np.cos(lat) * np.cos(lon), 0.0]
        return size / 6.0 * np.array([by_lat, by_lon]).T

    return _problem(residuals, jacobian, np.array([3.0, 0.0]))


def test_on_a_plane_they_are_straight_and_end_at_the_box() -> None:
    problem = linear()
    sloppiest = spectrum(2.0 * problem.jacobian(problem.minimum))[1][:, -1]
    for path, sign in zip(geodesics(problem, problem.minimum), (1.0, -1.0), strict=True):
        np.testing.assert_allclose(path.directions, sign * sloppiest + 0 * path.directions)
        assert path.boundary is Boundary.BOUND
        place = problem.parameters.index(path.involved[0])
        assert abs(path.thetas[-1, place]) == 10.0
        move = path.thetas - path.thetas[0]
        across = move - np.outer(move @ sloppiest, sloppiest)
        assert np.abs(across).max() <= 1e-9
        # On a plane the way on the surface is the distance of its ends.
        ends = problem.residuals(path.thetas[-1]) - problem.residuals(path.thetas[0])
        assert path.lengths[-1] == pytest.approx(np.linalg.norm(ends), rel=1e-9)


def test_on_a_sphere_they_are_great_circles(monkeypatch: pytest.MonkeyPatch) -> None:
    """And twice as short steps make a quarter of the error."""
    problem = _sphere(5.0)
    errors = []
    for step in (0.25, 0.125):
        monkeypatch.setattr(geodesic, "LONGEST_STEP", step)
        monkeypatch.setattr(geodesic, "DIFFERENCE_STEP", 0.1 * step)
        path = geodesics(problem, problem.start)[0]
        assert len(path.thetas) > 15
        places = np.array([problem.residuals(theta) for theta in path.thetas]) / 5.0
        leaves = problem.jacobian(path.thetas[0]) @ path.directions[0]
        normal = np.cross(places[0], leaves / np.linalg.norm(leaves))
        errors.append(float(np.abs(places @ normal).max()))
        angles = np.arccos(np.clip(places @ places[0], -1.0, 1.0))
        near = angles < 2.0
        np.testing.assert_allclose(path.lengths[near], 5.0 * angles[near], rtol=PATH, atol=1e-6)
    assert errors[0] <= PATH
    assert errors[1] <= 0.35 * errors[0]


def _exponential() -> ClosedForm:
    times = np.array([0.5, 1.0, 2.0])
    return _problem(
        lambda x: 3.0 * np.exp(-x[0] * times),
        lambda x: (-3.0 * times * np.exp(-x[0] * times))[:, None],
        np.array([1.0]),
    )


def _saturating() -> ClosedForm:
    """The sum of two parameters stops to matter, their difference never does."""

    def jacobian(x: Array) -> Array:
        slope = 0.3 / np.cosh(0.3 * (x[0] + x[1])) ** 2
        return np.array([[slope, slope], [5.0, -5.0]])

    return _problem(
        lambda x: np.array([np.tanh(0.3 * (x[0] + x[1])), 5.0 * (x[0] - x[1])]),
        jacobian,
        np.zeros(2),
    )


def _stiffness() -> ClosedForm:
    problem = linear()
    names = ("a.stiffness_kN", *problem.parameters.names[1:])
    lower = np.where(np.arange(problem.parameters.n) == 0, 0.0, -1e3)
    parameters = replace(
        problem.parameters, names=names, lower=lower, upper=np.full(problem.parameters.n, 1e3)
    )
    return replace(problem, parameters=parameters, minimum=np.array(problem.minimum) + 5.0)


def _by_boundary(paths: tuple[Geodesic, Geodesic]) -> dict[Boundary, tuple[str, ...]]:
    return {path.boundary: path.involved for path in paths}


def test_a_rate_that_runs_off_loses_its_influence() -> None:
    problem = _exponential()
    wide = replace(problem, parameters=replace(problem.parameters, upper=np.array([40.0])))
    found = _by_boundary(geodesics(wide, np.array([1.0])))
    assert found[Boundary.NO_INFLUENCE] == ("x0.value_pct",)


def test_a_slack_spring_is_named() -> None:
    """With its stiffness held, a looser reference strain makes it slack in all trials."""
    problem = sloppy_springs()
    strain = "MCL.reference_strain_pct"
    others = [name for name in problem.parameters.names if name != strain]
    only = restricted(problem, others, problem.minimum)
    found = _by_boundary(geodesics(only, problem.minimum[-1:]))
    assert found == {Boundary.NO_INFLUENCE: (strain,), Boundary.BOUND: (strain,)}


def test_a_sum_that_saturates_comes_to_a_standstill() -> None:
    for path in geodesics(_saturating(), np.zeros(2)):
        assert path.boundary is Boundary.STANDSTILL
        assert path.involved == ("x0.value_pct", "x1.value_pct")
        assert path.speeds[-1] < 1e-3 * path.speeds[0]


def test_a_stiffness_arrives_at_zero() -> None:
    problem = _stiffness()
    found = _by_boundary(geodesics(problem, problem.minimum))
    assert found[Boundary.ZERO] == ("a.stiffness_kN",)


def test_without_bounds_it_goes_on_for_ever() -> None:
    problem = linear()
    wide = replace(problem.parameters, lower=np.full(3, -np.inf), upper=np.full(3, np.inf))
    for path in geodesics(replace(problem, parameters=wide), problem.minimum):
        assert path.boundary is Boundary.INFINITY


def test_a_cliff_is_approached_to_a_thousandth() -> None:
    problem = linear()
    sloppiest = spectrum(2.0 * problem.jacobian(problem.minimum))[1][:, -1]
    wall = float(sloppiest @ problem.minimum) + 1.0
    cliff = Cliff(problem=problem, beyond=lambda x: float(sloppiest @ x) - wall)
    path = geodesics(cliff, problem.minimum)[0]
    assert path.boundary is Boundary.CLIFF
    assert 0.0 <= wall - float(sloppiest @ path.thetas[-1]) <= 2.0 * 2e-3
    assert "no prediction" in path.sentence


def test_the_budget_ends_it() -> None:
    problem = sloppy_springs()
    for path in geodesics(problem, problem.minimum, budget=20):
        assert path.boundary is Boundary.BUDGET
        assert path.n_simulations == 20


def test_a_start_without_prediction_is_refused() -> None:
    cliff = Cliff(problem=linear(), beyond=lambda _: 1.0)
    with pytest.raises(ValueError, match=r"prediction.*theta"):
        geodesics(cliff, np.zeros(3))
