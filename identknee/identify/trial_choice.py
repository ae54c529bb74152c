"""Trials chosen one after another, each the best beside those chosen, then by exchange.

References
----------
V. V. Fedorov, Theory of Optimal Experiments (1972), ISBN 978-0-12-250750-2.
"""

from collections.abc import Callable, Sequence

import numpy as np

from identknee.runs.declare import Array, BoolArray

MOST_ROUNDS = 20
# Least relative gain of an exchange; less is rounding.
TOLERANCE = 1e-10


def choose(
    losses: Callable[[tuple[int, ...]], Array],
    allowed: BoolArray,
    n_most: int,
    *,
    is_enough: Callable[[Sequence[int]], bool] = lambda _: False,
    exchanges: int = MOST_ROUNDS,
) -> tuple[int, ...]:
    """The trials to add, in the order in which they help most; a trial may come more than once.

    Trials are added one by one, each time the one that lowers the loss most. Then each in turn is
    exchanged for the one that is best in its place, until no exchange helps.

    Parameters
    ----------
    losses
        Loss of each of k candidates beside others that are chosen already, shape ``(k,)``.
    allowed
        Which of them may be chosen, shape ``(k,)``.
    n_most
        How many to choose at most.
    is_enough
        Whether those chosen so far are enough.
    exchanges
        Rounds of exchanges at most.
    """

    def best_beside(others: Sequence[int]) -> tuple[int, float]:
        found = np.where(allowed, losses(tuple(others)), np.inf)
        best = int(np.argmin(found))
        return best, float(found[best])

    chosen, value = list[int](), np.inf
    while len(chosen) < n_most and not is_enough(chosen):
        best, value = best_beside(chosen)
        chosen.append(best)
    for _ in range(exchanges):
        before = value
        for place in range(len(chosen)):
            best, new = best_beside(chosen[:place] + chosen[place + 1 :])
            if new < value - TOLERANCE * abs(value):
                chosen[place], value = best, new
        if value >= before:
            break
    ordered = list[int]()
    while exchanges and chosen:
        ordered.append(chosen.pop(int(np.argmin(losses(tuple(ordered))[chosen]))))
    return tuple(ordered or chosen)
