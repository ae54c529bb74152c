"""Laxity under the contact law of the literature, between the vertices of triangle meshes."""

from functools import lru_cache

import numpy as np

from identknee.mechanics.grood_suntay import coordinates_from_pose
from identknee.mechanics.load_paths import LoadPaths
from identknee.mechanics.memory import CONVERGED, NO_EQUILIBRIUM
from identknee.mechanics.mesh_contact import MeshContact, mesh_contact
from identknee.mechanics.mesh_equilibrium import mesh_equilibria
from identknee.model.joint import joint_of, sheets_of
from identknee.model.prediction import Prediction
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome
from identknee.subject.knee import Knee


def predict_on_meshes(
    knee: Knee, paths: LoadPaths, poses: Array | None, ligaments: tuple[Array, Array], theta: Array
) -> Prediction:
    """The prediction of a model with ``contact="mesh"``, which has no derivatives.

    Parameters
    ----------
    knee, paths, poses
        Those of the model.
    ligaments
        Stiffness [N] and reference strain of each ligament, shape ``(m,)``.
    theta
        The parameters that they come from.
    """
    joint = joint_of(knee)
    start = joint.start if poses is None else poses
    found = mesh_equilibria(paths, start, _mesh_contact(knee), joint.lines, *ligaments)
    n = len(paths.trial_node)
    converged = np.array([x is Outcome.CONVERGED for x in found.outcomes])
    return Prediction(
        theta=np.array(theta, float),
        coordinates=np.where(converged[:, None], coordinates_from_pose(found.poses), np.nan),
        jacobian=None,
        pose_jacobian=None,
        codes=np.where(converged, CONVERGED, NO_EQUILIBRIUM),
        poses=found.poses,
        hessians=None,
        reached=np.ones(n),
        centres=np.zeros((n, 0, 7)),
        rims=None,
        node_poses=found.poses,
    )


@lru_cache(maxsize=4)
def _mesh_contact(knee: Knee) -> MeshContact:
    femur, tibia = sheets_of(knee)
    return mesh_contact(femur, tibia)
