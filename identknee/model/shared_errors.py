"""Errors that many measured values share and no parameter stands for: zeros, angles, surfaces."""

import numpy as np

from identknee.laxity.table import COORDINATES
from identknee.model.laxity_model import LaxityModel
from identknee.model.nuisances.loading import flexion
from identknee.model.surface_errors import surface_changes
from identknee.runs.arrays import Array
from identknee.subject.uncertainty import Uncertainty

# mm; the offset of a cartilage sheet is the same within about this distance.
SURFACE_LENGTH = 10.0


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
