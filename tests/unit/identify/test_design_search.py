"""Greedy choice and exchange against all sets there are."""

from collections.abc import Callable
from itertools import combinations_with_replacement

import numpy as np
import pytest

from identknee.identify.design_criteria import Criterion, LocalLoss
from identknee.identify.trial_choice import choose
from identknee.runs.declare import Array

N, K = 4, 9


def _loss(criterion: Criterion) -> LocalLoss:
    everything = np.ones(N, bool)
    return LocalLoss(criterion=criterion, gradients=np.eye(N)[:2], is_of_interest=everything)


def _features(seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    made = rng.normal(size=(N, N))
    rows = rng.normal(size=(K, 2, N)) * rng.uniform(0.3, 3.0, (K, 1, 1))
    return (made.T @ made).ravel(), np.einsum("kmi,kmj->kij", rows, rows).reshape(K, -1)


def _losses(loss: LocalLoss, made: Array, trials: Array) -> Callable[[tuple[int, ...]], Array]:
    """Loss of each trial beside others, of trials that know nothing of each other."""
    return lambda others: loss(made + trials[list(others)].sum(axis=0) + trials)


@pytest.mark.parametrize("criterion", ["D", "A", "E", "c"])
@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_best_of_all_sets_or_close(criterion: Criterion, seed: int) -> None:
    """An exchange may end in a set that no single exchange improves."""
    made, trials = _features(seed)
    loss = _loss(criterion)
    chosen = choose(_losses(loss, made, trials), np.ones(K, bool), 3)
    found = float(loss((made + trials[list(chosen)].sum(axis=0))[None])[0])
    sets = np.array(list(combinations_with_replacement(range(K), 3)))
    best = float(loss(made + trials[sets].sum(axis=1)).min())
    nothing = float(loss(made[None])[0])
    assert best - 1e-9 <= found <= best + 0.02 * (nothing - best) + 1e-9


def test_exchange_mends_what_greed_did() -> None:
    mended = 0
    for seed in range(20):
        made, trials = _features(seed)
        losses = []
        for rounds in (0, 20):
            offered = _losses(_loss("E"), made, trials)
            chosen = choose(offered, np.ones(K, bool), 4, exchanges=rounds)
            losses.append(float(_loss("E")((made + trials[list(chosen)].sum(axis=0))[None])[0]))
        assert losses[1] <= losses[0] * (1.0 + 1e-9)
        mended += losses[1] < 0.99 * losses[0]
    assert mended >= 2


def test_what_is_not_allowed_is_not_chosen_and_repeats_are() -> None:
    made, trials = _features(0)
    trials[4] *= 100.0
    everything = np.ones(K, bool)
    assert 4 in choose(_losses(_loss("D"), made, trials), everything, 2)
    assert 4 not in choose(_losses(_loss("D"), made, trials), np.arange(K) != 4, 2)
    assert choose(_losses(_loss("D"), made, trials), np.arange(K) == 3, 3) == (3, 3, 3)


def test_the_most_helpful_comes_first() -> None:
    made, trials = _features(2)
    loss = _loss("A")
    chosen = choose(_losses(loss, made, trials), np.ones(K, bool), 4)
    sums = made + np.cumsum(trials[list(chosen)], axis=0)
    first = loss(made + trials[sorted(set(chosen))]).min()
    assert loss(sums)[0] == pytest.approx(first)
    assert (np.diff(loss(sums)) < 0).all()
