"""Causes where limits count: the true one pays no price, and both kinds of evidence are its own."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from elsewhere import Elsewhere

import identknee as ik
from identknee.diagnosis import believability
from identknee.diagnosis.base_fit import with_wider_priors
from identknee.diagnosis.believability import (
    CauseUnderLimits,
    _drawn,
    _log_share,
    causes_under_limits,
)
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.identify.optimum import best_fits
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.model.limit_residuals import LimitResiduals
from identknee.model.line_loads import tensions_of
from identknee.subject.plausibility import Limit

CAPSULE = "posterior_capsule"
FEW = (CAPSULE, "compression", "flexion_offset")
MADE_WITH = {0: 3.0, 1: 3.0, 2: 3.0}


ELSEWHERE = Elsewhere()


def few_trials() -> ik.Protocol:
    return ik.load_protocol("seed63").select(range(0, 63, 3))


@pytest.fixture(scope="module")
def case() -> tuple[ik.Knee, Laxity, float]:
    """A knee whose posterior capsule the model lacks, and the largest force of its PCL."""
    knee = ik.reference_knee()
    model = LaxityModel(knee=knee, protocol=few_trials())
    effect = effect_named(knee, CAPSULE)
    extended = model.with_effects([effect])
    theta = np.array(extended.parameters.start)
    for place, value in MADE_WITH.items():
        theta[model.parameters.n + place] = value
    made = extended.predict(theta, derivatives=False)
    laxity = Laxity(protocol=model.protocol, coordinates=made.coordinates)
    largest = float(tensions_of(extended, made)[:, 1].max())
    return knee, add_noise(laxity, sd_mm=0.3, sd_deg=0.3, seed=1), largest


@pytest.fixture(scope="module")
def found(case: tuple[ik.Knee, Laxity, float]) -> Investigation:
    knee, laxity, _ = case
    made = investigate(knee, laxity, effects=[effect_named(knee, x) for x in FEW])
    assert made is not None
    return made


@pytest.fixture(scope="module")
def weighed(
    case: tuple[ik.Knee, Laxity, float], found: Investigation
) -> tuple[CauseUnderLimits, ...]:
    knee, _, largest = case
    limit = Limit(form="strength", quantity="PCL.tension_N", size=1.05 * largest, spread=10.0)
    names = LaxityModel(knee=knee, protocol=few_trials()).parameters
    stated = with_wider_priors(knee, names, names.names_of_interest, wider=1.0).priors
    with pytest.MonkeyPatch.context() as patch:
        # Fewer starts, causes and draws take a tenth of the time.
        for name, few in (("N_STARTS", 2), ("MOST_CAUSES", 1), ("LOG_DRAWS", 5)):
            patch.setattr(believability, name, few)
        patch.setattr(believability, "best_fits", partial(best_fits, hops=False))
        return causes_under_limits(found, (limit,), stated, seed=0, executor=ELSEWHERE)


def test_the_executor_fits_the_causes(weighed: tuple[CauseUnderLimits, ...]) -> None:
    assert ELSEWHERE.n_done == len(weighed) - 1


def test_the_true_cause_pays_no_price_and_has_the_highest_evidence(
    weighed: tuple[CauseUnderLimits, ...],
) -> None:
    base, first = weighed[:2]
    assert base.names == ()
    assert first.names == (CAPSULE,)
    assert base.price is not None
    assert first.price is not None
    assert first.log_data_difference is not None
    assert base.price > 5.0
    assert first.price < 0.5
    assert first.log_data_difference > 20.0


def test_prices_are_no_gains_and_hold_what_is_beyond_limits(
    weighed: tuple[CauseUnderLimits, ...],
) -> None:
    for x in weighed:
        assert x.price is not None
        assert x.of_limits is not None
        # All of the price is what data and priors pay and what is beyond the limits.
        assert x.price >= x.of_limits - 1e-3
        assert x.of_limits == pytest.approx(sum(y.deviance for y in x.limits), abs=1e-6)
    assert weighed[0].log_data_difference == weighed[0].log_limits_difference == 0.0


def limits_of(knee: ik.Knee, *limits: Limit) -> LimitResiduals:
    protocol = ik.load_protocol("drawer").select([0])
    return LimitResiduals(model=LaxityModel(knee=knee, protocol=protocol), limits=limits)


def test_a_limit_that_no_knee_reaches_is_certain() -> None:
    knee = ik.reference_knee()
    sure = limits_of(knee, Limit(form="strength", quantity="ACL.tension_N", size=1e7, spread=1.0))
    share, se = _log_share(sure, 8, 0)
    model = sure.model
    uniforms = np.random.default_rng(0).uniform(size=(64, 8))
    bears = [model.predict_once(x).is_converged.all() for x in _drawn(model.parameters, uniforms)]
    # Only knees that do not bear the trial are missing.
    expected = np.mean(bears)
    error = np.hypot(se, np.sqrt(expected * (1.0 - expected) / len(bears)) / expected)
    assert abs(share - np.log(expected)) <= 4.0 * max(error, 1e-3)


def test_draws_follow_normal_and_lognormal_priors_within_bounds() -> None:
    parameters = LaxityModel(knee=ik.reference_knee(), protocol=few_trials()).parameters
    uniforms = np.full((3, parameters.n), [[0.5], [1e-12], [1.0 - 1e-12]])
    drawn = _drawn(parameters, uniforms)
    assert (drawn >= parameters.lower).all()
    assert (drawn <= parameters.upper).all()
    # Bounds far off in the unit of the prior leave the middle where it is.
    wide = replace(parameters, lower=np.full(8, -1e3), upper=np.full(8, 1e3))
    wide = replace(wide, lower=np.where(wide.is_log, 1e-9, wide.lower))
    np.testing.assert_allclose(_drawn(wide, uniforms[:1])[0], parameters.center, rtol=1e-6)
