"""Contact force of the medial and the lateral compartment and its centre, with derivatives."""

import numpy as np

from identknee.mechanics.compartment_loads import CompartmentLoads, compartment_loads
from identknee.mechanics.pose import place
from identknee.model.laxity_model import LaxityModel
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.model.prediction import Prediction
from identknee.runs.arrays import Array

# In the order of the tibial surfaces of a knee.
COMPARTMENTS = ("medial", "lateral")
# What there is of each: the force, and where it acts in the tibia's frame.
KINDS = ("N", "x_mm", "y_mm", "z_mm")


def contact_values(prediction: Prediction) -> Array:
    """Contact force [N] and centre [mm] of each compartment and trial, ``(n, 2, 4)``.

    The force is the sum of the forces of all contact elements of the tibial surface, each along its
    own normal; the centre is the mean of their places, weighted by force, in the frame of the
    tibia's geometry: x anterior, y superior, z lateral. NaN in trials that did not converge, and
    for the centre where a compartment does not touch.
    """
    values = np.array(prediction.centres[:, :, : len(KINDS)])
    values[values[:, :, 0] == 0.0, 1:] = np.nan
    values[~prediction.is_converged] = np.nan
    return values


def contact_jacobian(model: LaxityModel, prediction: Prediction, trial: int) -> Array:
    """Exact derivatives of `contact_values` by theta in one trial, shape ``(2, 4, p)``.

    Parameters of ligaments change the contact by moving the tibia alone; the flexion, measured
    frames and the contact law also at a fixed pose. NaN if the trial did not converge.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives.
    """
    if prediction.pose_jacobian is None:
        raise ValueError("contact has derivatives only where the prediction has them")
    theta = prediction.theta
    if not prediction.is_converged[trial]:
        return np.full((len(COMPARTMENTS), len(KINDS), theta.size), np.nan)
    if model.parts:
        part = next(x for x in model.parts if trial in x.trials)
        place = int(np.flatnonzero(part.trials == trial)[0])
        whole = np.zeros((len(COMPARTMENTS), len(KINDS), theta.size))
        own = part.prediction(prediction)
        whole[:, :, part.columns] = contact_jacobian(part.model, own, place)
        return whole
    settings = model.extension.changes(
        model.setting(theta, is_changed=False), model.amplitudes(theta)
    )
    node, pose = model.paths.trial_node[trial], prediction.poses[trial]
    contact, field = model.surfaces(settings[-1])
    flexion, places = float(settings[-1].flexion[node]), model.joint.contact.points
    found = compartment_loads(contact, field, flexion, pose, places)
    jacobian: Array = found.by_pose @ prediction.pose_jacobian[trial]
    pairs = model.extension.contact_pairs(settings, model.amplitudes(theta))
    for k, step, low, high in pairs:
        (before, less), (after, more) = (
            _moved(model, found, x, int(node), pose) for x in (low, high)
        )
        changes = found.derivatives(
            (after - before)[:, :, None] / step, (more - less)[:, None] / step
        )
        jacobian[:, :, model.n_ligament_parameters + k] += changes[:, :, 0]
    return jacobian


def _moved(
    model: LaxityModel, found: CompartmentLoads, setting: MechanicsInputs, node: int, pose: Array
) -> tuple[Array, Array]:
    """Where the points that touch lie under other inputs, and their force were they as deep."""
    contact, field = model.surfaces(setting)
    touching = found.touching
    placed = place(float(setting.flexion[node]), pose)
    places = field.to_field(placed.to_femur(contact.points[touching.index]))
    return places, found.force_under(setting.law)
