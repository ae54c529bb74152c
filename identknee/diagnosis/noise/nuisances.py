"""What nobody wants named: errors of the surfaces and of the law of ligaments, as nuisances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from identknee.mechanics.contact_places import ContactPlaces
from identknee.mechanics.grood_suntay import coordinate_jacobian, coordinates_from_pose
from identknee.model.effects.toe_strain import toe_strain
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.trial_contacts import trial_contacts
from identknee.runs.arrays import Array, frozen
from identknee.subject.knee import Knee

LENGTH = 3.0  # mm, of a bump
# mm; how far the surfaces of a model are from those of the knee, bump by bump: where they are given
# by a formula only their sampling is rough, a mesh has also been segmented and smoothed.
FORMULA_ROUGHNESS, MESH_ROUGHNESS = 0.01, 0.02
TOE = 0.15  # %; how well any formula of the toe region describes ligaments


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfaceBumps:
    """Gaussian bumps of one surface, whose random heights make it rough.

    Independent heights of variance 1 give every place of the surface a height of variance 1, and
    places that are a distance r apart a correlation of about ``exp(-r^2 / (4 LENGTH^2))``.

    Attributes
    ----------
    centres
        [mm], shape ``(k, 3)``, in the axes of the bone.
    """

    centres: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "centres", frozen(self.centres, None, 3, name="centres"))

    def heights(self, places: Array) -> Array:
        """How high each bump of height 1 is at places (n, 3) [mm] of its surface, ``(n, k)``."""
        squares = ((places[:, None] - self.centres) ** 2).sum(axis=2)
        bumps = np.exp(-0.5 * squares / LENGTH**2)
        return np.asarray(bumps / np.linalg.norm(bumps, axis=1, keepdims=True))

    def slopes(self, places: Array) -> Array:
        """Gradients of `heights` by the places, shape ``(n, 3, k)``."""
        heights = self.heights(places)
        # Normed heights change by what is left of the bumps' own change across them.
        middle = heights**2 @ self.centres
        away = self.centres.T - middle[:, :, None]
        return np.asarray(heights[:, None] * away / LENGTH**2)


def surface_bumps(
    contacts: Sequence[ContactPlaces], tibial: Array
) -> tuple[SurfaceBumps, SurfaceBumps]:
    """Bumps of tibia and femur, in their axes, wherever they touch.

    Parameters
    ----------
    contacts
        The contact of every trial.
    tibial
        All contact points in tibial axes [mm], shape ``(n, 3)``.
    """
    touched = np.unique(np.concatenate([x.index for x in contacts]))
    femoral = np.concatenate([x.femoral for x in contacts])
    return SurfaceBumps(centres=_apart(tibial[touched])), SurfaceBumps(centres=_apart(femoral))


def nuisance_changes(model: LaxityModel, theta: Array) -> tuple[Array, Array]:
    """What nuisances change in the coordinates of all trials, and their prior spreads.

    Rough surfaces, and a force-strain curve whose toe is not quite the one of the equations, unless
    that is one of the model's effects.

    Returns
    -------
    changes
        For a nuisance of 1, shape ``(n, 5, k)``; NaN in trials that did not converge.
    spreads
        Prior standard deviation of each, shape ``(k,)``.
    """
    rough = roughness_columns(model, model.predict_once(theta))
    heights = np.full(rough.shape[2], roughness_of(model.knee))
    toe = toe_strain()
    if toe.name in {x.name for x in model.effects}:
        return rough, heights
    found = model.with_effects([*model.effects, toe]).predict(np.r_[theta, 0.0])
    if found.jacobian is None:  # pragma: no cover - it was asked for
        raise AssertionError
    return np.concatenate([rough, found.jacobian[:, :, -1:]], axis=2), np.r_[heights, TOE]


def roughness_of(knee: Knee) -> float:
    """How far the surfaces of a model are from those of the knee [mm], bump by bump."""
    return MESH_ROUGHNESS if knee.femur_distance is None else FORMULA_ROUGHNESS


def roughness_columns(model: LaxityModel, prediction: Prediction) -> Array:
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
    bumps = surface_bumps(contacts, tibial)
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
    heights = np.hstack([on_tibia.heights(tibial), on_femur.heights(contact.femoral)])
    columns = (contact.stiffness[:, None] * contact.deepening).T @ heights
    pushes = contact.force[:, None, None] * contact.jacobian
    slopes = on_femur.slopes(contact.femoral)
    columns[:, len(on_tibia.centres) :] += np.tensordot(pushes, slopes, axes=([0, 2], [0, 1]))
    return np.asarray(columns)


def _apart(places: Array) -> Array:
    """Places of which no two are closer than a bump is long, and to one of which each is."""
    tree = cKDTree(places)
    is_free = np.ones(len(places), bool)
    chosen = []
    for i in range(len(places)):
        if is_free[i]:
            chosen.append(i)
            is_free[tree.query_ball_point(places[i], LENGTH)] = False
    kept: Array = places[chosen]
    return kept
