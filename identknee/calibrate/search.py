"""The common loop of all ask-and-tell searches."""

from typing import Protocol

import numpy as np

from identknee.calibrate.evaluation import Evaluator
from identknee.runs.arrays import Array
from identknee.runs.record import Outcome

POPULATION = 20
SPREAD_TOLERANCE = 1e-3


class AskTellSearch(Protocol):
    """An ask-and-tell search."""

    @property
    def population(self) -> Array:
        """The candidates it now holds, shape ``(k, n)``."""
        ...

    def ask(self) -> Array:
        """Candidates to evaluate, shape ``(m, n)``; none if there is no new one."""
        ...

    def tell(self, values: Array) -> None:
        """Take the deviances of the candidates just asked, shape ``(m,)``; they may be inf."""
        ...


def run_search(search: AskTellSearch, evaluator: Evaluator) -> Outcome:
    """How the search ended: when the population's spread in every parameter was below 1e-3.

    The spread is the largest minus the smallest value, in the unit of the parameter (kN or %).

    Raises
    ------
    Ended
        If the budget of the evaluator was used up first.
    """
    while True:
        candidates = search.ask()
        if len(candidates) == 0:
            return Outcome.SPREAD
        search.tell(np.array([evaluator.deviance(candidate) for candidate in candidates]))
        if np.all(np.ptp(search.population, axis=0) < SPREAD_TOLERANCE):
            return Outcome.SPREAD


def uniform_box(generator: np.random.Generator, n: int, low: Array, high: Array) -> Array:
    """Points drawn uniformly from a box, shape ``(n, len(low))``."""
    return generator.uniform(low, high, size=(n, len(low)))
