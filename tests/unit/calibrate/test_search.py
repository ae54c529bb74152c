import numpy as np
import pytest
from problems import linear

from identknee.calibrate.population import run_search, uniform_box
from identknee.calibrate.problem import Evaluator, SearchEnded
from identknee.runs.declare import Array
from identknee.runs.record import Outcome


class Shrinking:
    """Asks for two points around the origin, closer each time."""

    def __init__(self, factor: float, last: float = np.inf) -> None:
        self.width, self.factor, self.rounds, self.last = 1.0, factor, 0, last
        self.told: list[Array] = []

    @property
    def population(self) -> Array:
        return self.width * np.array([np.zeros(3), np.ones(3)])

    def ask(self) -> Array:
        self.width *= self.factor
        self.rounds += 1
        return self.population if self.rounds <= self.last else np.empty((0, 3))

    def tell(self, values: Array) -> None:
        self.told.append(values)


def test_ends_when_every_spread_is_below_a_thousandth() -> None:
    search = Shrinking(0.1)
    assert run_search(search, Evaluator(linear(), budget=100)) is Outcome.SPREAD
    # 0.1^3 rounds to just above 1e-3, 0.1^4 is below it.
    assert search.rounds == 4
    assert all(values.shape == (2,) for values in search.told)


def test_ends_when_nothing_is_asked() -> None:
    assert run_search(Shrinking(1.0, last=2), Evaluator(linear(), budget=9)) is Outcome.SPREAD


def test_budget_cuts_a_generation_short() -> None:
    evaluator = Evaluator(linear(), budget=3)
    with pytest.raises(SearchEnded):
        run_search(Shrinking(0.9), evaluator)
    assert evaluator.n_simulations == 3


def test_uniform_box_fills_its_box() -> None:
    low, high = np.array([-1.0, 5.0]), np.array([1.0, 9.0])
    points = uniform_box(np.random.default_rng(0), 4000, low, high)
    assert np.all((points >= low) & (points <= high))
    # Five standard errors of the mean of 4,000 uniform numbers.
    bound = 5 * (high - low) / np.sqrt(12 * 4000)
    assert np.all(np.abs(points.mean(axis=0) - (low + high) / 2) < bound)
