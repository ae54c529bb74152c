"""Forces and strains that no knee has are findings of a fit."""

from dataclasses import replace

import numpy as np
import pytest

import identknee as ik
from identknee.checks.fit_checks import implausible_findings
from identknee.model.effects.library import effect_named
from identknee.model.line_loads import structure_values, tensions_of


@pytest.fixture(scope="module")
def model() -> ik.LaxityModel:
    """The reference knee under a few trials."""
    protocol = ik.load_protocol("seed63").select(range(18))
    return ik.LaxityModel(knee=ik.reference_knee(), protocol=protocol)


def test_the_reference_knee_is_believable(model: ik.LaxityModel) -> None:
    prediction = model.predict(model.parameters.start, derivatives=False)
    assert implausible_findings(model, prediction) == ()


def test_a_strain_beyond_failure_is_said_with_its_trial_and_source(model: ik.LaxityModel) -> None:
    prediction = model.predict(model.parameters.start, derivatives=False)
    theta = np.array(prediction.theta)
    theta[4] += 14.0
    longer = replace(prediction, theta=theta)
    tension = np.nanmax(tensions_of(model, longer)[:, 0])
    found = implausible_findings(model, longer)[-1]
    strain = 100.0 * (tension / (1000.0 * theta[0]) + 0.03)
    assert (found.code, found.where) == ("implausible-strain", "ACL")
    assert found.values["strain_pct"] == pytest.approx(strain, abs=0.5)
    assert "doi:" in found.sentence


def test_a_force_beyond_twice_the_failure_load_is_said(model: ik.LaxityModel) -> None:
    theta = np.array(model.parameters.start)
    prediction = model.predict(theta, derivatives=False)
    theta[2] = 24.0
    (found,) = [
        x
        for x in implausible_findings(model, replace(prediction, theta=theta))
        if x.code == "implausible-force"
    ]
    assert found.where == "LCL"
    assert "varus moment" in found.values["load"]
    assert found.values["force_N"] > 2.0 * found.values["failure_N"] == 590.0


def test_a_force_of_an_added_structure_is_said(model: ik.LaxityModel) -> None:
    own = model.with_effects([effect_named(model.knee, "deep_mcl")])
    theta = np.array(own.parameters.start)
    theta[own.parameters.index("deep_mcl.stiffness_kN")] = 15.0
    theta[own.parameters.index("deep_mcl.reference_strain_pct")] = 6.0
    prediction = own.predict(theta, derivatives=False)
    largest = np.nanmax(structure_values(own, prediction, "deep_mcl")[0])
    found = {x.where: x for x in implausible_findings(own, prediction)}["deep_mcl"]
    assert found.code == "implausible-force"
    assert found.values["force_N"] == pytest.approx(largest)
    assert largest > 2.0 * found.values["failure_N"] == 202.0


def test_contact_on_one_side_alone_is_said(model: ik.LaxityModel) -> None:
    prediction = model.predict(model.parameters.start, derivatives=False)
    centres = np.array(prediction.centres)
    centres[:, :, 0] = [850.0, 20.0]
    pressed = replace(prediction, centres=centres)
    (found,) = implausible_findings(model, pressed)
    # The same number by name.
    trial = model.protocol.trials[0]
    for name in ("medial_N", "lateral_N"):
        quantity = ik.model.quantity_named(model, f"contact.{name}@{trial}")
        assert quantity.value(pressed) == found.values[name]
    assert (found.code, found.where) == ("one-sided-contact", "contact")
    assert (found.values["medial_N"], found.values["lateral_N"]) == (850.0, 20.0)
    centres[:, :, 0] = [450.0, 400.0]
    assert implausible_findings(model, replace(prediction, centres=centres)) == ()
