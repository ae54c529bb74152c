"""A structure found where anatomy has it, and one that stands in for another beside it."""

from dataclasses import replace

import numpy as np
import pytest
from diagnoses import SD, short_trials

from identknee.diagnosis.fitting import best_fit_from
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.refit import Refit, refit
from identknee.diagnosis.verdict import FAR_OFF, Verdict, shift_mm, site_p_value
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.library import effect_named
from identknee.model.effects.structures import MissingStructure
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Knee

NAME = "anterolateral"
STIFFNESS_KN, STRAIN_PCT = 2.0, 4.0
AWAY_MM = 11.0  # of both insertions, almost three prior standard deviations


def structure_of(knee: Knee) -> MissingStructure:
    effect = effect_named(knee, NAME)
    assert isinstance(effect, MissingStructure)
    return effect


def data_with(knee: Knee, away_mm: float, seed: int = 4) -> Laxity:
    model = LaxityModel(knee=knee, protocol=short_trials(), effects=(structure_of(knee),))
    theta = np.array(model.parameters.center)
    theta[model.n_ligament_parameters :][[0, 1, 2, 5]] = STIFFNESS_KN, STRAIN_PCT, away_mm, away_mm
    return add_noise(model.simulate(theta), sd_mm=SD / 3, sd_deg=SD / 3, seed=seed)


def fitted(knee: Knee, found: Investigation) -> Refit:
    structure = structure_of(knee)
    base = found.base
    start = np.r_[base.fitted.theta, structure.parameters.center]
    start[base.n_base] = STIFFNESS_KN
    return refit(base, [structure], [start])


@pytest.mark.parametrize(("away_mm", "is_rare"), [(0.0, False), (AWAY_MM, True)])
def test_a_structure_far_from_its_place_is_improbable(
    reference: Knee, away_mm: float, is_rare: bool
) -> None:
    found = investigate(reference, data_with(reference, away_mm), effects=[structure_of(reference)])
    assert found is not None
    best = fitted(reference, found)
    p_value = site_p_value(best, structure_of(reference))
    assert (p_value <= FAR_OFF) is is_rare
    assert (shift_mm(best, structure_of(reference)) > 0.5 * AWAY_MM) is is_rare
    doubted = any("from their anatomical sites" in x for x in found.conclusion.reasons)
    assert doubted is is_rare
    if is_rare:
        assert found.conclusion.verdict is not Verdict.NAMED


def test_fixed_insertions_are_where_they_are(reference: Knee) -> None:
    found = investigate(reference, data_with(reference, 0.0), effects=[structure_of(reference)])
    assert found is not None
    fixed = replace(structure_of(reference), sites_vary=False)
    assert site_p_value(found.base, fixed) == 1.0


def test_a_structure_without_stiffness_may_lie_anywhere(reference: Knee) -> None:
    found = investigate(reference, data_with(reference, 0.0), effects=[structure_of(reference)])
    assert found is not None
    base = found.base
    extended = base.fitted.model.with_effects([*base.fitted.model.effects, structure_of(reference)])
    theta = np.r_[base.fitted.theta, structure_of(reference).parameters.center]
    fitted = best_fit_from(extended, base.fitted.laxity, base.fitted.noise, [theta], most_steps=1)
    slack = replace(base, causes=(structure_of(reference),), fitted=fitted)
    assert slack.amplitudes(NAME)[0] == 0.0
    assert site_p_value(slack, structure_of(reference)) == 1.0
