"""Choosing the trials to add: greedy, then by exchange."""

from collections.abc import Callable, Sequence

import numpy as np

from identknee.runs.arrays import Array, BoolArray

MOST_ROUNDS = 20
# Share of the loss: an exchange that gains less is rounding.
TOLERANCE = 1e-10


def choose(
    loss: Callable[[Array], Array],
    beside: Callable[[Sequence[int]], tuple[Array, Array]],
    allowed: BoolArray,
    n_chosen: int,
) -> tuple[int, ...]:
    """The trials to add, in the order in which they help most; a trial may come more than once.

    Trials are added one by one, each time the one that lowers the loss most. Then each in turn is
    exchanged for the one that is best in its place, until no exchange helps.

    Parameters
    ----------
    loss
        Loss of rows of summed features, shape ``(k,)`` from ``(k, f)``.
    beside
        Features of the trials made with those added, shape ``(f,)``, and of each of the trials that
        may come next, ``(k, f)``.
    allowed
        Which of them may be chosen, shape ``(k,)``.
    n_chosen
        How many to choose.

    References
    ----------
    V. V. Fedorov, Theory of Optimal Experiments (1972), ISBN 978-0-12-250750-2.
    """
    possible = np.flatnonzero(allowed)

    def best_beside(others: list[int]) -> tuple[int, float]:
        made, trials = beside(others)
        losses = loss(made + trials[possible])
        best = int(np.argmin(losses))
        return int(possible[best]), float(losses[best])

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
    return _in_order(loss, beside, chosen)


def _in_order(
    loss: Callable[[Array], Array],
    beside: Callable[[Sequence[int]], tuple[Array, Array]],
    chosen: list[int],
) -> tuple[int, ...]:
    """The chosen ones, each the most helpful of those left after the ones before."""
    left, ordered = list(chosen), list[int]()
    while left:
        made, trials = beside(ordered)
        best = int(np.argmin(loss(made + trials[left])))
        ordered.append(left.pop(best))
    return tuple(ordered)
