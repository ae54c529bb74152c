"""Searches past trials that end them or jump."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
from small_knee import small_protocol

from identknee.checks.usable_trials import ExclusionResult, TrialExclusion
from identknee.laxity.table import Laxity
from identknee.model.parameters import Parameters
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array

N = 6
LOST = 3


@dataclass(frozen=True)
class Sliding:
    """Every trial measures a pose that x moves, less and less; one of them has its own way.

    The first step from 0 to the measured 1 ends half way.
    """

    laxity: Laxity
    lost: Callable[[float], float]

    @property
    def parameters(self) -> Parameters:
        one = np.ones(1)
        return Parameters(
            names=("x_mm",),
            center=0.0 * one,
            lower=-0.3 * one,
            upper=2.0 * one,
            prior_sd=10.0 * one,
            is_log=np.zeros(1, bool),
        )

    def differences(self, theta: Array) -> Array:
        poses = np.full(N, np.log1p(3.0 * float(theta[0])) / np.log(4.0))
        poses[LOST] = self.lost(float(poses[0]))
        return np.asarray(self.laxity.coordinates - poses[:, None])

    def residuals(self, theta: Array) -> Array:
        rows = self.differences(theta)[self.laxity.is_measured]
        if self.laxity.sd is not None:
            rows = rows / self.laxity.sd[self.laxity.is_measured]
        return -rows if np.isfinite(rows).all() else np.full(rows.size, np.inf)

    def jacobian(self, theta: Array) -> Array:
        slope = 3.0 / (1.0 + 3.0 * float(theta[0])) / np.log(4.0)
        sd = 1.0 if self.laxity.sd is None else self.laxity.sd[0, 0]
        return np.full((int(self.laxity.is_measured.sum()), 1), slope / sd)


def table(*, lost: float, noise: float = 0.01) -> Laxity:
    """Trials that measured 1 in all coordinates, some noise aside, but for one."""
    values = 1.0 + noise * np.random.default_rng(3).standard_normal((N, 5))
    values[LOST] = lost
    return Laxity(
        protocol=small_protocol().select(np.arange(small_protocol().n) < N), coordinates=values
    )


def search(pose: Callable[[float], float], measured: float = 1.0) -> ExclusionResult | None:
    laxity = table(lost=measured)
    return TrialExclusion(
        compared=cast(LaxityResiduals, Sliding(laxity, pose)),
        problem=lambda part: cast(Any, Sliding(part, pose)),
        expand=lambda theta: theta,
    ).run(np.zeros(1))


def is_between(pose: float) -> bool:
    return 0.3 < pose < 0.7


@pytest.mark.parametrize("beyond", [np.nan, 5.0], ids=["ends", "jumps"])
def test_a_trial_that_bars_the_way_is_taken_back_from_beyond(beyond: float) -> None:
    found = search(lambda pose: beyond if is_between(pose) else pose)
    assert found is not None
    assert found.theta[0] == pytest.approx(1.0, abs=0.01)
    assert np.flatnonzero(found.was_excluded).tolist() == [LOST]
    assert not found.is_excluded.any()
    assert " in d. " in found.sentence("abcdef")


def test_a_trial_without_a_pose_where_all_others_fit_is_excluded() -> None:
    found = search(lambda x: np.nan if x > 0.5 else x)
    assert found is not None
    assert found.theta[0] == pytest.approx(1.0, abs=0.01)
    assert np.flatnonzero(found.is_excluded).tolist() == [LOST]


def test_a_trial_that_costs_the_others_little_is_kept() -> None:
    """Its end at 0.7 costs a deviance of 12, where five values of such noise may cost 17."""
    laxity = replace(table(lost=1.0, noise=0.5), sd=np.full((N, 5), 0.5))
    problem = Sliding(laxity, lambda pose: np.nan if pose > 0.7 else pose)
    found = TrialExclusion(
        compared=cast(LaxityResiduals, problem),
        problem=lambda part: cast(Any, replace(problem, laxity=part)),
        expand=lambda theta: theta,
    ).run(np.zeros(1))
    assert found is None


def test_a_trial_that_has_no_pose_at_the_start_comes_back() -> None:
    found = search(lambda x: np.nan if x < 0.5 else x)
    assert found is not None
    assert not found.is_excluded.any()


def test_a_way_without_bars_needs_no_other_start() -> None:
    assert search(lambda x: x) is None


def test_many_trials_are_not_all_named() -> None:
    found = ExclusionResult(
        theta=np.zeros(1), is_excluded=np.zeros(6, bool), was_excluded=np.ones(6, bool)
    )
    assert " a, b, c, d and 2 more " in found.sentence("abcdef")
