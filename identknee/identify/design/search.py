"""Choosing the trials to add: greedy, then by exchange."""

from collections.abc import Callable

import numpy as np

from identknee.runs.arrays import Array, BoolArray

MOST_ROUNDS = 20
# Share of the loss: an exchange that gains less is rounding.
TOLERANCE = 1e-10


def choose(
    loss: Callable[[Array], Array], made: Array, trials: Array, allowed: BoolArray, n_chosen: int
) -> tuple[int, ...]:
    """The trials to add, in the order in which they help most; a trial may come more than once.

    Trials are added one by one, each time the one that lowers the loss most. Then each in turn is
    exchanged for the one that is best in its place, until no exchange helps.

    Parameters
    ----------
    loss
        Loss of rows of summed features, shape ``(k,)`` from ``(k, f)``.
    made
        Features of the trials made, shape ``(f,)``.
    trials
        Features of the trials that may be added, shape ``(k, f)``.
    allowed
        Which of them may be chosen, shape ``(k,)``.
    n_chosen
        How many to choose.

    References
    ----------
    V. V. Fedorov, Theory of Optimal Experiments (1972), ISBN 978-0-12-250750-2.
    """
    possible = np.flatnonzero(allowed)
    offered = trials[possible]

    def best_beside(others: list[int]) -> tuple[int, float]:
        losses = loss(made + offered[others].sum(axis=0) + offered)
        best = int(np.argmin(losses))
        return best, float(losses[best])

    chosen: list[int] = []
    value = np.inf
    for _ in range(n_chosen):
        best, value = best_beside(chosen)
        chosen.append(best)
    for _ in range(MOST_ROUNDS):
        before = value
        for place in range(n_chosen):
            best, new = best_beside(chosen[:place] + chosen[place + 1 :])
            if new < value - TOLERANCE * abs(value):
                chosen[place], value = best, new
        if value >= before:
            break
    return tuple(int(possible[i]) for i in _in_order(loss, made, offered, chosen))


def _in_order(
    loss: Callable[[Array], Array], made: Array, offered: Array, chosen: list[int]
) -> list[int]:
    """The chosen ones, each the most helpful of those left after the ones before."""
    left, ordered, features = list(chosen), [], np.array(made)
    while left:
        best = int(np.argmin(loss(features + offered[left])))
        features = features + offered[left[best]]
        ordered.append(left.pop(best))
    return ordered
