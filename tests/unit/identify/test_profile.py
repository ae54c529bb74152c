"""Profiles whose ends are known in closed form, and what they say of themselves."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from problems import Cliff, ClosedForm, kinked, linear, plain_parameters, sloppy_springs

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import (
    Evaluator,
    ParameterQuantity,
    Problem,
    UserQuantity,
    with_bounds,
)
from identknee.identify.profile.profile import curve_slopes, profile
from identknee.identify.profile.result import Profile, ProfileVerdict, SideStatus
from identknee.identify.profile.walk import ProfileContext
from identknee.runs.declare import Array

Z_95 = 1.959963984540054
# Of a closed end, as a share of the half-width: the tolerance of its root and of its fit.
END = 2e-4


def _first(problem: Problem) -> ParameterQuantity:
    parameters = problem.parameters
    return ParameterQuantity(parameters=parameters, name=parameters.names[0])


def _first_sd(problem: ClosedForm) -> float:
    matrix = problem.jacobian(problem.minimum)
    return float(np.sqrt(np.linalg.inv(matrix.T @ matrix)[0, 0]))


def _single(residual: Callable[[float], float], slope: Callable[[float], float]) -> ClosedForm:
    return ClosedForm(
        name="single",
        parameters=plain_parameters(1),
        start=np.zeros(1),
        minimum=np.zeros(1),
        lowest=0.0,
        residuals_at=lambda x: np.array([residual(float(x[0]))]),
        jacobian_at=lambda x: np.array([[slope(float(x[0]))]]),
    )


def _springs() -> tuple[ClosedForm, Array]:
    problem = sloppy_springs(noise=0.02)
    scaled = ClosedForm(
        name="springs",
        parameters=problem.parameters,
        start=problem.start,
        minimum=problem.minimum,
        lowest=0.0,
        residuals_at=lambda theta: problem.residuals(theta) / 0.02,
        jacobian_at=lambda theta: problem.jacobian(theta) / 0.02,
    )
    return scaled, minimise(Evaluator(scaled), problem.minimum).evaluation.theta


def test_a_parabola_closes_at_1_96_standard_deviations() -> None:
    """The deviance is twice the log likelihood: no factor of two is lost."""
    problem = linear()
    found = profile(problem, problem.minimum, _first(problem))
    sd = _first_sd(problem)
    assert found.lower == pytest.approx(problem.minimum[0] - Z_95 * sd, abs=END * Z_95 * sd)
    assert found.upper == pytest.approx(problem.minimum[0] + Z_95 * sd, abs=END * Z_95 * sd)
    assert found.verdict is ProfileVerdict.IDENTIFIABLE
    assert found.practical_level == 0.95


def test_the_error_of_an_end_is_within_its_estimate() -> None:
    problem = linear()
    found = profile(problem, problem.minimum, _first(problem))
    sd = _first_sd(problem)
    for end, side, sign in (
        (found.lower, found.lower_side, -1),
        (found.upper, found.upper_side, 1),
    ):
        assert end is not None
        assert (
            abs(end - problem.minimum[0] - sign * Z_95 * sd) <= side.error < 2.0 * END * Z_95 * sd
        )


def test_the_curve_is_smooth_and_cheap() -> None:
    """Eight parameters: ten points or more, 35 simulations or fewer, z growing throughout."""
    problem, best = _springs()
    for name in problem.parameters.names:
        found = profile(problem, best, ParameterQuantity(parameters=problem.parameters, name=name))
        assert found.n_simulations <= 35
        assert len(found.values) >= 10
        assert np.all(np.diff(found.z) > 0)
        assert np.all(np.diff(found.values) > 0)


def test_every_point_is_a_constrained_minimum() -> None:
    problem, best = _springs()
    quantity = ParameterQuantity(parameters=problem.parameters, name="PCL.reference_strain_pct")
    found = profile(problem, best, quantity)
    for value, theta, delta in zip(found.values, found.thetas, found.deltas, strict=True):
        assert quantity.evaluate(theta)[0] == pytest.approx(value, abs=1e-12)
        held = np.array(theta)
        deviance = float(np.sum(problem.residuals(held) ** 2))
        assert deviance - found.deviance == pytest.approx(delta, abs=1e-9)


def test_a_function_of_the_parameters_has_the_profile_of_its_linear_map() -> None:
    problem = linear()
    weights = np.array([1.0, -2.0, 0.5])
    mixed = UserQuantity(name="mixed", unit="%", function=lambda x: float(weights @ x))
    found = profile(problem, problem.minimum, mixed)
    matrix = problem.jacobian(problem.minimum)
    sd = float(np.sqrt(weights @ np.linalg.solve(matrix.T @ matrix, weights)))
    assert found.upper == pytest.approx(weights @ problem.minimum + Z_95 * sd, abs=END * Z_95 * sd)
    assert found.unit == "%"


def test_an_open_side_has_no_end_and_says_why() -> None:
    problem = with_bounds(linear(), {"x0.value_pct": (-10.0, linear().minimum[0] + 0.01)})
    found = profile(problem, linear().minimum, _first(problem))
    assert found.upper is None
    assert found.upper_status is SideStatus.OPEN_AT_BOUND
    assert found.verdict is ProfileVerdict.ONE_SIDED
    assert found.upper_side.reached == problem.parameters.upper[0]
    assert 0.0 < found.practical_level < 0.95
    assert "upper" not in str(found)
    assert "open" in str(found)


def test_other_parameters_at_bounds_are_named() -> None:
    """The profile rises only because the second parameter may not follow."""
    ridge = ClosedForm(
        name="ridge",
        parameters=plain_parameters(2, -3.0, 3.0),
        start=np.zeros(2),
        minimum=np.zeros(2),
        lowest=0.0,
        residuals_at=lambda x: np.array([5.0 * (x[0] / 2 - x[1]), 0.1 * x[0]]),
        jacobian_at=lambda _: np.array([[2.5, -5.0], [0.1, 0.0]]),
    )
    bounded = with_bounds(ridge, {"x1.value_pct": (-3.0, 1.0)})
    found = profile(bounded, np.zeros(2), _first(bounded))
    assert found.upper_side.at_bounds == ("x1.value_pct",)
    assert found.upper is not None
    # 25 (x / 2 - 1)^2 + x^2 / 100 = 3.84.
    expected = np.roots([25 / 4 + 0.01, -25.0, 25.0 - Z_95**2]).max()
    assert found.upper == pytest.approx(expected, abs=END * expected)


def test_a_set_in_two_parts_is_two_intervals() -> None:
    wells = _single(lambda x: x * x - 4, lambda x: 2 * x)
    found = profile(wells, np.array([2.0]), _first(wells))
    near, far = np.sqrt(4 - Z_95), np.sqrt(4 + Z_95)
    ends = [end for interval in found.intervals for end in interval]
    np.testing.assert_allclose(np.array(ends, float), [-far, -near, near, far], atol=END)
    assert found.verdict is ProfileVerdict.MULTIMODAL
    assert set(found.branches.tolist()) == {0, 1}


def test_a_better_optimum_starts_it_over() -> None:
    tilted = ClosedForm(
        name="tilted",
        parameters=plain_parameters(1),
        start=np.zeros(1),
        minimum=np.array([2.0]),
        lowest=0.0,
        residuals_at=lambda x: np.array([x[0] ** 2 - 4.0, x[0] - 2.0]),
        jacobian_at=lambda x: np.array([[2.0 * x[0]], [1.0]]),
    )
    found = profile(tilted, np.array([-1.9]), _first(tilted))
    assert found.better_optimum is not None
    np.testing.assert_allclose(found.better_optimum, [2.0], atol=1e-5)
    assert found.n_restarts == 1
    assert found.deltas.min() >= -1e-6
    assert np.all(found.values > 0)


def test_a_start_elsewhere_adds_its_branch() -> None:
    """Far from the middle of every gap, and told of."""
    narrow = _single(lambda x: 20 * np.tanh((x + 7) * 3) * (x - 2) / 9, _slope)
    with_it = profile(narrow, np.array([2.0]), _first(narrow), starts=[[-7.0]])
    assert len(with_it.intervals) == 2
    low, high = with_it.intervals[0]
    assert low is not None
    assert high is not None
    assert low < -7.0 < high


def _slope(x: float) -> float:
    t = np.tanh((x + 7) * 3)
    return float(20 / 9 * (t + 3 * (1 - t**2) * (x - 2)))


def _two_paths(height: float, pull: float) -> ClosedForm:
    """A second parameter near 1 or -1; the path near 1 ends where the pull grows too strong."""
    return ClosedForm(
        name="two paths",
        parameters=plain_parameters(2, -6.0, 6.0),
        start=np.zeros(2),
        minimum=np.zeros(2),
        lowest=0.0,
        residuals_at=lambda x: np.array(
            [height * (x[1] ** 2 - 1), pull * (x[1] + x[0]), 0.25 * (x[0] + 1)]
        ),
        jacobian_at=lambda x: np.array([[0.0, 2 * height * x[1]], [pull, pull], [0.25, 0.0]]),
    )


@pytest.mark.parametrize(("height", "pull"), [(0.5, 0.6), (0.7, 0.6), (0.4, 0.9)])
def test_a_jump_to_another_path_is_repaired(height: float, pull: float) -> None:
    """The curve is the lowest over all values of the second parameter, tried on a grid."""
    problem = _two_paths(height, pull)
    start = minimise(Evaluator(problem), np.array([-1.0, 1.0])).evaluation.theta
    found = profile(problem, start, _first(problem))
    grid = np.linspace(-6.0, 6.0, 24001)
    for value, delta in zip(found.values, found.deltas, strict=True):
        rows = [height * (grid**2 - 1), pull * (grid + value), 0.25 * (value + 1) + 0 * grid]
        lowest = float(np.min(np.sum(np.square(rows), axis=0)))
        # The grid's own error, and what a fit on the curve may leave.
        assert delta == pytest.approx(lowest - found.deviance, abs=5e-3)


def test_a_jump_of_the_deviance_at_the_boundary_of_the_model_is_an_end() -> None:
    """Beyond 1 the model goes on only where the second parameter is above 0.5, and far too high."""
    plane = ClosedForm(
        name="plane",
        parameters=plain_parameters(2),
        start=np.zeros(2),
        minimum=np.zeros(2),
        lowest=0.0,
        residuals_at=lambda x: np.array([0.5 * x[0], x[1], 10.0 * (x[0] > 1.0)]),
        jacobian_at=lambda _: np.array([[0.5, 0.0], [0.0, 1.0], [0.0, 0.0]]),
    )
    gap = Cliff(problem=plane, beyond=lambda x: min(x[0] - 1.0, 0.5 - x[1]))
    found = profile(gap, np.zeros(2), _first(gap))
    assert found.upper == pytest.approx(1.0, abs=2e-3)
    assert found.n_simulations < 500


def test_where_the_model_ends_before_the_data_exclude_anything_the_set_is_open() -> None:
    wall = Cliff(problem=_single(lambda x: x, lambda _: 1.0), beyond=lambda x: x[0] - 1.0)
    found = profile(wall, np.zeros(1), _first(wall))
    assert found.upper_status is SideStatus.OPEN_AT_FEASIBILITY
    assert found.upper is None
    assert found.upper_side.reached == pytest.approx(1.0, abs=1e-3)
    assert found.upper_side.max_deviance == pytest.approx(1.0, abs=2e-3)
    assert found.verdict is ProfileVerdict.ONE_SIDED


def test_a_path_that_runs_into_a_gap_goes_around_it() -> None:
    """A hole in the feasible set lies on the path; a way around costs less than the threshold."""

    def hole(x: Array) -> float:
        return float(0.3 - np.hypot(x[0] - 1.0, x[1]))

    problem = _two_directions()
    found = profile(Cliff(problem=problem, beyond=hole), np.zeros(2), _first(problem))
    free = profile(problem, np.zeros(2), _first(problem))
    assert found.upper_status is SideStatus.CLOSED
    assert found.verdict is ProfileVerdict.IDENTIFIABLE
    assert found.upper == pytest.approx(free.upper, rel=1e-3)
    assert len(found.intervals) == 1
    assert not any(hole(x) > 0 for x in found.thetas)


def test_values_without_prediction_do_not_part_a_set() -> None:
    """No value of the first parameter within 0.9 and 1.1 has a prediction, whatever the second."""
    problem = _two_directions()
    cut = Cliff(problem=problem, beyond=lambda x: float(0.1 - abs(x[0] - 1.0)))
    found = profile(cut, np.zeros(2), _first(problem))
    assert len(found.intervals) == 1
    assert found.upper_status is SideStatus.CLOSED
    assert found.verdict is ProfileVerdict.IDENTIFIABLE


def test_an_end_that_only_the_boundary_raises_is_no_limit() -> None:
    """The second parameter would follow the first, but has no prediction above 0.2."""
    problem = _two_directions(coupling=0.9)
    cut = Cliff(problem=problem, beyond=lambda x: float(x[1]) - 0.2)
    found = profile(cut, np.zeros(2), _first(problem))
    assert found.lower_status is SideStatus.CLOSED
    assert found.upper_status is SideStatus.OPEN_AT_FEASIBILITY
    assert found.verdict is ProfileVerdict.ONE_SIDED


def test_a_fit_stopped_at_the_boundary_lends_the_curve_no_slope() -> None:
    problem = linear()
    evaluator = Evaluator(problem)
    walk = ProfileContext(evaluator, _first(problem), 3.84, evaluator(problem.minimum))
    sd, best = _first_sd(problem), float(problem.minimum[0])
    points = [walk.point(walk.solve(best + x * sd, problem.minimum)) for x in (0.0, 0.5, 1.5)]
    stopped = replace(points[1], slope=-99.0, predicted_reduction=walk.threshold)
    exact = curve_slopes(walk, points)
    found = curve_slopes(walk, [points[0], stopped, points[2]])
    np.testing.assert_array_equal(exact, [x.slope for x in points])
    np.testing.assert_array_equal(found[[0, 2]], exact[[0, 2]])
    # Chords of a parabola through three points give its slope.
    assert found[1] == pytest.approx(exact[1], rel=1e-6)


def _two_directions(coupling: float = 0.0) -> ClosedForm:
    """Two parameters measured with unit noise, and, with a coupling, their difference well."""
    rows = np.array([[1.0, 0.0], [0.0, 1.0]]) / (1.0 + 3.0 * coupling)
    rows = np.vstack([rows, coupling * 5.0 * np.array([1.0, -1.0])])
    return ClosedForm(
        name="two directions",
        parameters=plain_parameters(2, -6.0, 6.0),
        start=np.zeros(2),
        minimum=np.zeros(2),
        lowest=0.0,
        residuals_at=lambda x: rows @ x,
        jacobian_at=lambda _: rows,
    )


def test_the_budget_leaves_a_side_open_and_claims_nothing() -> None:
    problem, best = _springs()
    found = profile(problem, best, _first(problem), budget=7)
    assert found.n_simulations <= 7
    assert found.upper_status is SideStatus.OPEN_BUDGET
    assert found.verdict is ProfileVerdict.UNDETERMINED


def test_a_fit_that_the_budget_did_not_allow_is_a_point_without_a_predicted_reduction() -> None:
    """A better optimum met with the last simulation starts a profile over without any left."""
    problem = linear()
    evaluator = Evaluator(problem, budget=1)
    walk = ProfileContext(evaluator, _first(problem), 3.84, evaluator(problem.minimum))
    point = walk.point(walk.solve(1.0, problem.minimum + 1.0))
    assert point.evaluation.deviance == np.inf
    assert not walk.is_settled(point)


def test_a_path_along_a_kink_is_followed_and_costs_little() -> None:
    """The deviance rises by 1.5 times the square of the way along it, in closed form."""
    problem = kinked()
    found = profile(problem, problem.minimum, _first(problem))
    half = np.sqrt(found.threshold / 1.5)
    assert found.lower == pytest.approx(problem.minimum[0] - half, abs=1e-3 * half)
    assert found.upper == pytest.approx(problem.minimum[0] + half, abs=1e-3 * half)
    assert found.n_simulations <= 80


def test_lower_levels_are_read_off_the_curve() -> None:
    problem = linear()
    found = profile(problem, problem.minimum, _first(problem))
    ((low, high),) = found.intervals_at(0.6826894921370859)
    sd = _first_sd(problem)
    assert low is not None
    assert high is not None
    # A cubic through a parabola is that parabola.
    assert high - low == pytest.approx(2.0 * sd, rel=1e-4)
    assert found.intervals_at(0.95) == found.intervals
    with pytest.raises(ValueError, match=r"level.* 0 .*0.95.*0.99"):
        found.intervals_at(0.99)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"level": 1.0}, "the level must be between 0 and 1, got 1"),
        ({"threshold": 0.0}, "the threshold must be positive and finite, got 0"),
        ({"budget": 0}, "the budget must be at least 1 simulation, got 0"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, float], sentence: str) -> None:
    problem = linear()
    with pytest.raises(ValueError, match=sentence):
        profile(problem, problem.minimum, _first(problem), **settings)  # type: ignore[arg-type]


def test_a_look_that_joins_the_optimum_ends_with_its_first_simulation() -> None:
    """Where residuals are linear, the derivatives say from anywhere where a fit ends."""
    problem = linear()
    starts = problem.minimum + np.array([[3.0, 1.0, -2.0], [-1.0, 4.0, 2.0]])
    alone = profile(problem, problem.minimum, _first(problem))
    found = profile(problem, problem.minimum, _first(problem), starts=starts)
    assert found.n_simulations == alone.n_simulations + len(starts)
    assert found.intervals == alone.intervals


def test_an_optimum_without_a_prediction_is_refused() -> None:
    nowhere = Cliff(problem=linear(), beyond=lambda _: 1.0)
    with pytest.raises(ValueError, match=r"prediction.*optimum"):
        profile(nowhere, np.zeros(3), _first(nowhere))


def test_all_sentences_are_there() -> None:
    for word in (*SideStatus, *ProfileVerdict):
        assert word.sentence.endswith(".")


def test_a_profile_explains_itself() -> None:
    problem = linear()
    found: Profile = profile(problem, problem.minimum, _first(problem))
    assert str(found).startswith("x0.value_pct: ")
    assert "95% set" in str(found)


def test_a_constant_quantity_is_one_value() -> None:
    """A slack ligament's force: it does not change around the optimum, nor at any likely end."""
    problem = linear()
    slack = UserQuantity(name="force", unit="N", function=lambda x: max(0.0, float(x[0]) - 9.0))
    found = profile(problem, problem.minimum, slack)
    assert found.intervals == ((0.0, 0.0),)
    assert found.verdict is ProfileVerdict.IDENTIFIABLE


def test_a_quantity_constant_at_the_optimum_only_has_an_upper_end() -> None:
    problem = linear()
    sd = _first_sd(problem)
    edge = float(problem.minimum[0]) + sd

    def force(x: Array) -> float:
        return max(0.0, float(x[0]) - edge)

    found = profile(problem, problem.minimum, UserQuantity(name="force", unit="N", function=force))
    assert len(found.intervals) == 1
    assert found.upper == pytest.approx((Z_95 - 1.0) * sd, abs=END * Z_95 * sd)
    assert found.lower_side.reached == pytest.approx(0.0, abs=1e-6)
