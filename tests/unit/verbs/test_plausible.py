"""Limits of plausibility in every verb that fits: they count alike, and are asked for."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from slow_cases import some_slow

import identknee as ik
from identknee.calibrate.problem import PLAUSIBILITY_TERM
from identknee.identify.profile.result import ProfileVerdict
from identknee.subject.plausibility import Limit
from identknee.verbs.answer import Answer
from identknee.verbs.fitted_knee import fitted_knee

LIMIT = Limit(form="strength", quantity="ACL.tension_N", size=200.0, spread=20.0)
HELD = ["PCL.stiffness_kN", "LCL.stiffness_kN", "MCL.stiffness_kN", "LCL.reference_strain_pct"]
NAME = "ACL.stiffness_kN"
CALLS: Mapping[str, tuple[Callable[..., Answer], Mapping[str, Any]]] = {
    "fit": (ik.fit, {"more_starts": 0, "weighting": "noise"}),
    "profile": (ik.profile, {"parameters": [NAME]}),
    "information": (ik.information, {}),
    "sweep": (ik.sweep, {"n_starts": 4, "paths": 0}),
    "equivalents": (ik.equivalents, {"n_sets": 4, "forces": "none"}),
    "design": (ik.design, {"n_trials": 1, "candidates": "drawer", "criterion": "c"}),
    "sample": (ik.sample, {"moves": "difference", "budget": 700}),
}


@pytest.fixture(scope="module")
def laxity() -> ik.Laxity:
    made = ik.simulate("reference", "drawer")
    noise = np.random.default_rng(2).normal(0.0, 0.5, made.coordinates.shape)
    return ik.Laxity(
        protocol=made.protocol,
        coordinates=made.coordinates + noise,
        sd=np.full(made.coordinates.shape, 0.5),
    )


@pytest.mark.parametrize("verb", some_slow(CALLS, ("design", "sample", "equivalents")))
def test_limits_count_in_the_deviance_of_every_verb(verb: str, laxity: ik.Laxity) -> None:
    function, options = CALLS[verb]
    plain = function("reference", laxity, fixed=HELD, **options)
    found = function("reference", laxity, fixed=HELD, plausible=[LIMIT], **options)
    assert plain.question is not None
    assert found.question is not None
    assert plain.question.plausibility == ()
    assert found.question.plausibility == (LIMIT.name,)
    assert found.question.differences(plain.question) == ("limits of plausibility",)
    assert PLAUSIBILITY_TERM not in {x.name for x in plain.evidence}
    term = next(x for x in found.evidence if x.name == PLAUSIBILITY_TERM)
    assert term.n == 1
    assert term.deviance > 0.5
    # The ACL of the data carries 400 N; what is fitted to both carries less.
    data = {x.evidence[0].name: x.evidence[0].deviance for x in (plain, found)}
    assert len(data) == 1
    assert found.evidence[0].deviance > plain.evidence[0].deviance


def test_a_fit_says_what_limits_cost_and_a_file_keeps_it(laxity: ik.Laxity, tmp_path: Path) -> None:
    found = ik.fit("reference", laxity, fixed=HELD, plausible=[LIMIT], more_starts=2, out=tmp_path)
    price = found.plausibility
    assert price is not None
    assert price.price > 1.0
    assert price.limits[0].drop_one == pytest.approx(price.price, rel=1e-6)
    loaded: Any = ik.load(tmp_path)
    assert loaded.plausibility.price == price.price
    assert loaded.plausibility.limits[0].limit.name == LIMIT.name
    assert loaded.plausibility.without == pytest.approx(price.without)


def test_noise_that_is_not_stated_is_asked_for(laxity: ik.Laxity) -> None:
    unstated = ik.Laxity(protocol=laxity.protocol, coordinates=laxity.coordinates)
    for function in (ik.fit, ik.profile):
        with pytest.raises(ValueError, match="--noise"):
            function("reference", unstated, plausible="default")


def test_the_knee_of_a_result_is_known_again_and_its_limits_are_an_input(
    laxity: ik.Laxity,
) -> None:
    options: Mapping[str, Any] = {"fixed": HELD, "more_starts": 0}
    plain = ik.fit("reference", laxity, **options)
    found = ik.fit("reference", laxity, plausible=[LIMIT], weighting="noise", **options)
    assert plain.record is not None
    assert found.record is not None
    assert found.record.inputs["subject"] == plain.record.inputs["subject"]
    assert set(found.record.inputs) - set(plain.record.inputs) == {"plausibility"}
    fitted = fitted_knee(ik.reference_knee(), found)
    assert fitted.ligament("ACL").stiffness_kN == pytest.approx(found.search.theta[0])


def test_an_end_that_limits_make_is_not_of_the_data(laxity: ik.Laxity) -> None:
    """With coarse data the strength of a ligament bounds its strain from above."""
    options: Mapping[str, Any] = {
        "parameters": ["ACL.reference_strain_pct"],
        "noise": "8mm,8deg",
        "fixed": [*HELD, NAME, "PCL.reference_strain_pct", "MCL.reference_strain_pct"],
    }
    plain = ik.profile("reference", laxity, **options).profiles[0]
    limit = Limit(form="strength", quantity="ACL.tension_N", size=400.0, spread=10.0)
    found = ik.profile("reference", laxity, plausible=[limit], **options).profiles[0]
    assert plain.upper_origin != "limit"
    assert found.upper_origin == "limit"
    assert found.verdict is ProfileVerdict.BOUNDED_BY_ASSUMPTION
