"""Several profiles at once: order, thresholds, resuming, and one optimum for all."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from problems import Cliff, ClosedForm, Linear, linear, plain_parameters, rosenbrock

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import (
    Evaluator,
    ParameterQuantity,
    Quantity,
    RestrictedQuantity,
    UserQuantity,
    with_bounds,
    with_room_doubled,
)
from identknee.identify.profile.profile import (
    other_optima,
    polish_optimum,
    profile,
    profile_parameters,
    profile_quantities,
)
from identknee.identify.profile.result import Profile
from identknee.runs.schema import from_plain, to_plain
from identknee.runs.store import json_round_trip, open_work


def _same(one: Profile, other: Profile) -> bool:
    return bool(json_round_trip(to_plain(one)) == json_round_trip(to_plain(other)))


def test_profiles_come_in_the_order_of_their_names() -> None:
    problem = linear()
    names = ["x2.value_pct", "x0.value_pct"]
    found = profile_parameters(problem, problem.minimum, names)
    assert [x.name for x in found] == names
    assert [x.name for x in profile_parameters(problem, problem.minimum)] == list(
        problem.parameters.names
    )
    assert profile_parameters(problem, problem.minimum, []) == ()


def test_a_profile_survives_json() -> None:
    problem = linear()
    first = ParameterQuantity(parameters=problem.parameters, name="x0.value_pct")
    found = profile(problem, problem.minimum, first)
    again = from_plain(Profile, json_round_trip(to_plain(found)))
    assert _same(found, again)
    assert again.verdict is found.verdict
    assert again.upper_status is found.upper_status


def test_finished_profiles_are_not_made_again(tmp_path: Path) -> None:
    whole = linear()
    problem = Linear(
        parameters=whole.parameters,
        matrix=whole.jacobian(whole.minimum),
        data=-whole.residuals(np.zeros(3)),
    )
    with open_work(tmp_path / "work.sqlite", {"of": "linear"}) as store:
        first = profile_parameters(problem, whole.minimum, store=store)
    broken = Linear(
        parameters=problem.parameters, matrix=problem.matrix * np.nan, data=problem.data
    )
    with open_work(tmp_path / "work.sqlite", {"of": "linear"}) as store:
        second = profile_parameters(broken, whole.minimum, store=store)
    assert all(_same(one, other) for one, other in zip(first, second, strict=True))


def test_each_may_have_its_own_threshold() -> None:
    problem = linear()
    narrow, wide, _ = profile_parameters(problem, problem.minimum, thresholds=[1.0, 4.0, 1.0])
    assert (narrow.threshold, wide.threshold) == (1.0, 4.0)
    same = profile_parameters(problem, problem.minimum, thresholds=2.0)
    assert {x.threshold for x in same} == {2.0}


def test_a_better_fit_met_by_one_is_the_optimum_of_all() -> None:
    """Only the first parameter's own profile looks where the better fit is."""
    wells = ClosedForm(
        name="wells",
        parameters=plain_parameters(2, -5.0, 4.0),
        start=np.zeros(2),
        minimum=np.array([2.0, 0.0]),
        lowest=0.0,
        residuals_at=lambda x: np.array([x[0] ** 2 - 4, x[0] - 2, x[1] * (1 + x[0] / 10)]),
        jacobian_at=lambda x: np.array([[2 * x[0], 0.0], [1.0, 0.0], [x[1] / 10, 1 + x[0] / 10]]),
    )
    found = profile_parameters(wells, np.array([-1.87, 0.0]))
    for one in found:
        np.testing.assert_allclose(one.optimum, [2.0, 0.0], atol=1e-4)


def test_the_optimum_is_polished_once_for_all() -> None:
    """Each goes on from there, as one alone does that is given the polished optimum."""
    bent = rosenbrock()
    found = profile_parameters(bent, bent.start, starts=())
    optimum = polish_optimum(bent, bent.start, threshold=found[0].threshold)
    np.testing.assert_allclose(optimum.theta, bent.minimum, atol=1e-3)
    for one in found:
        quantity = ParameterQuantity(parameters=bent.parameters, name=one.name)
        assert _same(profile(bent, optimum, quantity), one)
        alone = profile(bent, bent.start, quantity)
        assert alone.n_simulations > one.n_simulations + 5
        assert alone.intervals == one.intervals


def test_the_optimum_with_twice_the_room_is_looked_for_where_a_bound_is_active() -> None:
    problem = linear()
    low, high = problem.minimum[1] - 3.0, problem.minimum[1] - 0.5
    boxed = with_bounds(problem, {"x1.value_pct": (float(low), float(high))})
    best = minimise(Evaluator(boxed), np.clip(problem.minimum, low, high)).evaluation.theta
    found = polish_optimum(boxed, best, threshold=3.84)
    wider = with_room_doubled(boxed, boxed.parameters.names)
    expected = minimise(Evaluator(wider), best).evaluation.theta
    assert found.with_room is not None
    np.testing.assert_allclose(found.with_room, expected, atol=1e-6)
    assert polish_optimum(problem, problem.minimum, threshold=3.84).with_room is None
    # Ends and what makes them are the same; only simulations are saved.
    quantity = ParameterQuantity(parameters=boxed.parameters, name="x0.value_pct")
    alone, shared = (profile(boxed, x, quantity) for x in (replace(found, with_room=None), found))
    assert shared.intervals == alone.intervals
    assert shared.lower_side.made_by is alone.lower_side.made_by
    assert shared.n_simulations < alone.n_simulations


def _many_valleys(seed: int) -> ClosedForm:
    """A parameter beside a nuisance in which the deviance has a valley every few units."""
    rng = np.random.default_rng(seed)
    a, b, h, w = rng.uniform([0.3, 0.4, 0.6, 1.5], [0.8, 1.0, 1.4, 3.0])
    phase = rng.uniform(0.0, 2.0 * np.pi)
    plain = plain_parameters(2, -12.0, 12.0)
    return ClosedForm(
        name="many valleys",
        parameters=replace(plain, is_nuisance=np.array([False, True])),
        start=np.zeros(2),
        minimum=np.zeros(2),
        lowest=0.0,
        residuals_at=lambda x: np.array(
            [a * x[0], b * (x[1] - x[0]), h * np.sin(w * x[1] + phase), 0.3 * x[1]]
        ),
        jacobian_at=lambda x: np.array(
            [[a, 0.0], [-b, b], [0.0, h * w * np.cos(w * x[1] + phase)], [0.0, 0.3]]
        ),
    )


def test_ends_are_those_of_the_lowest_valley_of_a_nuisance() -> None:
    """Of sixteen ends, against a grid over both. Walked from the best fit alone, a third miss."""
    n_missed = 0
    grid = np.linspace(-12.0, 12.0, 801)
    x0, x1 = (x.ravel() for x in np.meshgrid(grid, grid, indexing="ij"))
    for seed in range(8):
        problem = _many_valleys(seed)
        rows = problem.residuals_at(np.array([x0, x1]))
        deviance = np.sum(np.square(rows), axis=0).reshape(grid.size, grid.size)
        best = np.argmin(deviance)
        lowest = minimise(Evaluator(problem), np.array([x0[best], x1[best]])).evaluation
        (found,) = profile_parameters(problem, lowest.theta, ["x0.value_pct"])
        inside = grid[deviance.min(axis=1) - lowest.deviance < found.threshold]
        width = inside[-1] - inside[0]
        for end, there in ((found.lower, inside[0]), (found.upper, inside[-1])):
            assert end is not None
            n_missed += abs(end - there) > 0.02 * width
    assert n_missed == 0


def _two_valleys(tilt: float) -> ClosedForm:
    """Two valleys of a nuisance, of which that at 2 is lower by 16 times the squared tilt."""
    plain = plain_parameters(2, -9.0, 9.0)
    return ClosedForm(
        name="two valleys",
        parameters=replace(plain, is_nuisance=np.array([False, True])),
        start=np.zeros(2),
        minimum=np.array([0.5, 2.0]),
        lowest=0.0,
        residuals_at=lambda x: np.array(
            [x[0] - x[1] / 4.0, 2.0 * (x[1] ** 2 - 4.0), tilt * (x[1] - 2.0)]
        ),
        jacobian_at=lambda x: np.array([[1.0, -0.25], [0.0, 4.0 * x[1]], [0.0, tilt]]),
    )


@pytest.mark.parametrize(("gain", "most_restarts"), [(0.15, 0), (1.0, 1)])
def test_above_a_little_lower_fit_ends_lie_where_they_do_from_it(
    gain: float, most_restarts: int
) -> None:
    """Beside nuisances nothing is walked again for less than a twentieth of the threshold."""
    problem = _two_valleys(np.sqrt(gain) / 4.0)
    quantities: list[Quantity] = [
        ParameterQuantity(parameters=problem.parameters, name="x0.value_pct"),
        UserQuantity(
            name="sum", unit="", function=lambda x: float(x.sum()), gradient=lambda _: np.ones(2)
        ),
    ]
    (first, other), expected = (
        profile_quantities(problem, start, quantities)
        for start in (np.array([-0.5, -2.0]), problem.minimum)
    )
    assert max(first.n_restarts, other.n_restarts) <= most_restarts
    for found, wanted in zip((first, other), expected, strict=True):
        np.testing.assert_allclose(found.optimum, problem.minimum, atol=1e-3)
        assert found.deviance == pytest.approx(0.0, abs=1e-5)
        assert found.optimum_value == pytest.approx(wanted.optimum_value, abs=1e-3)
        ends, there = (np.array(x.intervals, float).ravel() for x in (found, wanted))
        np.testing.assert_allclose(ends, there, atol=2e-3)
        np.testing.assert_allclose(found.deltas.min(), 0.0, atol=1e-3)


def test_an_optimum_without_a_prediction_is_refused() -> None:
    nowhere = Cliff(problem=linear(), beyond=lambda _: 1.0)
    with pytest.raises(ValueError, match=r"prediction.*optimum"):
        profile_parameters(nowhere, np.zeros(3), starts=())


def test_other_optima_are_found_once_each_and_count_unless_declined() -> None:
    """Sum 3 and product 2: the two parameters may exchange their values."""
    exchangeable = ClosedForm(
        name="exchangeable",
        parameters=plain_parameters(2, 0.0, 9.0),
        start=np.zeros(2),
        minimum=np.array([1.0, 2.0]),
        lowest=0.0,
        residuals_at=lambda x: np.array([x.sum() - 3.0, x.prod() - 2.0]) / 0.05,
        jacobian_at=lambda x: np.array([[1.0, 1.0], [x[1], x[0]]]) / 0.05,
    )
    found = other_optima(exchangeable, exchangeable.minimum, threshold=4.0)
    np.testing.assert_allclose(found, [[2.0, 1.0]], atol=1e-5)
    given = profile_parameters(exchangeable, exchangeable.minimum, starts=found)
    unasked = profile_parameters(exchangeable, exchangeable.minimum)
    for one, other in zip(given, unasked, strict=True):
        assert len(one.intervals) == 2
        np.testing.assert_array_equal(one.intervals, other.intervals)
    (alone, _) = profile_parameters(exchangeable, exchangeable.minimum, starts=())
    assert len(alone.intervals) == 1
    problem = linear()
    assert other_optima(problem, problem.minimum, threshold=4.0).shape == (0, 3)


def test_a_restricted_quantity_sees_the_parameters_that_move() -> None:
    total = UserQuantity(name="total", unit="%", function=lambda x: float(x @ [1.0, 2.0, 4.0]))
    free = plain_parameters(3).with_fixed(["x1.value_pct"], [9.0, 5.0, 9.0])
    part = RestrictedQuantity(quantity=total, free=free)
    value, gradient = part.evaluate(np.array([1.0, 1.0]))
    assert value == pytest.approx(15.0)
    np.testing.assert_allclose(gradient, [1.0, 4.0], rtol=1e-9)
    assert (part.name, part.unit) == ("total", "%")


def test_functions_are_profiled_beside_parameters() -> None:
    problem = linear()
    total = UserQuantity(name="total", unit="%", function=lambda x: float(x.sum()))
    (found,) = profile_quantities(problem, problem.minimum, [total])
    assert found.name == "total"
    assert found.optimum_value == pytest.approx(problem.minimum.sum())
