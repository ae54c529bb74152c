"""What blind cases hide and what their data state: distributions, against what is written here.

A generator whose truths lie near the subject's own values, whose noise is stated exactly or whose
errors are always normal would make any diagnosis look better than it is.
"""

import numpy as np
import pytest
import scipy.stats
from blind_scene import experiment, scene

from identknee.blind.case import (
    Noise,
    _history,
    _names,
    _noisy,
    _phase,
    _theta,
    _usual_size,
)
from identknee.blind.conditions import Conditions, TruncatedNormal
from identknee.blind.effects import EFFECTS, LISTED, UNLISTED
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.laxity.table import Laxity
from identknee.runs.declare import Array

N = 2000
# A share counted N times, five standard errors at most.
SHARE_ERROR = 5.0 * 0.5 / np.sqrt(N)
NOISE = Noise(sd_mm=0.3, sd_deg=0.3, correlation=0.3)


def thetas(conditions: Conditions) -> Array:
    """Shifts of ln stiffness and of the strains [%] from the subject's, shape ``(N, 2, 4)``."""
    base, stage = experiment(), scene(conditions)
    generator = np.random.default_rng(4)
    drawn = [_theta(base, stage, generator) for _ in range(N)]
    found = np.array([x for x in drawn if x is not None]).reshape(-1, 2, 4)
    return np.stack([np.log(found[:, 0] / 2.0), found[:, 1] - 4.0], axis=1)


def test_true_parameters_lie_around_the_subjects_by_a_fifth_and_one_percent() -> None:
    found = thetas(Conditions())
    error = 5.0 / np.sqrt(2.0 * N)
    np.testing.assert_allclose(found[:, 0].std(axis=0), 0.2, rtol=error)
    # A normal law of sd 1 whose tails beyond 2 are put on 2.
    z, limit = np.random.default_rng(0).standard_normal(10**6), 2.0
    np.testing.assert_allclose(found[:, 1].std(axis=0), np.clip(z, -limit, limit).std(), rtol=error)
    assert np.abs(found[:, 1]).max() == pytest.approx(limit)
    np.testing.assert_allclose(found.mean(axis=0)[0], 0.0, atol=5.0 * 0.2 / np.sqrt(N))
    # Of different ligaments, and of both numbers of one: independent.
    shared = np.asarray(np.corrcoef(found.reshape(N, 8).T))[np.triu_indices(8, 1)]
    np.testing.assert_allclose(shared, 0.0, atol=5.0 / np.sqrt(N))


def test_truths_of_a_size_that_cannot_be_are_drawn_again() -> None:
    wide = Conditions(
        stiffness_log_sd=1.0,
        strain_sd_pct=8.0,
        largest_shift_pct=np.inf,
        most_stiffness_kN=6.0,
        most_strain_pct=10.0,
    )
    found = thetas(wide)
    assert 100 < len(found) < N
    assert found[:, 0].max() <= np.log(3.0)
    assert found[:, 1].max() <= 6.0
    assert found[:, 1].min() >= -14.0
    assert found[:, 1].min() < -10.0


def noisy(n_cases: int, trials: int) -> tuple[Array, list[Laxity], list[dict[str, object]]]:
    """Errors (cases, trials, 5), the data and what is true about their noise."""
    protocol = load_protocol("seed63").select(np.arange(trials))
    exact = Laxity(protocol=protocol, coordinates=np.zeros((trials, 5)))
    made = [_noisy(exact, NOISE, np.random.default_rng(x)) for x in range(n_cases)]
    data, facts = [x for x, _ in made], [x for _, x in made]
    return np.array([x.coordinates for x in data]), data, facts


def test_noise_is_stated_too_small_or_too_large_by_up_to_a_fifth() -> None:
    """Evenly, and of mm and degrees apart: nobody knows the noise of a rig exactly."""
    _, data, facts = noisy(N // 2, 1)
    stated = np.array([x.sd[0, [0, 4]] / 0.3 for x in data if x.sd is not None])
    told = [[x["stated_over_true_mm"], x["stated_over_true_deg"]] for x in facts]
    np.testing.assert_allclose(stated, np.array(told, float))
    for column in stated.T:
        assert 0.8 <= column.min() < 0.81
        assert 1.19 < column.max() <= 1.2
        even = scipy.stats.uniform(0.8, 0.4)
        assert scipy.stats.kstest(column, even.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(stated.T)[0, 1]) < 5.0 / np.sqrt(N / 2)
    for x in data[:20]:
        assert x.sd is not None
        np.testing.assert_array_equal(x.sd, np.repeat(x.sd[:, [0, 4]], [3, 2], axis=1))
        assert x.within_trial_correlation == 0.0


def test_errors_have_their_size_their_correlation_and_now_and_then_heavy_tails() -> None:
    """One case in ten has Student's t of five degrees, whose kurtosis is 9; others have 3."""
    errors, _, facts = noisy(N // 2, 63)
    is_heavy = np.array([x["student_degrees"] is not None for x in facts])
    assert is_heavy.mean() == pytest.approx(0.1, abs=5.0 * np.sqrt(0.09 / (N // 2)))
    assert {x["student_degrees"] for x in facts} == {None, 5.0}
    normal, heavy = errors[~is_heavy], errors[is_heavy]
    for group in (normal, heavy):
        np.testing.assert_allclose(group.std(axis=(0, 1)), 0.3, rtol=0.06)
    shared = np.asarray(np.corrcoef(normal.reshape(-1, 5).T))[np.triu_indices(5, 1)]
    np.testing.assert_allclose(shared, 0.3, atol=5.0 / np.sqrt(normal.size / 5))
    assert scipy.stats.kurtosis(normal[:, :, 0], axis=None) == pytest.approx(0.0, abs=0.2)
    assert scipy.stats.kurtosis(heavy[:, :, 0], axis=None) > 1.5


def test_what_is_hidden_is_nothing_or_of_no_library_in_15_of_100_cases_each() -> None:
    generator = np.random.default_rng(6)
    found = [_names("random", generator) for _ in range(N)]
    assert np.mean([not x for x in found]) == pytest.approx(0.15, abs=SHARE_ERROR)
    assert np.mean([bool(set(x) & set(UNLISTED)) for x in found]) == pytest.approx(
        0.15, abs=SHARE_ERROR
    )
    counts = np.array([sum(x == (name,) for x in found) for name in LISTED])
    assert scipy.stats.chisquare(counts).pvalue > 1e-3
    assert _names(None, generator) == ()


def test_trials_are_made_in_any_order_half_of_them_while_the_load_comes_down() -> None:
    protocol = load_protocol("seed63")
    generator = np.random.default_rng(7)
    made = [_history(protocol, generator) for _ in range(200)]
    orders = np.array([x for x, _ in made])
    np.testing.assert_array_equal(np.sort(orders, axis=1), np.tile(np.arange(1, 64), (200, 1)))
    np.testing.assert_allclose(orders.mean(axis=0), 32.0, atol=5.0 * 63.0 / np.sqrt(12.0 * 200.0))
    downs = np.array([x for _, x in made])
    assert downs.mean() == pytest.approx(0.5, abs=5.0 * 0.5 / np.sqrt(downs.size))


def test_a_phase_says_which_way_the_load_went_and_nothing_without_one(
    protocol: Protocol,
) -> None:
    n = protocol.n
    down = _phase(protocol, np.ones(n, bool))
    up = _phase(protocol, np.zeros(n, bool))
    rests = np.abs(protocol.loads).max(axis=1) == 0.0
    assert 0 < rests.sum() < n
    np.testing.assert_array_equal(np.array(down), np.where(rests, "", "unloading"))
    np.testing.assert_array_equal(np.array(up), np.where(rests, "", "loading"))


@pytest.fixture
def protocol() -> Protocol:
    return load_protocol("seed63")


@pytest.mark.parametrize("name", ["moment_gain_IE", "anterolateral", "insertion"])
def test_sizes_of_the_literature_are_even_in_their_logarithm(name: str) -> None:
    generator, stage = np.random.default_rng(9), scene()
    hidden = EFFECTS[name](stage, generator)
    sizes = np.array([_usual_size(hidden, stage, generator) for _ in range(N)])
    share = np.log(sizes / hidden.smallest) / np.log(hidden.largest / hidden.smallest)
    assert scipy.stats.kstest(share, "uniform").pvalue > 1e-3


def test_sizes_of_a_prior_have_its_spread_in_each_number() -> None:
    """Four shears of sd 0.6 each; the root mean square of 24 shifts of sd 2."""
    wanted = {"parasitic_shear": (0.6, 4), "insertion": (2.0, 24)}
    stage = scene(
        Conditions(amplitudes={x: TruncatedNormal(sd=sd) for x, (sd, _) in wanted.items()})
    )
    generator = np.random.default_rng(10)
    for name, (sd, n) in wanted.items():
        hidden = EFFECTS[name](stage, generator)
        sizes = np.array([_usual_size(hidden, stage, generator) for _ in range(N)])
        each = np.mean((sizes * hidden.over) ** 2) / n
        assert each == pytest.approx(sd**2, rel=5.0 * np.sqrt(2.0 / (n * N)))


def test_noise_counts_errors_in_units_in_which_they_are_independent() -> None:
    """What is wanted as a signal: a whitened error has the length of its Mahalanobis distance."""
    values = np.random.default_rng(0).normal(size=(4, 5))
    noise = Noise(sd_mm=0.2, sd_deg=0.5, correlation=0.3)
    sd = np.array([0.2, 0.2, 0.2, 0.5, 0.5])
    covariance = np.outer(sd, sd) * (0.3 + 0.7 * np.eye(5))
    for value, white in zip(values, noise.whitened(values), strict=True):
        assert white @ white == pytest.approx(value @ np.linalg.inv(covariance) @ value)
