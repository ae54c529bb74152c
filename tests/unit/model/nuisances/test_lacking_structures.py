"""Structures of the library that a model lacks, as nuisances: which, how wide, what they mend."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from quick_calls import ALL_BUT_FOUR

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.laxity.table import add_noise
from identknee.model.effects.library import library
from identknee.model.effects.structures import STIFFNESS_SD
from identknee.model.laxity_model import LaxityModel
from identknee.model.nuisances import nuisances_of
from identknee.model.quantities import ligament_forces
from identknee.runs.declare import Array
from identknee.subject.capsule import with_capsule
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Knee, Uncertainty
from identknee.verbs.fitted_knee import with_stated_uncertainty_of
from identknee.verbs.identification import identification
from identknee.verbs.verb import knee_digest

SD = 0.3
STATED = Uncertainty(structures=1.0)


def test_they_are_nuisances_as_wide_as_stated(reference: Knee) -> None:
    for share in (1.0, 0.5):
        made = nuisances_of(reference.with_uncertainty(Uncertainty(structures=share)))
        assert [x.name for x in made] == [*STIFFNESS_SD]
        for x in made:
            assert not x.parameters.is_of_interest.any()
            assert x.parameters.lower[0] == x.parameters.center[0] == 0.0
            assert x.parameters.prior_sd[0] == share * STIFFNESS_SD[x.name]
    causes = {x.name: x for x in library(reference)}
    assert all(causes[x].parameters.is_of_interest.all() for x in STIFFNESS_SD)


def test_what_the_knee_has_is_not_among_them(reference: Knee) -> None:
    first, *others = reference.ligaments
    named = reference.with_ligaments([first, *others, replace(first, name="deep_mcl")])
    covered = with_capsule(reference, ["posteromedial"])
    abbreviated = reference.with_ligaments([first, *others, replace(first, name="dMCL")])
    for knee, own in (
        (named, "deep_mcl"),
        (abbreviated, "deep_mcl"),
        (covered, "posteromedial"),
    ):
        made = nuisances_of(knee.with_uncertainty(STATED))
        assert {x.name for x in made} == {*STIFFNESS_SD} - {own}


def test_a_knee_of_bundles_lacks_none_of_them() -> None:
    knee = ik.example("s192803_bundles")
    assert nuisances_of(knee.with_uncertainty(STATED)) == ()
    assert not {x.name for x in library(knee)} & {*STIFFNESS_SD}


def test_the_file_of_a_subject_states_them(reference: Knee, tmp_path: Path) -> None:
    stated = reference.with_uncertainty(Uncertainty(structures=0.5))
    write_subject(stated, tmp_path / "knee")
    assert read_subject(tmp_path / "knee").uncertainty == stated.uncertainty
    assert stated.uncertainty.words["structures"] == "50 %"
    assert "structures" not in reference.uncertainty.words
    assert knee_digest(stated) != knee_digest(reference)


def _forces(knee: Knee, laxity: ik.Laxity, true: dict[str, float]) -> tuple[Array, Array]:
    """Errors of the fitted ligament forces and their standard deviations to first order [N]."""
    setup = identification(knee, laxity)
    found = fit(setup.problem, setup.start)
    jacobian = setup.problem.jacobian(found.theta)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    errors, sds = [], []
    for x in ligament_forces(setup.model):
        if (force := true.get(x.name, 0.0)) > 5.0:
            value, slope = x.evaluate(found.theta)
            errors.append(value - force)
            sds.append(float(np.sqrt(slope @ covariance @ slope)))
    return np.array(errors), np.array(sds)


def test_forces_of_a_model_without_a_capsule_are_right_with_them(reference: Knee) -> None:
    truth = LaxityModel(knee=with_capsule(reference), protocol=ik.load_protocol("seed63"))
    theta = np.array(truth.parameters.start)
    laxity = add_noise(truth.simulate(theta), sd_mm=SD, sd_deg=SD, seed=4)
    prediction = truth.predict_once(theta)
    true = {x.name: x.value(prediction) for x in ligament_forces(truth)}
    plain, _ = _forces(reference, laxity, true)
    errors, sds = _forces(reference.with_uncertainty(STATED), laxity, true)
    assert plain.size == errors.size > 50
    assert np.sqrt(np.mean(errors**2)) < 0.35 * np.sqrt(np.mean(plain**2))
    assert np.mean(np.abs(errors) < 1.96 * sds) > 0.85


@pytest.mark.slow
def test_one_option_of_verbs_states_them(reference: Knee) -> None:
    made = ik.simulate(reference, "drawer")
    exact = ik.Laxity(protocol=made.protocol, coordinates=made.coordinates)
    data = add_noise(exact, sd_mm=SD, sd_deg=SD, seed=1)
    found = ik.information(reference, data, fixed=ALL_BUT_FOUR, discrepancy="structures")
    asked = found.question
    assert asked is not None
    assert asked.discrepancy is None
    assert asked.uncertainty["structures"] == "100 %"
    # Its record says it as all verbs take it, so that the knee can be made again from it.
    assert found.record is not None
    assert found.record.settings["uncertain"] == "structures=100%"
    assert with_stated_uncertainty_of(reference, found).uncertainty == STATED


@pytest.mark.parametrize("size", [-0.1, 1.5])
def test_a_share_that_cannot_be_is_refused(size: float) -> None:
    with pytest.raises(ValueError, match="structures"):
        Uncertainty(structures=size)
