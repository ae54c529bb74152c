"""Errors of zero that the trials of a flexion angle share are named where nothing else explains."""

from functools import cache

import numpy as np
from diagnoses import SD, short_trials

from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects import effect as effects
from identknee.model.effects.loads import compression
from identknee.model.effects.readings import remounting, tibia_frame
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Uncertainty
from identknee.subject.reference import reference_knee
from identknee.verbs.diagnosis import diagnosis_of

SIZE = 0.5


def laxity(size: float) -> Laxity:
    """Laxity of the reference knee, each angle with a zero of its own of this size."""
    model = LaxityModel(knee=reference_knee(), protocol=short_trials())
    effect = remounting(np.unique(model.protocol.flexion_deg).tolist())
    extended = model.with_effects([effect])
    drawn = size * np.random.default_rng(2).standard_normal(effect.parameters.n)
    made = extended.simulate(np.r_[model.parameters.start, drawn])
    return add_noise(made, sd_mm=SD, sd_deg=SD, seed=1)


@cache
def diagnosed(size: float, stated: float) -> Investigation:
    knee = reference_knee().with_uncertainty(Uncertainty(zero_mm=stated, zero_deg=stated))
    found = investigate(knee, laxity(size), effects=(tibia_frame(), compression()))
    assert found is not None
    return found


def test_they_are_named_with_their_remedy() -> None:
    found = diagnosed(SIZE, 0.0)
    assert found.conclusion.verdict is Verdict.NAMED
    (cause,) = diagnosis_of(found).causes
    assert cause.name == "remounting"
    assert "--uncertain zero" in cause.meaning


def test_the_extended_knee_states_them() -> None:
    stated = diagnosed(SIZE, 0.0).extended_knee.uncertainty
    assert 0.5 * SIZE < stated.zero_mm < 2.0 * SIZE
    assert 0.5 * SIZE < stated.zero_deg < 2.0 * SIZE


def test_stated_they_are_no_cause() -> None:
    assert diagnosed(SIZE, SIZE).conclusion.verdict is Verdict.ADEQUATE


def test_data_without_them_are_adequate() -> None:
    assert diagnosed(0.0, 0.0).conclusion.verdict is Verdict.ADEQUATE


def test_copies_and_angles_elsewhere() -> None:
    """Copies of the trials have offsets of their own; an angle that is not listed has none."""
    effect = remounting([0.0, 30.0])
    flexion = np.array([30.0, 0.0, 90.0])
    loads = np.zeros((3, 5))
    tests = effects.TrialRecord(flexion_deg=flexion, loads=loads)
    values = np.arange(20.0).reshape(2, 10)
    alone = [effect.observe(np.ones((3, 5)), x, tests) for x in values]
    both = effect.observe(np.ones((6, 5)), values, tests.repeated(2))
    np.testing.assert_allclose(both, np.concatenate(alone), rtol=1e-15)
    np.testing.assert_allclose(alone[0][0], 1.0 + np.arange(5.0, 10.0), rtol=1e-15)
    np.testing.assert_allclose(alone[0][2], 1.0, rtol=1e-15)
