"""Contact in one pose: its spline against scipy's, its forces against the kernel's gradient."""

from dataclasses import replace

import numpy as np
import pytest
from energy_evaluation import NO_LOAD, Evaluator, field_values
from small_knee import small_knee, small_protocol
from tolerances import CLOSED_FORM, DIFFERENCE

from identknee.mechanics.contact_points import contact_places, distances
from identknee.mechanics.distance_field import MOST_ROUNDING, ContactLaw
from identknee.model.laxity_model import ContactGeometry, LaxityModel, contact_geometry
from identknee.runs.declare import Array


@pytest.fixture(scope="module")
def joint() -> ContactGeometry:
    return contact_geometry(small_knee())


@pytest.fixture(scope="module")
def pose() -> Array:
    model = LaxityModel(knee=small_knee(), protocol=small_protocol())
    first: Array = model.predict(model.parameters.center).poses[0]
    return first


def test_distances_are_those_of_the_spline(joint: ContactGeometry) -> None:
    field = joint.field
    size = field.spacing * (np.array(field.coefficients.shape) - 1)
    places = field.origin + size * np.random.default_rng(0).uniform(0.2, 0.8, (50, 3))
    value, gradient = distances(field, places)
    np.testing.assert_allclose(value, field_values(field, places), atol=CLOSED_FORM * size.max())
    step = 1e-4
    for axis, move in enumerate(step * np.eye(3)):
        difference = (field_values(field, places + move) - field_values(field, places - move)) / (
            2.0 * step
        )
        np.testing.assert_allclose(gradient[:, axis], difference, atol=DIFFERENCE)


@pytest.mark.parametrize(
    "law",
    [
        ContactLaw(),
        ContactLaw(modulus=4.0, exponent=1.5),
        ContactLaw(rounding=MOST_ROUNDING),
        ContactLaw(exponent=1.3, rounding=0.05),
    ],
)
def test_forces_are_those_of_the_kernel(
    law: ContactLaw, joint: ContactGeometry, pose: Array
) -> None:
    contact = replace(joint.contact, law=law)
    evaluator = Evaluator(replace(joint, contact=contact))
    slack = joint.lines.arrays(np.zeros(4), np.zeros(4))
    kernel = evaluator(0.0, pose, slack, NO_LOAD)
    found = contact_places(contact, joint.field, np.array([0.0]), pose[None])
    assert set(found.index.tolist()) == kernel.touching
    gradient = found.force @ found.deepening
    np.testing.assert_allclose(gradient, kernel.gradient, atol=1e-9 * np.abs(gradient).max())


def test_slopes_are_those_of_force_and_place(joint: ContactGeometry, pose: Array) -> None:
    contact = replace(joint.contact, law=ContactLaw(exponent=1.3))
    here = contact_places(contact, joint.field, np.array([0.1]), pose[None])
    middle = int(np.argmax(here.force))
    point = here.index[middle]
    step = 1e-6
    for k, move in enumerate(step * np.eye(5)):
        high, low = (
            contact_places(contact, joint.field, np.array([0.1]), (pose + x)[None])
            for x in (move, -move)
        )
        at = [int(np.flatnonzero(x.index == point)[0]) for x in (high, low)]
        slope = (high.femoral[at[0]] - low.femoral[at[1]]) / (2.0 * step)
        np.testing.assert_allclose(here.jacobian[middle, k], slope, atol=1e-6)
        force = (high.force[at[0]] - low.force[at[1]]) / (2.0 * step)
        expected = here.stiffness[middle] * here.deepening[middle, k]
        assert force == pytest.approx(expected, rel=1e-5, abs=1e-5)


def test_far_away_nothing_touches(joint: ContactGeometry, pose: Array) -> None:
    away = pose - np.array([0.0, 0.0, 0.0, 500.0, 0.0])
    assert contact_places(joint.contact, joint.field, np.array([0.0]), away[None]).index.size == 0
