"""Where the surfaces of a pose touch: depth, force and stiffness of every contact point."""

import numpy as np

from identknee.mechanics.contact_law import ContactLaw
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.equilibria import ContactPoints
from identknee.mechanics.placement import place
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import declared, entry


@declared
class ContactPlaces:
    """The k points of the tibia that touch the femur in one pose."""

    index: IntArray = entry("Which contact points they are, shape ``(k,)``")
    femoral: Array = entry("Where they are, in the axes of the field [mm], shape ``(k, 3)``")
    jacobian: Array = entry("Derivatives of those places by the pose, shape ``(k, 5, 3)``")
    deepening: Array = entry("Derivatives of the depths by the pose [mm/rad, -], shape ``(k, 5)``")
    force: Array = entry("Force of each [N], shape ``(k,)``")
    stiffness: Array = entry("Derivative of the force by the depth [N/mm], shape ``(k,)``")


def contact_places(
    contact: ContactPoints, field: DistanceField, flexion: float, pose: Array
) -> ContactPlaces:
    """The contact at `flexion` [rad] and a pose (5,), with the forces of the kernel's law."""
    placement, law = place(flexion, pose), contact.law or ContactLaw()
    places = field.to_field(placement.to_femur(contact.points))
    index = np.flatnonzero(_may_touch(field, places))
    distance, outward = distances(field, places[index])
    inside = distance < law.rounding
    index, depth = index[inside], -distance[inside]
    jacobian = placement.jacobian(contact.points[index])
    if field.turn is not None:
        jacobian = jacobian @ field.turn.T
    pressure, slope = law.pressure(depth)
    return ContactPlaces(
        index=index,
        femoral=places[index],
        jacobian=jacobian,
        deepening=-np.einsum("kai,ki->ka", jacobian, outward[inside]),
        force=contact.areas[index] * pressure,
        stiffness=contact.areas[index] * slope,
    )


def distances(field: DistanceField, places: Array) -> tuple[Array, Array]:
    """Signed distance [mm] of places (n, 3) inside the grid, ``(n,)``, and its gradient (n, 3)."""
    at = (places - field.origin) / field.spacing
    cell = np.floor(at).astype(np.int64)
    weights, slopes = _spline_weights(at - cell)
    x, y, z = (cell[:, axis, None] + np.arange(-1, 3) for axis in range(3))
    nodes = field.coefficients[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]]

    def summed(x: Array, y: Array, z: Array) -> Array:
        along_y = np.einsum("nijk,nk,nj->ni", nodes, z, y)
        total: Array = (along_y * x).sum(axis=1)
        return total

    gradient = [
        summed(*(slopes[:, i] if i == axis else weights[:, i] for i in range(3)))
        for axis in range(3)
    ]
    value = summed(weights[:, 0], weights[:, 1], weights[:, 2])
    return value, np.stack(gradient, axis=1) / field.spacing


def _may_touch(field: DistanceField, places: Array) -> BoolArray:
    """Which places lie in cells that may hold contact; those at the grid's faces do not."""
    last = np.array(field.reach.shape) - 1
    cell = np.clip(np.floor((places - field.origin) / field.spacing), 0, last).astype(np.int64)
    may: BoolArray = field.reach[cell[:, 0], cell[:, 1], cell[:, 2]] > 0
    return may


def _spline_weights(u: Array) -> tuple[Array, Array]:
    """Cubic B-spline weights at places ``u`` within cells and their slopes, ``(..., 4)``."""
    a = 1.0 - u
    weights = [
        a**3 / 6.0,
        (4.0 - 6.0 * u**2 + 3.0 * u**3) / 6.0,
        (4.0 - 6.0 * a**2 + 3.0 * a**3) / 6.0,
        u**3 / 6.0,
    ]
    slopes = [-(a**2) / 2.0, (3.0 * u**2 - 4.0 * u) / 2.0, (4.0 * a - 3.0 * a**2) / 2.0, u**2 / 2.0]
    return np.stack(weights, axis=-1), np.stack(slopes, axis=-1)
