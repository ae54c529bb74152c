"""Forces and strains that no knee has are findings of a fit."""

from dataclasses import replace

import numpy as np
import pytest

import identknee as ik
from identknee.model.quantities import tensions_of
from identknee.scrutiny.unmeasured import unmeasured_findings


@pytest.fixture(scope="module")
def model() -> ik.LaxityModel:
    """The reference knee under a few trials."""
    protocol = ik.load_protocol("seed63").select(range(18))
    return ik.LaxityModel(knee=ik.reference_knee(), protocol=protocol)


def test_the_reference_knee_is_believable(model: ik.LaxityModel) -> None:
    prediction = model.predict(model.parameters.start, derivatives=False)
    assert unmeasured_findings(model, prediction) == ()


def test_a_strain_beyond_failure_is_said_with_its_trial_and_source(model: ik.LaxityModel) -> None:
    prediction = model.predict(model.parameters.start, derivatives=False)
    theta = np.array(prediction.theta)
    theta[4] += 14.0
    longer = replace(prediction, theta=theta)
    tension = np.nanmax(tensions_of(model, longer)[:, 0])
    found = unmeasured_findings(model, longer)[-1]
    strain = 100.0 * (tension / (1000.0 * theta[0]) + 0.03)
    assert found.where == "ACL"
    assert f"ACL is strained by {strain:.0f} %" in found.sentence
    assert "doi:" in found.sentence


def test_a_force_beyond_twice_the_failure_load_is_said(model: ik.LaxityModel) -> None:
    theta = np.array(model.parameters.start)
    prediction = model.predict(theta, derivatives=False)
    theta[2] = 24.0
    (found,) = [
        x
        for x in unmeasured_findings(model, replace(prediction, theta=theta))
        if "carries" in x.sentence
    ]
    assert found.where == "LCL"
    assert "of varus moment at" in found.sentence
    assert "fails at 295 N on average" in found.sentence


def test_contact_on_one_side_alone_is_said(model: ik.LaxityModel) -> None:
    prediction = model.predict(model.parameters.start, derivatives=False)
    centres = np.array(prediction.centres)
    centres[:, :, 0] = [850.0, 20.0]
    (found,) = unmeasured_findings(model, replace(prediction, centres=centres))
    assert found.where == "contact"
    assert "carries 850 N medially and 20 N laterally" in found.sentence
    centres[:, :, 0] = [450.0, 400.0]
    assert unmeasured_findings(model, replace(prediction, centres=centres)) == ()
