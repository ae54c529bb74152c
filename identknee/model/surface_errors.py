"""Errors of the cartilage surfaces: smooth random offsets, and what they change in readings."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from identknee.mechanics.contact_places import ContactPlaces
from identknee.mechanics.grood_suntay import coordinate_jacobian, coordinates_from_pose
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.trial_contacts import trial_contacts
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry


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
        """How each bump's `heights` (n, k) at n places grow in all, as these are moved.

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
    kept: Array = places[chosen]
    return kept
