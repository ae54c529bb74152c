"""Surface roughness: predicted changes against surfaces that were really changed."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import small_knee, small_protocol

from identknee.mechanics.contact_points import distances
from identknee.mechanics.distance_field import build_field
from identknee.model.effects.tissues import Cartilage
from identknee.model.laxity_model import ContactGeometry, LaxityModel, trial_contacts
from identknee.model.residuals import (
    ROUGHNESS_LENGTH,
    SurfaceBumps,
    surface_bumps,
    surface_changes,
)
from identknee.runs.declare import Array

HEIGHT = 2e-4  # mm
# A raised femur is what the columns are derivatives for, up to kinks where points just touch. The
# tibia is raised along its own normals, for which the columns take the femur's.
CLOSE = {"femur": 0.01, "tibia": 0.04}


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    return LaxityModel(knee=small_knee(), protocol=small_protocol())


@pytest.fixture(scope="module")
def soft_model(model: LaxityModel) -> LaxityModel:
    return model.with_effects([Cartilage()])


def soft_theta(model: LaxityModel) -> Array:
    return model.parameters.vector({"cartilage.ln_modulus": -0.7, "cartilage.exponent": 0.5})


def test_bumps_of_random_heights_are_a_surface_of_unit_roughness() -> None:
    x, z = np.meshgrid(np.arange(-12.0, 12.5, 1.0), np.arange(-12.0, 12.5, 1.0))
    places = np.stack([x.ravel(), 0.02 * x.ravel() ** 2, z.ravel()], axis=1)
    bumps = SurfaceBumps(centres=places[::7], length=ROUGHNESS_LENGTH)
    heights = bumps.heights(places)
    np.testing.assert_allclose((heights**2).sum(axis=1), 1.0, rtol=1e-12)
    middle = np.argmin(np.linalg.norm(places, axis=1))
    away = np.linalg.norm(places - places[middle], axis=1)
    expected = np.exp(-(away**2) / (4.0 * ROUGHNESS_LENGTH**2))
    near = np.abs(places).max(axis=1) < 6.0
    # The correlation of evenly spread bumps; those of the test are a grid's every seventh place.
    np.testing.assert_allclose((heights @ heights[middle])[near], expected[near], atol=0.05)


def test_rises_are_the_changes_of_heights() -> None:
    generator = np.random.default_rng(1)
    bumps = SurfaceBumps(centres=generator.uniform(-6.0, 6.0, (9, 3)), length=ROUGHNESS_LENGTH)
    places, step = generator.uniform(-5.0, 5.0, (4, 3)), 1e-5
    for axis, move in enumerate(step * np.eye(3)):
        difference = (bumps.heights(places + move) - bumps.heights(places - move)) / (2.0 * step)
        along = np.zeros((len(places), 1, 3))
        along[:, 0, axis] = 1.0
        rises = bumps.rises(bumps.heights(places), along)
        np.testing.assert_allclose(rises[0], difference.sum(axis=0), atol=1e-8)


def test_contact_carries_the_force_of_the_kernel(soft_model: LaxityModel) -> None:
    prediction = soft_model.predict(soft_theta(soft_model))
    forces = [x.force.sum() for x in trial_contacts(soft_model, prediction)]
    # The kernel adds the lengths of force vectors, whose gradient of the distance is not quite 1.
    np.testing.assert_allclose(forces, prediction.centres[:, :, 0].sum(axis=1), rtol=5e-3)


@pytest.mark.parametrize("bone", ["tibia", "femur"])
@pytest.mark.parametrize("is_soft", [False, True])
def test_columns_are_what_a_changed_surface_does(
    bone: str, is_soft: bool, model: LaxityModel, soft_model: LaxityModel
) -> None:
    used = soft_model if is_soft else model
    theta = soft_theta(used) if is_soft else used.parameters.center
    prediction = used.predict(theta)
    contacts = trial_contacts(used, prediction)
    on_tibia, on_femur = surface_bumps(contacts, used.joint.contact.points, ROUGHNESS_LENGTH)
    columns = surface_changes(used, prediction, ROUGHNESS_LENGTH)
    n = len(on_tibia.centres)
    assert columns.shape[2] == n + len(on_femur.centres)
    chosen = columns[:, :, :n] if bone == "tibia" else columns[:, :, n:]
    heights = np.random.default_rng(2).standard_normal(chosen.shape[2])

    def changed(size: float) -> ContactGeometry:
        if bone == "tibia":
            return raised_tibia(used, on_tibia, np.asarray(size * heights))
        return raised_femur(used, on_femur, np.asarray(size * heights))

    up, down = (with_joint(used, changed(x)).predict(theta) for x in (HEIGHT, -HEIGHT))
    # Compared in the coordinates themselves, each over its own size.
    found = (up.coordinates - down.coordinates) / (2.0 * HEIGHT)
    expected = chosen @ heights
    error = np.linalg.norm(found - expected, axis=0) / np.linalg.norm(found, axis=0)
    assert error.max() < CLOSE[bone]


def raised_tibia(model: LaxityModel, bumps: SurfaceBumps, heights: Array) -> ContactGeometry:
    """The joint with contact points of the tibia moved along the normals of its dishes."""
    contact = model.joint.contact
    normals = np.zeros((len(contact.points), 3))
    for c in range(contact.n_compartments):
        own = contact.compartment == c
        x, y, z = contact.points[own].T
        # The dishes are paraboloids: their height is a quadratic polynomial of x and z.
        basis = np.stack([np.ones_like(x), x, z, x * x, x * z, z * z], axis=1)
        _, bx, bz, cxx, cxz, czz = np.linalg.lstsq(basis, y, rcond=None)[0]
        slope_x, slope_z = bx + 2.0 * cxx * x + cxz * z, bz + cxz * x + 2.0 * czz * z
        normals[own] = np.stack([-slope_x, np.ones_like(x), -slope_z], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shift = (bumps.heights(contact.points) @ heights)[:, None] * normals
    return replace(model.joint, contact=replace(contact, points=contact.points + shift))


def raised_femur(model: LaxityModel, bumps: SurfaceBumps, heights: Array) -> ContactGeometry:
    """The joint with a femur whose signed distance is less by the heights."""
    field = model.joint.field

    def distance(places: Array) -> Array:
        return distances(field, places)[0] - bumps.heights(places) @ heights

    upper = field.origin + field.spacing * (np.array(field.coefficients.shape) - 1)
    margin = 4.0 * field.spacing
    return replace(
        model.joint, field=build_field(distance, field.origin + 2 * margin, upper - 2 * margin)
    )


def with_joint(model: LaxityModel, joint: ContactGeometry) -> LaxityModel:
    other = replace(model)
    object.__setattr__(other, "joint", joint)
    return other
