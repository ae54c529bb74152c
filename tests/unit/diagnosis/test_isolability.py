"""Distances between causes against least squares, and advised trials against trying each."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from linear_data import LinearFit, linear_fit, signature
from scipy.optimize import minimize

from identknee.diagnosis.isolability import (
    AdvisedTrials,
    Distances,
    Pair,
    advise_trials,
    distances,
    groups,
    least_favourable_distances,
    noncentrality_root,
)
from identknee.diagnosis.score import ProjectedSignature, project_signature
from identknee.runs.declare import Array

# Least squares by another route, of a few hundred rows.
SOLVED = 1e-8


@pytest.fixture(scope="module")
def fit() -> LinearFit:
    return linear_fit()


def effect(
    fit: LinearFit,
    name: str,
    columns: Array,
    *,
    sign: int = 0,
    prior_sd: float = 1.0,
    variant: str = "",
) -> ProjectedSignature:
    return project_signature(
        fit.projector, signature(columns, name, sign=sign, prior_sd=prior_sd, variant=variant)
    )


def random_columns(seed: int, k: int = 1) -> Array:
    return np.random.default_rng(seed).standard_normal((315, k))


def left_after(fit: LinearFit, expected: Array, rival: ProjectedSignature) -> float:
    """Root of the least objective: base parameters free, the rival within its prior."""
    columns = rival.signature.columns
    prior = np.diag(1 / rival.signature.prior_sd)
    k = columns.shape[1]
    top = np.hstack([fit.jacobian, fit.projector.padded(columns)])
    rows = np.vstack([top, np.hstack([np.zeros((k, fit.jacobian.shape[1])), prior])])
    data = np.concatenate([fit.projector.padded(expected), np.zeros(k)])
    fitted, *_ = np.linalg.lstsq(rows, data, rcond=None)
    return float(np.linalg.norm(data - rows @ fitted))


@pytest.mark.parametrize(("k", "prior_sd"), [(1, 10.0), (3, 0.2)])
def test_a_distance_is_what_the_rival_cannot_fit(fit: LinearFit, k: int, prior_sd: float) -> None:
    columns = random_columns(1)
    one = effect(fit, "a", columns)
    near = np.hstack([columns + 0.5 * random_columns(2), random_columns(3, k - 1)])
    rival = effect(fit, "b", near, prior_sd=prior_sd)
    amplitude = np.array([0.4])
    found = distances([one], [amplitude], [one, rival])
    assert found.rivals == ("a", "b")
    assert found.values[0, 0] == 0.0
    expected = left_after(fit, columns @ amplitude, rival)
    assert found.values[0, 1] == pytest.approx(expected, rel=SOLVED)
    assert found.values[0, 1] < noncentrality_root(one, amplitude)


def test_the_best_variant_of_a_rival_counts(fit: LinearFit) -> None:
    columns = random_columns(1)
    far = effect(fit, "b", random_columns(2), variant="far")
    near = effect(fit, "b", columns + 0.3 * random_columns(3), variant="near")
    one, amplitude = effect(fit, "a", columns), np.array([0.4])
    both = distances([one], [amplitude], [far, near]).values[0, 0]
    assert both == distances([one], [amplitude], [near]).values[0, 0]
    assert both < distances([one], [amplitude], [far]).values[0, 0]


def test_a_rival_of_the_other_sign_is_no_rival(fit: LinearFit) -> None:
    columns = random_columns(1)
    one, amplitude = effect(fit, "a", columns), np.array([0.4])
    for sign, share in ((1, 0.0), (0, 0.0), (-1, 1.0)):
        rival = effect(fit, "b", columns, sign=sign, prior_sd=100.0)
        found = distances([one], [amplitude], [rival]).values[0, 0]
        # What the prior of the rival holds back: 0.4 of 100.
        assert found == pytest.approx(share * noncentrality_root(one, amplitude), abs=0.0041)


def test_of_an_effect_with_one_amplitude_there_is_one_mix(fit: LinearFit) -> None:
    one = effect(fit, "a", random_columns(1))
    rival = effect(fit, "b", random_columns(1) + random_columns(2, 2))
    amplitude = np.array([8.0 / np.sqrt(one.gram[0, 0])])
    assert noncentrality_root(one, amplitude) == pytest.approx(8.0, rel=SOLVED)
    worst = least_favourable_distances([one], 8.0, [rival]).values[0, 0]
    assert worst == pytest.approx(distances([one], [amplitude], [rival]).values[0, 0], rel=SOLVED)


def test_the_worst_mix_is_the_worst(fit: LinearFit) -> None:
    """Against a search over mixes that stand out alike."""
    one = effect(fit, "a", random_columns(1, 3), prior_sd=10.0)
    rival = effect(fit, "b", random_columns(1, 3)[:, :2] + 0.4 * random_columns(4, 2))
    worst = least_favourable_distances([one], 8.0, [rival]).values[0, 0]

    def distance(mix: Array) -> float:
        amplitude = mix * 8.0 / noncentrality_root(one, mix)
        return float(distances([one], [amplitude], [rival]).values[0, 0])

    starts = np.random.default_rng(0).standard_normal((5, 3))
    searched = min(minimize(distance, x, method="Nelder-Mead").fun for x in starts)
    assert worst == pytest.approx(searched, rel=1e-3)
    assert worst < distance(np.ones(3))


def test_mixes_no_prior_allows_do_not_count(fit: LinearFit) -> None:
    """A second amplitude too small to stand out cannot make the effect look like another."""
    columns = np.hstack([random_columns(1), random_columns(2)])
    rival = effect(fit, "b", random_columns(2), prior_sd=100.0)
    wide = effect(fit, "a", columns, prior_sd=10.0)
    assert least_favourable_distances([wide], 8.0, [rival]).values[0, 0] < 0.5
    narrow = effect(fit, "a", columns * [1.0, 0.01], prior_sd=10.0)
    assert least_favourable_distances([narrow], 8.0, [rival]).values[0, 0] > 7.0


def test_what_is_not_seen_is_taken_for_no_other(fit: LinearFit) -> None:
    dead, one = effect(fit, "dead", np.zeros((315, 1))), effect(fit, "a", random_columns(1))
    found = least_favourable_distances([dead, one], 8.0, [dead, one])
    assert groups(found) == (("dead",), ("a",))


def test_groups_hang_together_by_way_of_others() -> None:
    values = np.array(
        [[0, 9, 4, 9, 9], [9, 0, 9, 9, 9], [9, 9, 0, 4.9, 9], [9, 9, 9, 0, 9], [9, 5, 9, 9, 0]]
    )
    names = ("a", "b", "c", "d", "e")
    found = Distances(effects=names, rivals=names, values=values)
    assert groups(found) == (("a", "c", "d"), ("b",), ("e",))
    assert groups(found, least=4.0) == tuple((x,) for x in names)
    shuffled = [3, 0, 4, 1, 2]
    other = Distances(
        effects=names, rivals=tuple(names[i] for i in shuffled), values=values[:, shuffled]
    )
    assert groups(other) == groups(found)
    with pytest.raises(ValueError, match="one another"):
        groups(Distances(effects=("a",), rivals=("b",), values=np.ones((1, 1))))


N_BASE, N_CANDIDATES = 8, 6


def stacked() -> tuple[Array, Array, list[Pair]]:
    """Two effects alike in the trials made, which two of six candidates tell apart."""
    generator = np.random.default_rng(11)
    made = linear_fit().jacobian
    first = generator.standard_normal((len(made), 1))
    second = first + 0.2 * generator.standard_normal((len(made), 1))
    made = np.hstack([made, first, second, generator.standard_normal((len(made), 1))])
    candidates = generator.standard_normal((N_CANDIDATES, 5, N_BASE + 3))
    candidates[:, :, N_BASE + 1] = candidates[:, :, N_BASE]
    candidates[2, :, N_BASE + 1] *= -1
    candidates[4, :, N_BASE + 1] *= 0.3
    pairs = [
        Pair(
            effect=np.array([N_BASE + i]),
            amplitude=np.array([0.5]),
            rival=np.array([N_BASE + j]),
            rival_prior_sd=np.array([prior_sd]),
        )
        for i, j, prior_sd in ((0, 1, 2.0), (1, 0, 2.0), (0, 2, 2.0), (0, 1, 0.2))
    ]
    return made, candidates, pairs


def brute_force(made: Array, added: Array, pair: Pair) -> float:
    rows = np.vstack([made, *added])
    free = np.concatenate([rows[:, :N_BASE], rows[:, pair.rival]], axis=1)
    prior = np.diag(np.concatenate([np.zeros(N_BASE), 1 / pair.rival_prior_sd]))
    data = np.concatenate([rows[:, pair.effect] @ pair.amplitude, np.zeros(len(prior))])
    whole = np.vstack([free, prior])
    fitted, *_ = np.linalg.lstsq(whole, data, rcond=None)
    return float(np.linalg.norm(data - whole @ fitted))


def advise(n_trials: int) -> AdvisedTrials:
    made, candidates, pairs = stacked()
    return advise_trials(made, candidates, pairs, n_base=N_BASE, n_trials=n_trials, enough=np.inf)


def test_distances_after_added_trials_are_those_of_stacked_rows() -> None:
    made, candidates, pairs = stacked()
    found = advise(3)
    for step, pair in product(range(4), range(len(pairs))):
        expected = brute_force(made, candidates[list(found.chosen[:step])], pairs[pair])
        assert found.distances[step, pair] == pytest.approx(expected, rel=SOLVED)
    for candidate, pair in product(range(N_CANDIDATES), range(len(pairs))):
        expected = brute_force(made, candidates[[candidate]], pairs[pair])
        assert found.single[candidate, pair] == pytest.approx(expected, rel=SOLVED)


def test_each_choice_is_the_best_of_all_candidates_and_may_repeat() -> None:
    made, candidates, pairs = stacked()
    found = advise(4)
    assert found.chosen[0] in (2, 4)
    for step in range(4):
        least = [
            min(brute_force(made, candidates[[*found.chosen[:step], i]], x) for x in pairs)
            for i in range(N_CANDIDATES)
        ]
        assert found.chosen[step] == int(np.argmax(least))
    assert np.all(np.diff(found.distances.min(axis=1)) > 0)
    np.testing.assert_array_equal(found.distances[1], found.single[found.chosen[0]])
    only = advise_trials(made, candidates[[2]], pairs, n_base=N_BASE, n_trials=3, enough=np.inf)
    assert only.chosen == (0, 0, 0)


def test_nuisances_that_trials_share_are_fitted_with_them() -> None:
    """To average over nuisances of variance 1 is to fit them with that prior."""
    made, candidates, pairs = stacked()
    generator = np.random.default_rng(12)
    made = np.hstack([made, generator.standard_normal((len(made), 2))])
    shared = generator.standard_normal((N_CANDIDATES, 5, 2))
    candidates = np.concatenate([candidates, shared], axis=2)
    found = advise_trials(
        made, candidates, pairs, n_base=N_BASE, n_nuisances=2, n_trials=3, enough=np.inf
    )
    # The same as two more amplitudes of every rival.
    nuisances = np.arange(made.shape[1] - 2, made.shape[1])
    wider = [
        replace(
            x, rival=np.r_[x.rival, nuisances], rival_prior_sd=np.r_[x.rival_prior_sd, 1.0, 1.0]
        )
        for x in pairs
    ]
    for step, pair in product(range(4), range(len(pairs))):
        expected = brute_force(made, candidates[list(found.chosen[:step])], wider[pair])
        assert found.distances[step, pair] == pytest.approx(expected, rel=SOLVED)


def test_a_candidate_without_prediction_is_not_advised() -> None:
    made, candidates, pairs = stacked()
    candidates[2, 0, 0] = np.nan
    found = advise_trials(made, candidates, pairs, n_base=N_BASE, n_trials=3, enough=np.inf)
    assert 2 not in found.chosen
    assert np.isnan(found.single[2]).all()
    candidates[:] = np.nan
    with pytest.raises(ValueError, match="candidate trial"):
        advise_trials(made, candidates, pairs, n_base=N_BASE, n_trials=1)
