"""An insertion that lies elsewhere by more than the knee states is a cause with a direction."""

import re
from functools import cache

import numpy as np
from diagnoses import SD, short_trials

from identknee.diagnosis.candidates import insertions_beyond_prior
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.loads import compression
from identknee.model.effects.readings import tibia_frame
from identknee.model.effects.tissues import moved_insertion
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Knee, Uncertainty
from identknee.subject.reference import reference_knee
from identknee.verbs.diagnosis import diagnosis_of

STATED = Uncertainty(insertions_mm=0.5)
SHIFT = np.array([0.0, -7.0, 0.0])


def elsewhere(shift: np.ndarray) -> Knee:
    """The reference knee, the LCL on the femur elsewhere."""
    return moved_insertion(reference_knee(), "LCL", "femur").applied(reference_knee(), shift)


def laxity_of(knee: Knee) -> Laxity:
    model = LaxityModel(knee=knee, protocol=short_trials())
    return add_noise(model.simulate(model.parameters.start), sd_mm=SD, sd_deg=SD, seed=1)


@cache
def diagnosed() -> Investigation:
    found = investigate(
        reference_knee().with_uncertainty(STATED),
        laxity_of(elsewhere(SHIFT)),
        effects=(tibia_frame(), compression()),
    )
    assert found is not None
    return found


def test_it_is_named_with_ligament_bone_and_direction() -> None:
    found = diagnosed()
    assert found.conclusion.verdict is Verdict.NAMED
    (cause,) = diagnosis_of(found).causes
    assert cause.name == "insertion"
    assert re.search("LCL.*femur", cause.meaning)
    assert "more distal" in cause.meaning


def test_the_extended_knee_has_it_there() -> None:
    given, extended = reference_knee(), diagnosed().extended_knee
    (place,) = (i for i, x in enumerate(given.ligaments) if x.name == "LCL")
    moved = extended.ligaments[place].femur - given.ligaments[place].femur
    along = given.femur_frame.axes @ moved
    assert along[1] < -4.0
    np.testing.assert_allclose(
        extended.ligaments[place].tibia, given.ligaments[place].tibia, rtol=0, atol=0
    )
    values = diagnosed().explanation.fitted_values["insertion"]
    assert not any(x.endswith("proximal_mm") for x in values)


def test_the_shift_is_that_of_a_knee_attached_there() -> None:
    """The effect moves the insertion as a knee made with it elsewhere has it."""
    knee = reference_knee()
    effect = moved_insertion(knee, "LCL", "femur")
    model = LaxityModel(knee=knee, protocol=short_trials(), effects=(effect,))
    own = LaxityModel(knee=elsewhere(SHIFT), protocol=short_trials())
    with_effect = model.simulate(np.r_[own.parameters.start, SHIFT])
    np.testing.assert_allclose(
        with_effect.coordinates, own.simulate(own.parameters.start).coordinates, atol=1e-6
    )


def test_an_insertion_within_what_is_stated_is_no_cause() -> None:
    knee = reference_knee().with_uncertainty(STATED)
    found = investigate(knee, laxity_of(reference_knee()), effects=(compression(),))
    assert found is not None
    assert insertions_beyond_prior(found.base.fitted).causes == ()
    assert found.conclusion.verdict is Verdict.ADEQUATE
