"""Limits of plausibility in every verb that fits: they count alike, and are asked for."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from quick_calls import ALL_BUT_FOUR, quick, quick_verbs

import identknee as ik
from identknee.calibrate.problem import PLAUSIBILITY_TERM
from identknee.identify.profile.result import ProfileVerdict
from identknee.subject.plausibility import Limit
from identknee.verbs.answer import IN_WORDS
from identknee.verbs.fitted_knee import fitted_knee

LIMIT = Limit(form="strength", quantity="ACL.tension_N", size=200.0, spread=20.0)
NAME = "ACL.stiffness_kN"


@pytest.fixture(scope="module")
def laxity() -> ik.Laxity:
    made = ik.simulate("reference", "drawer")
    noise = np.random.default_rng(2).normal(0.0, 0.5, made.coordinates.shape)
    return ik.Laxity(
        protocol=made.protocol,
        coordinates=made.coordinates + noise,
        sd=np.full(made.coordinates.shape, 0.5),
    )


@pytest.mark.parametrize(
    "verb", quick_verbs(slow=("design", "sample", "equivalents", "profile", "information"))
)
def test_limits_count_in_the_deviance_of_every_verb(verb: str, laxity: ik.Laxity) -> None:
    plain = quick(verb, "reference", laxity, fixed=ALL_BUT_FOUR)
    found = quick(verb, "reference", laxity, fixed=ALL_BUT_FOUR, plausible=[LIMIT])
    assert plain.question is not None
    assert found.question is not None
    assert plain.question.plausibility == ()
    assert found.question.plausibility == (LIMIT.name,)
    assert found.question.differences(plain.question) == (IN_WORDS["plausibility"],)
    assert PLAUSIBILITY_TERM not in {x.name for x in plain.evidence}
    term = next(x for x in found.evidence if x.name == PLAUSIBILITY_TERM)
    assert term.n == 1
    assert term.deviance > 0.5
    # The ACL of the data carries 400 N; what is fitted to both carries less.
    data = {x.evidence[0].name: x.evidence[0].deviance for x in (plain, found)}
    assert len(data) == 1
    assert found.evidence[0].deviance > plain.evidence[0].deviance


def test_a_fit_says_what_limits_cost_and_a_file_keeps_it(laxity: ik.Laxity, tmp_path: Path) -> None:
    found = ik.fit(
        "reference", laxity, fixed=ALL_BUT_FOUR, plausible=[LIMIT], more_starts=2, out=tmp_path
    )
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
    options: Mapping[str, Any] = {"fixed": ALL_BUT_FOUR, "more_starts": 0}
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
        "fixed": [*ALL_BUT_FOUR, NAME, "PCL.reference_strain_pct", "MCL.reference_strain_pct"],
    }
    plain = ik.profile("reference", laxity, **options).profiles[0]
    limit = Limit(form="strength", quantity="ACL.tension_N", size=400.0, spread=10.0)
    found = ik.profile("reference", laxity, plausible=[limit], **options).profiles[0]
    assert plain.upper_origin != "limit"
    assert found.upper_origin == "limit"
    assert found.verdict is ProfileVerdict.BOUNDED_BY_ASSUMPTION
