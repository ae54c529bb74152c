"""Contact by compartment in one pose: the kernel's numbers, slopes of differences."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import small_knee, small_protocol
from tolerances import CLOSED_FORM, DIFFERENCE

from identknee.mechanics.contact_points import distance_bending, distances
from identknee.mechanics.distance_field import MOST_ROUNDING, ContactLaw
from identknee.model.contact_loads import CompartmentLoads, compartment_loads
from identknee.model.laxity_model import ContactGeometry, LaxityModel, contact_geometry
from identknee.runs.declare import Array

LAWS = [ContactLaw(), ContactLaw(modulus=4.0, exponent=1.5, rounding=MOST_ROUNDING)]


@pytest.fixture(scope="module")
def joint() -> ContactGeometry:
    return contact_geometry(small_knee())


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    return LaxityModel(knee=small_knee(), protocol=small_protocol())


def _at(joint: ContactGeometry, pose: Array, law: ContactLaw) -> CompartmentLoads:
    contact = replace(joint.contact, law=law)
    return compartment_loads(contact, joint.field, np.zeros(1), pose[None], joint.contact.points)


def test_values_are_those_of_the_kernel(joint: ContactGeometry, model: LaxityModel) -> None:
    found = model.predict(model.parameters.center, derivatives=False)
    flexion = np.radians(model.protocol.flexion_deg)
    own = compartment_loads(joint.contact, joint.field, flexion, found.poses, joint.contact.points)
    np.testing.assert_allclose(own.values, found.centres[:, :, :4], rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_slopes_by_the_pose_are_those_of_differences(
    joint: ContactGeometry, model: LaxityModel, law: ContactLaw
) -> None:
    pose = model.predict(model.parameters.center, derivatives=False).poses[0]
    slopes, step = _at(joint, pose, law).by_pose, 1e-6
    for k in range(5):
        move = step * np.eye(5)[k]
        low, high = (_at(joint, pose + x, law).values for x in (-move, move))
        difference = (high - low)[0] / (2.0 * step)
        size = np.abs(difference).max(axis=0)
        np.testing.assert_allclose(slopes[0, :, :, k] / size, difference / size, atol=DIFFERENCE)


def test_slopes_by_the_law_are_those_of_differences(
    joint: ContactGeometry, model: LaxityModel
) -> None:
    pose = model.predict(model.parameters.center, derivatives=False).poses[0]
    law, other = LAWS[1], ContactLaw(modulus=4.4, exponent=1.5, rounding=MOST_ROUNDING)
    found = _at(joint, pose, law)
    assert found.force_under(law) == pytest.approx(found.force, rel=CLOSED_FORM)
    assert found.force_under(other) == pytest.approx(1.1 * found.force, rel=CLOSED_FORM)
    still = np.zeros((len(found.force), 3, 1))
    changes = found.derivatives(still, (found.force_under(other) - found.force)[:, None])
    np.testing.assert_allclose(changes[0, :, 0, 0], 0.1 * found.values[0, :, 0], rtol=1e-9)
    # A stiffer cartilage in one pose carries more at the same place.
    np.testing.assert_allclose(changes[0, :, 1:], 0.0, atol=1e-9)


def test_what_does_not_touch_has_no_centre(joint: ContactGeometry, model: LaxityModel) -> None:
    pose = np.array(model.predict(model.parameters.center, derivatives=False).poses[0])
    pose[3] -= 5.0
    found = _at(joint, pose, LAWS[0])
    np.testing.assert_array_equal(found.values[0, :, 0], 0.0)
    assert np.isnan(found.values[0, :, 1:]).all()
    assert not found.by_pose[0, :, 0].any()


def test_the_distance_bends_as_its_gradient_changes(joint: ContactGeometry) -> None:
    field, step = joint.field, 1e-5
    size = field.spacing * (np.array(field.coefficients.shape) - 1)
    places = field.origin + size * np.random.default_rng(1).uniform(0.2, 0.8, (50, 3))
    bending = distance_bending(field, places)
    np.testing.assert_array_equal(bending, np.swapaxes(bending, 1, 2))
    for axis, move in enumerate(step * np.eye(3)):
        low, high = (distances(field, places + x)[1] for x in (-move, move))
        np.testing.assert_allclose(
            bending[:, axis], (high - low) / (2.0 * step), atol=10.0 * DIFFERENCE
        )
