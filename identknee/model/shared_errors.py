"""Errors that no parameter stands for and nobody wants named: zeros, angles, surfaces, the toe."""

import numpy as np

from identknee.laxity.table import COORDINATES
from identknee.model.effects.toe_strain import toe_strain
from identknee.model.laxity_model import LaxityModel
from identknee.model.nuisances.loading import flexion
from identknee.model.surface_errors import surface_changes
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee
from identknee.subject.uncertainty import Uncertainty

# mm; the offset of a cartilage sheet is the same within about this distance.
SURFACE_LENGTH = 10.0
ROUGHNESS_LENGTH = 3.0  # mm, of a bump of a rough surface
# mm; how far the surfaces of a model are from those of the knee, bump by bump: where they are given
# by a formula only their sampling is rough, a mesh has also been segmented and smoothed.
FORMULA_ROUGHNESS, MESH_ROUGHNESS = 0.01, 0.02
TOE = 0.15  # %; how well any formula of the toe region describes ligaments


def nuisance_changes(model: LaxityModel, theta: Array) -> tuple[Array, Array]:
    """What nuisances change in the coordinates of all trials, and their prior spreads.

    Rough surfaces, a force-strain curve whose toe is not quite the one of the equations, unless
    that is one of the model's effects, and the shared errors that the knee states.

    Returns
    -------
    changes
        For a nuisance of 1, shape ``(n, 5, k)``; NaN in trials that did not converge.
    spreads
        Prior standard deviation of each, shape ``(k,)``.
    """
    rough = surface_changes(model, model.predict_once(theta), ROUGHNESS_LENGTH)
    heights = np.full(rough.shape[2], roughness_of(model.knee))
    changes, spreads = [rough], [heights]
    toe = toe_strain()
    if toe.name not in {x.name for x in model.effects}:
        found = model.with_effects([*model.effects, toe]).predict(np.r_[theta, 0.0])
        if found.jacobian is None:  # pragma: no cover - it was asked for
            raise AssertionError
        changes.append(found.jacobian[:, :, -1:])
        spreads.append(np.array([TOE]))
    if has_shared_errors(model.knee.uncertainty):
        shared = shared_errors(model, theta)
        changes.append(shared)
        spreads.append(np.ones(shared.shape[2]))
    return np.concatenate(changes, axis=2), np.concatenate(spreads)


def roughness_of(knee: Knee) -> float:
    """How far the surfaces of a model are from those of the knee [mm], bump by bump."""
    return MESH_ROUGHNESS if knee.femur_distance is None else FORMULA_ROUGHNESS


def has_shared_errors(uncertainty: Uncertainty) -> bool:
    """Whether a knee states errors that are averaged over and have no parameters."""
    x = uncertainty
    return max(x.zero_mm, x.zero_deg, x.trial_flexion_deg, x.surface_mm) > 0.0


def shared_errors(model: LaxityModel, theta: Array) -> Array:
    """What errors of one standard deviation change in the coordinates, shape ``(n, 5, k)``.

    An offset of each coordinate for every angle of flexion, an error of flexion for every trial,
    and smooth offsets of the cartilage sheets, as far as the knee states them. The two last are
    linear at `theta`; NaN in trials that have no equilibrium there.
    """
    stated = model.knee.uncertainty
    parts = [_zeros(model, stated.zero_mm, stated.zero_deg)]
    if stated.trial_flexion_deg > 0.0:
        parts.append(_flexions(model, theta, stated.trial_flexion_deg))
    if stated.surface_mm > 0.0:
        changes = surface_changes(model, model.predict(theta), SURFACE_LENGTH)
        parts.append(stated.surface_mm * changes)
    return np.concatenate(parts, axis=2)


def _zeros(model: LaxityModel, sd_mm: float, sd_deg: float) -> Array:
    sizes = [sd_deg if name.endswith("_deg") else sd_mm for name in COORDINATES]
    angles, group = np.unique(model.protocol.flexion_deg, return_inverse=True)
    columns = np.zeros((model.protocol.n, len(COORDINATES), len(angles), len(COORDINATES)))
    for trial, place in enumerate(group):
        columns[trial, :, place, :] = np.diag(sizes)
    flat = columns.reshape(*columns.shape[:2], -1)
    return flat[:, :, np.tile(np.array(sizes) > 0.0, len(angles))]


def _flexions(model: LaxityModel, theta: Array, sd_deg: float) -> Array:
    offset = flexion(sd_deg)
    extended = model.with_effects([*(x for x in model.effects if x.name != offset.name), offset])
    names = extended.parameters.names
    values = dict(zip(model.parameters.names, theta, strict=True))
    here = np.array([values.get(name, 0.0) for name in names])
    jacobian = extended.predict(here).jacobian
    if jacobian is None:  # pragma: no cover - it was asked for
        raise AssertionError
    slopes = sd_deg * jacobian[:, :, -1]
    return np.asarray(np.eye(len(slopes))[:, None, :] * slopes[:, :, None])
