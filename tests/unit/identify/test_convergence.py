"""The convergence check at which sampling stops: every condition alone can fail it."""

from dataclasses import replace

import numpy as np
import pytest

from identknee.identify.posterior.posterior import (
    ConvergenceCheck,
    SampleOutcome,
    StopRule,
    check_convergence,
)
from identknee.runs.declare import Array

RULE = StopRule()


def independent(steps: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=(4, 16, steps, 2))


def moved(samples: Array) -> np.ndarray:
    return np.ones(samples.shape[:3], bool)


def passed() -> ConvergenceCheck:
    samples = independent(2000)
    before = [check_convergence(samples[:, :, :1990], moved(samples[:, :, :1990]), RULE, [])]
    return check_convergence(samples, moved(samples), RULE, before)


def test_independent_draws_pass() -> None:
    found = passed()
    assert found.is_passed
    assert all(met for _, _, met in found.conditions.values())
    assert found.burn_in == 400
    assert found.kept == 1600


def test_the_first_check_never_passes_because_nothing_is_known_of_drift() -> None:
    samples = independent(2000)
    found = check_convergence(samples, moved(samples), RULE, [])
    assert found.drift == np.inf
    assert not found.is_passed


def test_drift_is_counted_from_a_check_one_autocorrelation_time_back() -> None:
    samples = independent(2000)
    first = check_convergence(samples[:, :, :1000], moved(samples[:, :, :1000]), RULE, [])
    near = replace(first, steps=2000, tau=first.tau * 100.0)
    found = check_convergence(samples, moved(samples), RULE, [first, near])
    assert found.drift == pytest.approx(np.max(np.abs(found.tau / first.tau - 1.0)))


@pytest.mark.parametrize(
    ("change", "condition"),
    [
        ({"tau": np.array([1.0, 100.0])}, "steps_per_tau"),
        ({"drift": 0.011}, "tau_drift"),
        ({"rhat": np.array([1.0, 1.011])}, "rhat"),
        ({"bulk": np.full((2, 4), 99.0)}, "effective_draws"),
        ({"tail": np.full((2, 4), 99.0)}, "effective_draws_each"),
        ({"mean_error": np.array([0.01, 0.051])}, "mean_error"),
    ],
)
def test_each_condition_alone_keeps_it_shut(change: dict[str, object], condition: str) -> None:
    found = replace(passed(), **change)  # type: ignore[arg-type]
    assert not found.conditions[condition][2]
    assert not found.is_passed
    assert "not met" in str(found)


def test_a_walker_that_never_moves_is_stuck_once_that_is_no_bad_luck() -> None:
    samples = independent(400)
    has_moved = moved(samples)
    has_moved[2, 7] = False
    found = check_convergence(samples, has_moved, RULE, [])
    assert np.argwhere(found.stuck).tolist() == [[2, 7]]
    early = check_convergence(samples[:, :, :100], has_moved[:, :, :100], RULE, [])
    assert not early.stuck.any()


def test_every_outcome_has_a_sentence() -> None:
    assert all(outcome.sentence.endswith(".") for outcome in SampleOutcome)
