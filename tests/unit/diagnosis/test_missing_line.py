"""A structure that the model lacks is found as a line; what is not a line is said not to be."""

from dataclasses import replace

import numpy as np
import pytest
from posed_knees import posed_reference

from identknee.diagnosis.fitting import Refit, best_fit_from
from identknee.diagnosis.misfit import smooth_patterns
from identknee.diagnosis.missing_line import find_line
from identknee.diagnosis.noise_model import build_noise_model
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.structures import structure_at
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.insertion_sites import structure_sites
from identknee.subject.knee import Knee

# The project's marks.
OFFSET_MM, ANGLE_DEG = 10.0, 15.0


@pytest.fixture(scope="module")
def model(reference: Knee) -> LaxityModel:
    trials = load_protocol("seed63").select(np.arange(0, 63, 2))
    return LaxityModel(knee=reference, protocol=trials)


def fitted(model: LaxityModel, laxity: Laxity) -> Refit:
    """The model without a line, fitted to noisy laxity."""
    if laxity.sd is None:
        raise AssertionError
    protocol, measured = laxity.protocol, laxity.is_measured
    noise = build_noise_model(laxity.sd, measured, correlation=laxity.within_trial_correlation)
    patterns = smooth_patterns(protocol.loads, protocol.flexion_deg, measured)
    return Refit(
        causes=(),
        fitted=best_fit_from(model, laxity, noise, [model.parameters.center]),
        smooth=noise.whiten(patterns),
        noise_degrees=np.inf,
    )


def with_structure(model: LaxityModel, femur: Array, tibia: Array, stiffness: float) -> Laxity:
    hidden = structure_at(
        model.knee, "hidden", [(femur, tibia)], stiffness_sd=1.0, sites_vary=False
    )
    theta = np.r_[1.1 * model.parameters.center, stiffness, 2.0]
    return model.with_effects([hidden]).simulate(theta)


@pytest.mark.parametrize(("stiffness", "is_posed"), [(1.0, True), (0.4, False)])
def test_a_structure_is_found_where_it_is(
    stiffness: float, is_posed: bool, model: LaxityModel
) -> None:
    if is_posed:
        model = LaxityModel(knee=posed_reference(3), protocol=model.protocol)
    site = structure_sites(model.knee)["posteromedial"][0]
    femur, tibia = site.femur + np.array([4.0, -3.0, 2.0]), site.tibia + np.array([-3.0, 4.0, 0.0])
    laxity = with_structure(model, femur, tibia, stiffness)
    noisy = add_noise(laxity, sd_mm=0.3, sd_deg=0.3, seed=5, correlation=0.3)
    found = find_line(fitted(model, noisy))
    assert found is not None
    assert found.is_line
    assert found.side == "medial"
    assert found.p_value < 0.01
    assert found.refit.fitted.misfit < found.misfit_before
    along = (femur - tibia) / np.linalg.norm(femur - tibia)
    direction = (found.femur - found.tibia) / np.linalg.norm(found.femur - found.tibia)
    away = 0.5 * (femur + tibia) - found.femur
    offset = float(np.linalg.norm(away - (away @ direction) * direction))
    angle = float(np.degrees(np.arccos(along @ direction)))
    assert offset < OFFSET_MM
    assert angle < ANGLE_DEG
    assert 0.0 <= found.force_interval[0] < found.force < found.force_interval[1]
    assert found.force_interval[0] > 0.0
    assert found.trial in model.protocol.trials
    assert "medial" in found.sentence


@pytest.mark.slow
def test_errors_without_pattern_are_not_a_line_force(model: LaxityModel) -> None:
    laxity = add_noise(model.simulate(model.parameters.center), sd_mm=0.3, sd_deg=0.3, seed=6)
    coordinates = np.array(laxity.coordinates)
    coordinates[::2, 0] += 1.0
    found = find_line(fitted(model, replace(laxity, coordinates=coordinates)))
    assert found is not None
    assert not found.is_line
    assert found.sentence.startswith("Not a line")
