"""What limits of plausibility cost: against another optimizer, and laws of any set of limits."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.checks.limit_price import plausibility_price
from identknee.checks.usable_trials import TrialSearch
from identknee.model.laxity_model import LaxityModel
from identknee.runs.executors import serial
from identknee.subject.plausibility import Limit

KNEE = ik.reference_knee()
PROTOCOL = ik.load_protocol("drawer")
LIMITS = (
    Limit(form="strength", quantity="ACL.tension_N", size=200.0, spread=20.0),
    Limit(form="strength", quantity="LCL.tension_N", size=120.0, spread=20.0),
    Limit(form="strength", quantity="PCL.strain_pct", size=40.0, spread=2.0),
)


def _search() -> TrialSearch:
    model = LaxityModel(knee=KNEE.with_plausibility(LIMITS), protocol=PROTOCOL)
    coordinates = model.predict(model.parameters.start).coordinates
    noise = np.random.default_rng(3).normal(0.0, 0.5, coordinates.shape)
    laxity = ik.Laxity(
        protocol=PROTOCOL,
        coordinates=coordinates + noise,
        sd=np.full(coordinates.shape, 0.5),
    )
    return TrialSearch(model=model, laxity=laxity, weighting="noise", bounds={})


def test_the_price_is_what_another_optimizer_finds_and_that_of_more_limits_is_higher() -> None:
    trials = _search()
    problem = trials.problem(trials.laxity)
    plain = trials.without_limits.problem(trials.laxity)
    start = problem.parameters.start
    ends = [fit(x, start).theta for x in (problem, plain)]
    found = plausibility_price(problem, lambda: problem, ends, executor=serial)
    assert found is not None
    least = []
    for one, end in ((problem, ends[0]), (plain, ends[1])):
        own = one.parameters
        solved = least_squares(
            one.residuals,
            np.clip(end + 0.05, own.lower + 1e-6, own.upper - 1e-6),
            one.jacobian,
            bounds=(own.lower, own.upper),
        )
        least.append(2.0 * solved.cost)
    assert found.price > 2.0
    assert found.price == pytest.approx(least[0] - least[1], abs=0.05)
    assert 0.0 <= found.of_data <= found.price
    acl, lcl, pcl = found.limits
    for x in found.limits:
        assert -1e-9 <= x.alone <= found.price + 1e-9
        assert -1e-9 <= x.drop_one <= found.price + 1e-9
    assert acl.alone > 1.0
    # Together two that pay differently cost no less than each, and one that is met costs nothing.
    assert max(acl.alone, lcl.alone) <= found.price
    assert (pcl.limit.deviance, pcl.drop_one, pcl.alone) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert set(found.without) == set(problem.parameters.names)


def test_a_fit_without_limits_has_no_price() -> None:
    trials = _search().without_limits
    problem = trials.problem(trials.laxity)
    assert plausibility_price(problem, lambda: problem, [problem.parameters.start]) is None
