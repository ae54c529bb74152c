"""How many steps a sample still needs."""

from dataclasses import replace

import numpy as np
import pytest
from problems import Linear, plain_parameters

from identknee.identify.posterior.posterior import (
    ConvergenceCheck,
    StopRule,
    expected_end,
    expected_steps,
)
from identknee.identify.posterior.sample import sample


@pytest.fixture(scope="module")
def checks() -> tuple[ConvergenceCheck, ...]:
    problem = Linear(
        parameters=plain_parameters(2, -50.0, 50.0), data=np.array([1.0, -1.0]), matrix=np.eye(2)
    )
    return sample(problem, seed=1).checks


def test_a_sample_that_has_converged_needs_no_more(
    checks: tuple[ConvergenceCheck, ...],
) -> None:
    assert checks[-1].is_passed
    assert expected_steps(checks) == checks[-1].steps


def test_each_condition_asks_for_what_it_lacks(checks: tuple[ConvergenceCheck, ...]) -> None:
    """A longer autocorrelation in proportion, a larger error of means by its square."""
    last = checks[-1]
    bar = last.rule.autocorrelation_times
    slow = replace(last, tau=np.full_like(last.tau, 4.0 * last.kept / bar))
    assert expected_steps([slow]) == pytest.approx(4.0 * last.steps)
    rough = replace(last, mean_error=np.full_like(last.mean_error, 0.15))
    assert expected_steps([rough]) == pytest.approx(9.0 * last.steps)
    apart = replace(last, rhat=np.full_like(last.rhat, 1.03))
    assert expected_steps([apart]) == pytest.approx(3.0 * last.steps)


def test_every_other_sample_ends_before_its_drift_is_expected_to(
    checks: tuple[ConvergenceCheck, ...],
) -> None:
    """Drifts that fall as the inverse of the steps, each with noise of its own."""
    draws = 12.0 * np.exp(0.5 * np.random.default_rng(1).standard_normal((1000, 200)))
    steps, bar, known = 10 * np.arange(1, 201), StopRule().drift, 25
    seen = [
        replace(checks[-1], tau=np.full(2, 9.0), steps=int(n), drift=x / n, burn_in=0)
        for n, x in zip(steps[:known], draws[0], strict=False)
    ]
    ends = steps[known + np.argmax(draws[:, known:] <= bar * steps[known:], axis=1)]
    assert 0.3 < np.mean(ends < expected_steps(seen)) < 0.7


def test_the_budget_ends_it_in_any_case(checks: tuple[ConvergenceCheck, ...]) -> None:
    last = checks[-1]
    slow = replace(last, tau=np.full_like(last.tau, 1e6))
    steps, words = expected_end([slow], 0.5)
    assert steps == pytest.approx(2.0 * last.steps)
    assert "50%" in words
    assert "R-hat 1.0" in words
