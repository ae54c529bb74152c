"""Marginalised nuisances without parameters: zeros, single angles, surfaces, toe region."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from identknee.laxity.table import COORDINATES
from identknee.mechanics.contact_points import ContactPlaces
from identknee.mechanics.grood_suntay import coordinate_jacobian, coordinates_from_pose
from identknee.model.effects.toe_strain import toe_strain
from identknee.model.laxity_model import LaxityModel, trial_contacts
from identknee.model.nuisances import flexion
from identknee.model.prediction import Prediction
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry
from identknee.subject.knee import Knee
from identknee.subject.uncertainty import Uncertainty


@declared
class SurfaceBumps:
    """Gaussian bumps of one surface, whose random heights make it rough.

    Independent heights of variance 1 give every place of the surface a height of variance 1, and
    places that are a distance r apart a correlation of about ``exp(-r^2 / (4 length^2))``.
    """

    centres: Array = array(
        "Centres of the bumps in the axes of the bone", "bump", "axis", unit="mm"
    )
    length: float = entry("Length of a bump [mm]")

    def heights(self, places: Array) -> Array:
        """How high each bump of height 1 is at places (n, 3) [mm] of its surface, ``(n, k)``."""
        at = places @ self.centres.T
        at -= 0.5 * (self.centres**2).sum(axis=1)
        # Only differences between bumps count where their heights are normed.
        at -= at.max(axis=1, keepdims=True)
        bumps = np.exp(at / self.length**2)
        return np.asarray(bumps / np.linalg.norm(bumps, axis=1, keepdims=True))

    def rises(self, heights: Array, moves: Array) -> Array:
        """Derivatives of the bumps' `heights` (n, k) by moving the n places.

        Parameters
        ----------
        heights
            At the places.
        moves
            Along which each place is moved, m in turn [mm], shape ``(n, m, 3)``.

        Returns
        -------
        rises
            To first order, shape ``(m, k)``.
        """
        # Normed heights change by what is left of the bumps' own change across them.
        middle = heights**2 @ self.centres
        along = np.einsum("mik,ki->mk", moves.transpose(1, 2, 0) @ heights, self.centres)
        left = np.einsum("nmi,ni->mn", moves, middle) @ heights
        return np.asarray((along - left) / self.length**2)


def surface_bumps(
    contacts: Sequence[ContactPlaces], tibial: Array, length: float
) -> tuple[SurfaceBumps, SurfaceBumps]:
    """Bumps of tibia and femur, in their axes, wherever they touch.

    Parameters
    ----------
    contacts
        The contact of every trial.
    tibial
        All contact points in tibial axes [mm], shape ``(n, 3)``.
    length
        Length of a bump [mm].
    """
    touched = np.unique(np.concatenate([x.index for x in contacts]))
    femoral = np.concatenate([x.femoral for x in contacts])
    return (
        SurfaceBumps(centres=_apart(tibial[touched], length), length=length),
        SurfaceBumps(centres=_apart(femoral, length), length=length),
    )


def surface_changes(model: LaxityModel, prediction: Prediction, length: float) -> Array:
    """Derivatives of what is measured by the heights of all bumps, shape ``(n, 5, k)``.

    Bumps lie on tibia and femur wherever they touch in any trial, and raise the surface. In mm and
    deg per mm; independent heights of standard deviation s stand for surfaces whose height is off
    by s. NaN in trials that did not converge.

    Raises
    ------
    ValueError
        If the prediction is one of mesh contact, which has no Hessians.
    """
    if prediction.hessians is None:
        raise ValueError('surface roughness needs a prediction with contact="field"')
    contacts = trial_contacts(model, prediction)
    tibial = model.joint.contact.points
    bumps = surface_bumps(contacts, tibial, length)
    moved = np.stack([_gradient_columns(x, tibial[x.index], *bumps) for x in contacts])
    converged = prediction.is_converged
    hessians = np.where(converged[:, None, None], prediction.hessians, np.eye(5))
    poses = -np.linalg.solve(hessians, moved)
    seen, _ = model.extension.observed_slopes(
        coordinates_from_pose(prediction.poses), model.amplitudes(prediction.theta), model.tests
    )
    columns: Array = seen @ coordinate_jacobian(prediction.poses) @ poses
    columns[~converged] = np.nan
    return columns


def _gradient_columns(
    contact: ContactPlaces, tibial: Array, on_tibia: SurfaceBumps, on_femur: SurfaceBumps
) -> Array:
    """Derivatives of the energy's gradient by the heights at a fixed pose, shape ``(5, k)``."""
    # A bump deepens the contact; one on the femur also pushes the tibia down its slope.
    of_femur = on_femur.heights(contact.femoral)
    heights = np.hstack([on_tibia.heights(tibial), of_femur])
    columns = (contact.stiffness[:, None] * contact.deepening).T @ heights
    pushes = contact.force[:, None, None] * contact.jacobian
    columns[:, len(on_tibia.centres) :] += on_femur.rises(of_femur, pushes)
    return np.asarray(columns)


def _apart(places: Array, length: float) -> Array:
    """Places of which no two are closer than a bump is long, and to one of which each is."""
    tree = cKDTree(places)
    is_free = np.ones(len(places), bool)
    chosen = []
    for i in range(len(places)):
        if is_free[i]:
            chosen.append(i)
            is_free[tree.query_ball_point(places[i], length)] = False
    return np.asarray(places[chosen])


# mm; the offset of a cartilage sheet is the same within about this distance.
SURFACE_LENGTH = 10.0
ROUGHNESS_LENGTH = 3.0  # mm, of a bump of a rough surface
# mm; how far the surfaces of a model are from those of the knee, bump by bump: where they are given
# by a formula only their sampling is rough, a mesh has also been segmented and smoothed.
FORMULA_ROUGHNESS, MESH_ROUGHNESS = 0.01, 0.02
TOE = 0.15  # %; how well any formula of the toe region describes ligaments


def nuisance_changes(model: LaxityModel, theta: Array) -> tuple[Array, Array]:
    """Derivatives of all coordinates by nuisances, and their prior standard deviations.

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
    heights = np.full(rough.shape[2], surface_roughness(model.knee))
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


def surface_roughness(knee: Knee) -> float:
    """How far the surfaces of a model are from those of the knee [mm], bump by bump."""
    return MESH_ROUGHNESS if knee.femur_distance is None else FORMULA_ROUGHNESS


def has_shared_errors(uncertainty: Uncertainty) -> bool:
    """Whether a knee states errors that are marginalised without parameters."""
    x = uncertainty
    return max(x.zero_mm, x.zero_deg, x.trial_flexion_deg, x.surface_mm) > 0.0


def shared_errors(model: LaxityModel, theta: Array) -> Array:
    """Change of the coordinates by errors of one standard deviation, shape ``(n, 5, k)``.

    An offset of each coordinate for every angle of flexion, an error of flexion for every trial,
    and smooth offsets of the cartilage sheets, as far as the knee states them. The two last are
    linear at `theta`; NaN in trials that have no equilibrium there.
    """
    stated = model.knee.uncertainty
    sizes = [stated.zero_deg if x.endswith("_deg") else stated.zero_mm for x in COORDINATES]
    angles, group = np.unique(model.protocol.flexion_deg, return_inverse=True)
    columns = np.zeros((model.protocol.n, len(COORDINATES), len(angles), len(COORDINATES)))
    for trial, place in enumerate(group):
        columns[trial, :, place, :] = np.diag(sizes)
    flat = columns.reshape(*columns.shape[:2], -1)
    parts = [flat[:, :, np.tile(np.array(sizes) > 0.0, len(angles))]]
    if stated.trial_flexion_deg > 0.0:
        offset = flexion(stated.trial_flexion_deg)
        others = [x for x in model.effects if x.name != offset.name]
        extended = model.with_effects([*others, offset])
        known = dict(zip(model.parameters.names, theta, strict=True))
        here = np.array([known.get(name, 0.0) for name in extended.parameters.names])
        jacobian = extended.predict(here).jacobian
        if jacobian is None:  # pragma: no cover - it was asked for
            raise AssertionError
        slopes = stated.trial_flexion_deg * jacobian[:, :, -1]
        parts.append(np.asarray(np.eye(len(slopes))[:, None, :] * slopes[:, :, None]))
    if stated.surface_mm > 0.0:
        changes = surface_changes(model, model.predict(theta), SURFACE_LENGTH)
        parts.append(stated.surface_mm * changes)
    return np.concatenate(parts, axis=2)
