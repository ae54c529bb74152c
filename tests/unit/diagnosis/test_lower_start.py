"""A base fit that stopped beside a better minimum is found out by the explanations."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnoses import SD, short_trials
from small_knee import as_read, small_knee

from identknee.calibrate.fit import Fit
from identknee.diagnosis import base_fit
from identknee.diagnosis.base_fit import fit_base, lowest_fit, past_lost_trials
from identknee.diagnosis.fitting import best_fit_from
from identknee.diagnosis.investigation import LOWER, better_start, investigate
from identknee.identify.optimum import best_fits
from identknee.laxity.table import add_noise
from identknee.model.effects.loads import compression
from identknee.model.laxity_model import LaxityModel
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee


def test_a_better_minimum_of_the_base_model_is_a_start(reference: Knee) -> None:
    model = LaxityModel(knee=reference, protocol=short_trials())
    laxity = add_noise(model.simulate(model.parameters.center), sd_mm=SD, sd_deg=SD, seed=2)
    found = investigate(reference, laxity, effects=[compression()])
    assert found is not None
    assert better_start(found.attribution) is None
    base = found.base.fitted
    beside = base.theta + np.where(np.arange(base.theta.size) % 2, 0.5, 0.0)
    stuck = best_fit_from(base.model, base.laxity, base.noise, [beside], most_steps=1)
    assert stuck.evaluation.deviance > base.evaluation.deviance + LOWER
    (step, *_) = found.attribution.steps
    at = replace(step, at=replace(found.base, fitted=stuck))
    start = better_start(replace(found.attribution, steps=(at,), best=found.base))
    assert start is not None
    np.testing.assert_allclose(start, base.theta[: base.model.n_ligament_parameters], rtol=0.01)


def test_a_search_through_lost_trials_finds_the_lower_fit(reference: Knee) -> None:
    model = LaxityModel(knee=reference, protocol=short_trials())
    laxity = add_noise(model.simulate(model.parameters.center), sd_mm=SD, sd_deg=SD, seed=2)
    base = fit_base(reference, laxity, starts=[], seed=0)
    assert base is not None
    lowest = base.fitted
    assert lowest.outcome is Outcome.MINIMUM
    assert past_lost_trials(base, 0) is base
    beside = lowest.theta + np.where(np.arange(lowest.theta.size) % 2, 0.5, 0.0)
    stuck = best_fit_from(lowest.model, laxity, lowest.noise, [beside], most_steps=1)
    assert stuck.deviance > lowest.deviance + LOWER
    # Residuals of a worse fit had made the noise look twice as large.
    louder = replace(base.noise, sd=2.0 * base.noise.sd)
    found = past_lost_trials(replace(base, fitted=stuck, noise=louder), 0)
    assert found.fitted.deviance == pytest.approx(lowest.deviance, abs=0.1)
    np.testing.assert_allclose(found.noise.sd, base.noise.sd, rtol=0.01)
    np.testing.assert_allclose(found.fitted.noise.sd, lowest.noise.sd, rtol=0.01)


def test_where_noise_explains_what_is_left_one_search_is_enough(
    reference: Knee, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = LaxityModel(knee=reference, protocol=short_trials())
    laxity = add_noise(model.simulate(model.parameters.center), sd_mm=SD, sd_deg=SD, seed=2)
    base = fit_base(reference, laxity, starts=[], seed=0)
    assert base is not None
    lowest = base.fitted
    stuck = best_fit_from(lowest.model, laxity, lowest.noise, [lowest.theta + 0.02], most_steps=1)
    assert stuck.outcome is not Outcome.MINIMUM
    searched: list[int] = []

    def many(*how: Any, seed: int, **more: Any) -> tuple[Fit, ...]:
        searched.append(seed)
        return best_fits(*how, seed=seed, **more)

    monkeypatch.setattr(base_fit, "best_fits", many)
    found = past_lost_trials(replace(base, fitted=stuck), 0).fitted
    assert found.outcome is Outcome.MINIMUM
    assert found.deviance == pytest.approx(lowest.deviance, abs=0.01)
    assert not searched
    # What noise does not explain is searched for from many starts.
    monkeypatch.setattr(base_fit, "EXPLAINED", 1.0)
    past_lost_trials(replace(base, fitted=stuck), 3)
    assert searched == [3]


def test_from_measured_poses_a_fit_is_also_begun_elsewhere() -> None:
    measured = as_read()
    laxity = replace(measured, sd=np.full(measured.coordinates.shape, SD))
    base = fit_base(small_knee(), laxity, starts=[], seed=0)
    assert base is not None
    lowest = base.fitted
    assert lowest.model.poses is not None
    beside = lowest.theta + np.where(np.arange(lowest.theta.size) % 2, 2.0, 0.0)
    stuck = best_fit_from(lowest.model, laxity, lowest.noise, [beside], most_steps=1)
    assert stuck.deviance > lowest.deviance + LOWER
    found = lowest_fit(replace(base, fitted=stuck), 0).fitted
    assert found.deviance == pytest.approx(lowest.deviance, abs=0.01)
