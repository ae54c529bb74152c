"""Contact force of the medial and the lateral compartment and its centre, with derivatives."""

from collections.abc import Sequence

import numpy as np

from identknee.mechanics.compartment_loads import CompartmentLoads, compartment_loads
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.equilibria import ContactPoints
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


def contact_jacobian(model: LaxityModel, prediction: Prediction, trials: Sequence[int]) -> Array:
    """Exact derivatives of `contact_values` by theta in some trials, shape ``(k, 2, 4, p)``.

    Parameters of ligaments change the contact by moving the tibia alone; the flexion, measured
    frames and the contact law also at a fixed pose. NaN in trials that did not converge.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives.
    """
    if prediction.pose_jacobian is None:
        raise ValueError("contact has derivatives only where the prediction has them")
    theta = prediction.theta
    jacobian = np.full((len(trials), len(COMPARTMENTS), len(KINDS), theta.size), np.nan)
    if model.parts:
        for part in model.parts:
            place = {int(x): i for i, x in enumerate(part.trials)}
            rows = [i for i, x in enumerate(trials) if x in place]
            if rows:
                own = [place[trials[i]] for i in rows]
                found = contact_jacobian(part.model, part.prediction(prediction), own)
                part.spread(found, jacobian, np.array(rows))
        return jacobian
    amplitudes = model.amplitudes(theta)
    settings = model.extension.changes(model.setting(theta, is_changed=False), amplitudes)
    contact, field = model.surfaces(settings[-1])
    # Each with the field of its surfaces, which all trials share.
    pairs = [
        (k, step, [(x, *model.surfaces(x)) for x in (low, high)])
        for k, step, low, high in model.extension.contact_pairs(settings, amplitudes)
    ]
    for row, trial in enumerate(trials):
        if not prediction.is_converged[trial]:
            continue
        node, pose = int(model.paths.trial_node[trial]), prediction.poses[trial]
        flexion = float(settings[-1].flexion[node])
        loads = compartment_loads(contact, field, flexion, pose, model.joint.contact.points)
        jacobian[row] = loads.by_pose @ prediction.pose_jacobian[trial]
        if pairs:
            made = [_change(loads, step, x, node, pose) for _, step, x in pairs]
            changes = loads.derivatives(
                np.stack([x for x, _ in made], axis=2), np.stack([x for _, x in made], axis=1)
            )
            columns = [model.n_ligament_parameters + k for k, _, _ in pairs]
            jacobian[row, :, :, columns] += np.moveaxis(changes, 2, 0)
    return jacobian


Surfaces = tuple[MechanicsInputs, ContactPoints, DistanceField]


def _change(
    found: CompartmentLoads, step: float, ends: Sequence[Surfaces], node: int, pose: Array
) -> tuple[Array, Array]:
    """How the points that touch move, and their force at the same depth changes, by an amplitude.

    Parameters
    ----------
    found
        The contact.
    step
        Difference of the amplitude.
    ends
        Inputs and surfaces with it a little smaller and larger.
    node, pose
        Flexion angle and pose of the trial.
    """
    touching, places, forces = found.touching, [], []
    placed = {x: place(x, pose) for x in {float(one.flexion[node]) for one, _, _ in ends}}
    for setting, contact, field in ends:
        on_femur = placed[float(setting.flexion[node])].to_femur(contact.points[touching.index])
        places.append(field.to_field(on_femur))
        forces.append(found.force_under(setting.law))
    return (places[1] - places[0]) / step, (forces[1] - forces[0]) / step
