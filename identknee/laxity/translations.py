"""Translations of a knee by the definitions in use: from each to components and back.

The vector from the femoral to the tibial origin is the same in all of them. `components` along the
oblique axes of the joint are what identknee computes with. They are the femoral lateral axis, the
floating axis and the tibial long axis [1]_. `projections` on the same axes differ from components
where varus is not zero, because the first and the last axis are then not at right angles. `femur`
and `tibia` are the rectangular axes of the bones.

References
----------
.. [1] E. S. Grood and W. J. Suntay, A joint coordinate system for the clinical description of
       three-dimensional motions: application to the knee, J. Biomech. Eng. 105 (1983) 136-144,
       doi:10.1115/1.3138397.
"""

from typing import Literal, get_args

import numpy as np

from identknee.runs.declare import Array

Translations = Literal["components", "projections", "femur", "tibia"]
COMPONENTS: Translations = "components"
DEFINITIONS: tuple[Translations, ...] = get_args(Translations)
# Decimals of a component in mm. Rounded, a table gives the same numbers whichever definition it was
# written in; the rounding errors of a change of axes can lead a fit to another equilibrium.
DECIMALS = 10
# Smaller entries of a matrix are rounding errors: the value that they multiply is not needed.
LEAST = 1e-12


def to_components(definition: Translations, flexion_deg: Array, coordinates: Array) -> Array:
    """Coordinates whose translations are components, from those of another definition.

    Parameters
    ----------
    definition
        What the translations are.
    flexion_deg
        Flexion [deg], shape ``(n,)``.
    coordinates
        Lateral shift, anterior drawer, distraction [mm], varus, internal rotation [deg], shape
        ``(n, 5)``; NaN where not measured.

    Returns
    -------
    coordinates
        Shape ``(n, 5)``, translations to 1e-10 mm; NaN where a component depends on a value that
        was not measured.
    """
    back = _inverse(_matrices(definition, flexion_deg, coordinates))
    found = _changed(back, coordinates)
    found[:, :3] = np.round(found[:, :3], DECIMALS)
    return found


def from_components(definition: Translations, flexion_deg: Array, coordinates: Array) -> Array:
    """Coordinates whose translations follow a definition, from components; see `to_components`."""
    return _changed(_matrices(definition, flexion_deg, coordinates), coordinates)


def sd_of_components(
    definition: Translations, flexion_deg: Array, coordinates: Array, sd: Array
) -> Array:
    """Standard deviations of components, from those of another definition, shape ``(n, 5)``.

    Errors of angles and correlations that the change brings are left out.
    """
    back = _inverse(_matrices(definition, flexion_deg, coordinates))
    return np.sqrt(_changed(back**2, np.where(np.isnan(sd), np.nan, sd**2), is_variance=True))


def sd_from_components(
    definition: Translations, flexion_deg: Array, coordinates: Array, sd: Array
) -> Array:
    """Standard deviations by a definition, from those of components; see `sd_of_components`."""
    forth = _matrices(definition, flexion_deg, coordinates)
    return np.sqrt(_changed(forth**2, np.where(np.isnan(sd), np.nan, sd**2), is_variance=True))


def _matrices(definition: Translations, flexion_deg: Array, coordinates: Array) -> Array:
    """Matrices that turn components into translations of a definition, shape ``(n, 3, 3)``.

    Angles that were not measured count as zero.
    """
    flexion = np.radians(flexion_deg)
    varus, internal = np.nan_to_num(np.radians(coordinates[:, 3:].T))
    # All axes in those of the femur: x anterior, y superior, z lateral.
    zero, one = np.zeros_like(flexion), np.ones_like(flexion)
    lateral, turned = _vector(zero, zero, one), _vector(np.cos(flexion), -np.sin(flexion), zero)
    superior = _vector(
        np.sin(flexion) * np.cos(varus), np.cos(flexion) * np.cos(varus), np.sin(varus)
    )
    oblique = np.stack([lateral, turned, -superior], axis=1)
    if definition == "components":
        return np.broadcast_to(np.eye(3), (len(flexion), 3, 3))
    cross = np.cross(turned, superior)
    cos, sin = np.cos(internal)[:, None], np.sin(internal)[:, None]
    own = {
        "projections": oblique,
        "femur": np.stack([lateral, _vector(one, zero, zero), _vector(zero, -one, zero)], axis=1),
        "tibia": np.stack([cos * cross + sin * turned, cos * turned - sin * cross, -superior], 1),
    }[definition]
    return np.asarray(own @ np.swapaxes(oblique, 1, 2))


def _vector(x: Array, y: Array, z: Array) -> Array:
    return np.stack([x, y, z], axis=1)


def _inverse(matrices: Array) -> Array:
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)


def _changed(matrices: Array, coordinates: Array, *, is_variance: bool = False) -> Array:
    """Coordinates, or variances, with other translations; NaN where one depends on a NaN."""
    matrices = np.where(np.abs(matrices) > (LEAST**2 if is_variance else LEAST), matrices, 0.0)
    known = ~np.isnan(coordinates[:, :3])
    needs = (matrices != 0.0) & ~known[:, None, :]
    changed = np.array(coordinates)
    moved = np.einsum("nij,nj->ni", matrices, np.nan_to_num(coordinates[:, :3]))
    changed[:, :3] = np.where(needs.any(axis=2), np.nan, moved)
    return changed
