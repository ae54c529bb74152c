from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from problems import IG2, IG4, linear, sloppy_springs

from identknee.calibrate.population import Complex, minimise_by_complex
from identknee.calibrate.problem import Evaluator
from identknee.runs.declare import Array
from identknee.runs.record import Outcome

START = np.array([5.0, 0.5])
HALF_WIDTHS = np.array([2.0, 3.0])
NO_FLOORS = np.full(2, -np.inf)


def a_complex(floors: ArrayLike = NO_FLOORS, seed: int = 3) -> Complex:
    return Complex(
        start=START,
        half_widths=HALF_WIDTHS,
        floors=np.asarray(floors),
        generator=np.random.default_rng(seed),
    )


def told_first(search: Complex, worst: int = 7) -> tuple[Array, Array]:
    """First candidates, told that number `worst` is the worst, and the centroid of the others."""
    first = np.array(search.ask())
    values = np.linspace(1.0, 2.0, 20)
    values[worst] = 10.0
    search.tell(values)
    return first, np.delete(first, worst, axis=0).mean(axis=0)


def test_first_candidates_are_twenty_from_the_box_around_the_start() -> None:
    first = a_complex().ask()
    assert first.shape == (20, 2)
    assert np.all(np.abs(first - START) <= HALF_WIDTHS)
    assert np.all(np.ptp(first, axis=0) > HALF_WIDTHS), "they fill more than half of it"
    assert not np.any(np.all(first == START, axis=1)), "the start is no member"


def test_the_worst_is_reflected_by_nine_tenths() -> None:
    search = a_complex()
    first, centroid = told_first(search)
    expected = centroid + 0.9 * (centroid - first[7])
    np.testing.assert_allclose(search.ask(), expected[None], rtol=1e-14)


def test_an_improved_candidate_takes_the_place_of_the_worst() -> None:
    search = a_complex()
    told_first(search)
    reflected = np.array(search.ask()[0])
    search.tell(np.array([1.5]))
    np.testing.assert_array_equal(search.population[7], reflected)
    # Next is the one with the second worst value, number 19.
    others = np.delete(search.population, 19, axis=0).mean(axis=0)
    np.testing.assert_allclose(
        search.ask()[0], others + 0.9 * (others - search.population[19]), rtol=1e-14
    )


def test_four_halvings_then_a_new_candidate_from_the_box() -> None:
    search = a_complex()
    _, centroid = told_first(search)
    reflected = np.array(search.ask()[0])
    for attempt in range(1, 5):
        search.tell(np.array([11.0]))
        expected = centroid + (reflected - centroid) / 2**attempt
        np.testing.assert_allclose(search.ask()[0], expected, rtol=1e-14)
    before = np.array(search.population)
    search.tell(np.array([11.0]))
    new = np.array(search.ask()[0])
    assert np.all(np.abs(new - START) <= HALF_WIDTHS)
    assert np.linalg.norm(new - centroid) > np.linalg.norm(reflected - centroid) / 16
    np.testing.assert_array_equal(search.population, before)
    search.tell(np.array([np.inf]))
    np.testing.assert_array_equal(search.population[7], new)
    # It is a member whatever its objective, hence now the worst to be reflected.
    np.testing.assert_allclose(search.ask()[0], centroid + 0.9 * (centroid - new), rtol=1e-14)


def test_replacement_comes_from_the_starts_box_wherever_the_population_is() -> None:
    search = a_complex()
    told_first(search)
    # Downhill without an end: each reflected candidate is better, and the complex wanders off.
    for _ in range(400):
        search.tell(-search.ask().sum(axis=1))
    assert np.all(search.population.mean(axis=0) > START + HALF_WIDTHS)
    for _ in range(5):
        search.tell(np.array([np.inf]))
    assert np.all(np.abs(search.ask()[0] - START) <= HALF_WIDTHS)


def test_no_prediction_is_no_improvement_even_among_such() -> None:
    search = a_complex()
    search.ask()
    search.tell(np.full(20, np.inf))
    reflected, centroid = np.array(search.ask()[0]), search.population[1:].mean(axis=0)
    search.tell(np.array([np.inf]))
    np.testing.assert_allclose(search.ask()[0], (reflected + centroid) / 2, rtol=1e-14)


def test_floors_hold_for_first_reflected_and_new_candidates() -> None:
    floors = np.array([4.5, -np.inf])
    search = a_complex(floors)
    lowest = []
    for _ in range(300):
        candidates = search.ask()
        lowest.append(candidates[:, 0].min())
        search.tell(candidates[:, 0] ** 2 + candidates[:, 1] ** 2)
    assert min(lowest) == 4.5
    assert search.population[:, 1].min() < START[1], "the other one has no floor"


def slow_complex(
    objective: Callable[[Array], float],
    start: Array,
    half_widths: Array,
    floor: Array,
    rng: np.random.Generator,
    budget: int,
) -> Array:
    """The method again as one loop: the oracle."""
    trail: list[Array] = []

    def new() -> Array:
        return np.maximum(rng.uniform(start - half_widths, start + half_widths), floor)

    def evaluate(point: Array) -> float:
        trail.append(np.array(point))
        return objective(point)

    points = [new() for _ in range(20)]
    values = [evaluate(point) for point in points]
    while len(trail) < budget:
        worst = values.index(max(values))
        others = [point for i, point in enumerate(points) if i != worst]
        second = max(value for i, value in enumerate(values) if i != worst)
        center = sum(others) / 19
        trial = np.maximum(center + 0.9 * (center - points[worst]), floor)
        value = evaluate(trial)
        attempts = 0
        while value > second and attempts < 4:
            trial = np.maximum((trial + center) / 2, floor)
            value = evaluate(trial)
            attempts += 1
        if value > second:
            trial = new()
            value = evaluate(trial)
        points[worst], values[worst] = trial, value
    return np.array(trail[:budget])


@pytest.mark.parametrize("start", [IG2, IG4], ids=["IG2", "IG4"])
def test_follows_the_same_trail_as_a_plain_loop(start: Any) -> None:
    problem = sloppy_springs()
    trail: list[Array] = []

    class Recorded:
        parameters = problem.parameters
        jacobian = problem.jacobian

        def residuals(self, theta: Array) -> Array:
            trail.append(np.array(theta))
            return problem.residuals(theta)

    minimise_by_complex(Evaluator(Recorded(), budget=2500), start, np.random.default_rng(1))
    expected = slow_complex(
        lambda theta: 0.5 * np.sum(problem.residuals(theta) ** 2),
        start,
        np.array([2.0] * 4 + [3.0] * 4),
        np.array([0.0] * 4 + [-np.inf] * 4),
        np.random.default_rng(1),
        len(trail),
    )
    # Sums in another order differ by rounding, which the search may magnify slowly.
    np.testing.assert_allclose(np.array(trail)[:600], expected[:600], rtol=1e-6)


def test_stops_by_spread_and_not_before() -> None:
    problem = linear()
    evaluator = Evaluator(problem, budget=2500)
    outcome = minimise_by_complex(evaluator, problem.start, np.random.default_rng(0))
    assert outcome is Outcome.SPREAD
    # All twenty candidates lie within 1e-3 in each parameter, hence the best one near the minimum.
    assert evaluator.best_theta is not None
    assert np.max(np.abs(evaluator.best_theta - problem.minimum)) < 1e-3
