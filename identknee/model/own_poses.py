"""Predictions of tests whose measured poses are not known: the model's own take their place."""

from dataclasses import replace

import numpy as np

from identknee.mechanics.grood_suntay import pose_from_coordinates
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.arrays import Array

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the loads, one after the other


def at_own_poses(model: LaxityModel, theta: Array) -> LaxityModel:
    """The model with the poses that it takes itself at theta while the loads grow.

    Equilibria are followed from the poses of the model under a growing share of the loads. A trial
    that has no equilibrium under some share goes on from where it was.

    Parameters
    ----------
    model
        A model with poses; one whose paths begin in the scanned pose is given back as it is.
    theta
        Its parameters, shape ``(p,)``.
    """
    if model.poses is None:
        return model
    for share in SHARES:
        part = model.protocol.under(np.full(model.protocol.n, share))
        found = replace(model, protocol=part).predict(theta, derivatives=False)
        model = replace(model, poses=_moved(model.poses, found))
    return model


def _moved(poses: Array, prediction: Prediction) -> Array:
    """Poses between the measured frames, those of trials without equilibrium as they were."""
    found = prediction.is_converged[:, None]
    return np.where(
        found, pose_from_coordinates(np.where(found, prediction.coordinates, 0.0)), poses
    )
