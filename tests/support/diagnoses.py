"""Diagnoses of short data, with and without an effect in them, made once for all tests."""

from functools import cache

import numpy as np

from identknee.diagnosis.investigation import Investigation, investigate
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee
from identknee.verbs.diagnosis import Diagnosis, diagnosis_of

FRAME = "femur_frame"
FRAME_DEG = 3.0
SD = 0.3


def short_trials() -> Protocol:
    """Eighteen of the 63 trials: moments of 0, 4 and 8 N·m at 0 and 30 deg."""
    whole = load_protocol("seed63")
    sizes = np.abs(whole.loads).max(axis=1)
    kept = np.isin(sizes, (0.0, 4.0, 8.0)) & np.isin(whole.flexion_deg, (0.0, 30.0))
    return whole.select(np.flatnonzero(kept))


def short_data(knee: Knee, effect: str | None, *, seed: int = 2) -> Laxity:
    """The knee's own laxity with noise of 0.3 mm and 0.3 deg, and 3 of an effect's first unit."""
    effects = () if effect is None else (effect_named(knee, effect),)
    model = LaxityModel(knee=knee, protocol=short_trials(), effects=effects)
    theta = np.array(model.parameters.center)
    theta[model.n_ligament_parameters :][:1] = FRAME_DEG
    return add_noise(model.simulate(theta), sd_mm=SD, sd_deg=SD, seed=seed)


@cache
def diagnosed(effect: str | None) -> Investigation:
    """What the diagnosis of such data of the reference knee finds."""
    knee = reference_knee()
    found = investigate(knee, short_data(knee, effect))
    assert found is not None
    return found


@cache
def answered(effect: str | None) -> Diagnosis:
    """The answer of `diagnose` to such data."""
    return diagnosis_of(diagnosed(effect))
