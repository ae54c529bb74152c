"""Forces and moments that a model lacks where the knee was measured, with their errors."""

from dataclasses import replace

import numpy as np

from identknee.laxity.table import Laxity
from identknee.mechanics.contact_points import ContactPlaces
from identknee.mechanics.ligament_tensions import ligament_tensions
from identknee.mechanics.pose import coordinate_jacobian, rotation_matrix
from identknee.model.laxity_model import (
    LaxityModel,
    contact_of_trials,
    menisci_of_trials,
    observed_slopes,
    trial_contacts,
)
from identknee.model.mechanics_inputs import holding_poses
from identknee.model.prediction import Prediction
from identknee.model.residuals import HeldTrials, LaxityResiduals
from identknee.runs.declare import Array, BoolArray, IntArray, array, declared, entry

# Steps of the central differences for the stiffness at a measured pose [rad, mm].
STEPS = np.array([1e-5, 1e-5, 1e-4, 1e-4, 1e-4])

LEVER = 20.0  # lever over which a moment is compared with a force [mm]
SCALE = np.array([LEVER, LEVER, 1.0, 1.0, 1.0])


@declared
class MissingWrench:
    """Generalised forces that are missing in n trials: of varus, internal [N mm], x, y, z [N].

    They carry the information of the residuals, as forces. Contact is so stiff that noise alone
    demands hundreds of newtons along its normals, so only the part outside these directions is
    worth showing. NaN in trials that lack a measured coordinate or did not converge.
    """

    wrench: Array = array("Missing forces of each trial", "trial", "5")
    covariance: Array = array("Covariance of their errors", "trial", "5", "5")
    outside: Array = array(
        "The part outside the directions in which contact presses; moments are compared with "
        "forces over a lever of 20 mm",
        "trial",
        "5",
    )
    outside_covariance: Array = array("Covariance of its errors", "trial", "5", "5")
    poses: Array = array(
        "Pose of each trial at which it is missing: varus, internal [rad], x, y, z [mm]",
        *("trial", "5"),
    )


def missing_wrench(
    problem: LaxityResiduals, theta: Array, sd: Array, correlation: float
) -> MissingWrench:
    """The wrench that is missing in every trial: the Hessian times the residual displacement.

    The Hessian is that at the predicted pose, where contact is well defined. For data counted from
    the unloaded pose it is the wrench beyond that missing in the unloaded trial.

    Parameters
    ----------
    problem
        The model and the data.
    theta
        Parameters, shape ``(p,)``.
    sd
        Standard deviation of each value, shape ``(n, 5)``.
    correlation
        Correlation of the errors within a trial.

    Raises
    ------
    ValueError
        If the contact is that of meshes.
    """
    model, laxity = problem.model, problem.laxity
    prediction = model.predict_once(theta)
    stiffness = np.asarray(np.linalg.inv(wrench_response(model, prediction)))
    is_whole = np.asarray(laxity.is_measured.all(axis=1) & prediction.is_converged)
    wrench = np.einsum("nij,nj->ni", stiffness, problem.differences(theta))
    compartment = model.joint.contact.compartment
    kept = [outside_contact(compartment, x) for x in trial_contacts(model, prediction)]
    made = _MadeOf(stiffness=stiffness, outside=np.stack(kept), sd=sd, correlation=correlation)
    return made.missing(is_whole, wrench, prediction.poses)


def wrench_response(model: LaxityModel, prediction: Prediction) -> Array:
    """Change of the coordinates of each trial with an additional wrench, ``(n, 5, 5)``.

    The generalised forces are those of `MissingWrench`. In trials that did not converge the Hessian
    counts as the identity.

    Raises
    ------
    ValueError
        If the contact is that of meshes.
    """
    if prediction.hessians is None:
        raise ValueError('a missing wrench needs a model with contact="field"')
    shape = prediction.is_converged[:, None, None]
    hessians = np.where(shape, prediction.hessians, np.eye(5))
    slopes = observed_slopes(model, prediction) @ coordinate_jacobian(prediction.poses)
    return np.asarray(slopes @ np.linalg.inv(hessians))


def wrench_at_measured_poses(
    model: LaxityModel, laxity: Laxity, theta: Array, sd: Array, correlation: float
) -> MissingWrench:
    """The wrench that is missing in every trial for equilibrium at its measured pose.

    It is the gradient of the energy at that pose, less the load. It is defined whether or not the
    model has an equilibrium, and differs from `missing_wrench` by second-order terms. A compartment
    that does not touch there is taken to press as it does where a spring holds the knee nearby.

    Parameters
    ----------
    model, laxity
        The model, and data with absolute coordinates.
    theta
        Parameters, shape ``(p,)``.
    sd, correlation
        As for `missing_wrench`.
    """
    held_model = HeldTrials(model=model, laxity=laxity).held_model
    held = held_model.predict_once(theta)
    at = replace(held, poses=holding_poses(model.joint.start, laxity))
    stiffness = np.empty((laxity.n, 5, 5))
    for j, step in enumerate(STEPS):
        shift = step * np.eye(5)[j]
        ahead, behind = (
            unbalanced_load(held_model, replace(at, poses=at.poses + x)) for x in (shift, -shift)
        )
        stiffness[:, :, j] = (ahead - behind) / (2.0 * step)
    by_reading = stiffness @ np.linalg.inv(
        observed_slopes(held_model, at) @ coordinate_jacobian(at.poses)
    )
    kept = [
        outside_contact(model.joint.contact.compartment, *places)
        for places in zip(
            trial_contacts(held_model, at), trial_contacts(held_model, held), strict=True
        )
    ]
    made = _MadeOf(stiffness=by_reading, outside=np.stack(kept), sd=sd, correlation=correlation)
    is_whole = np.asarray(laxity.is_measured.all(axis=1))
    return made.missing(is_whole, unbalanced_load(held_model, at), at.poses)


def unbalanced_load(model: LaxityModel, prediction: Prediction) -> Array:
    """Gradient of the energy less the load in the poses of a prediction, shape ``(n, 5)``.

    Zero in equilibrium; elsewhere the additional load on the tibia that would balance it [N mm, N].
    """
    if model.parts:
        whole = np.empty((len(prediction.codes), 5))
        for x in model.parts:
            whole[x.trials] = unbalanced_load(x.model, x.prediction(prediction))
        return whole
    setting, nodes = model.setting(prediction.theta), model.paths.trial_node
    ligaments = ligament_tensions(
        setting.measured_lines,
        setting.flexion[nodes],
        prediction.poses,
        setting.stiffness,
        setting.reference_strain,
    )
    pressed = sum(
        x(model, prediction).wrenches(len(prediction.codes))
        for x in (contact_of_trials, menisci_of_trials)
    )
    return np.asarray(ligaments.gradient + pressed - setting.loads[nodes])


@declared
class _MadeOf:
    """Matrices and noise that turn errors of readings into errors of a wrench."""

    stiffness: Array = array("Change of the wrench with the readings", "trial", "5", "5")
    outside: Array = array("Matrix that removes contact from a wrench", "trial", "5", "5")
    sd: Array = array("Standard deviation of the readings", "trial", "5")
    correlation: float = entry("Correlation of the errors within a trial")

    def missing(self, is_whole: BoolArray, wrench: Array, poses: Array) -> MissingWrench:
        """The wrench with its errors; NaN where a trial lacks a measured coordinate."""
        shared = np.full((5, 5), self.correlation)
        np.fill_diagonal(shared, 1.0)
        errors = self.sd[:, :, None] * shared * self.sd[:, None]
        covariance = self.stiffness @ errors @ self.stiffness.transpose(0, 2, 1)
        kept, row, shape = self.outside, is_whole[:, None], is_whole[:, None, None]
        return MissingWrench(
            wrench=np.where(row, wrench, np.nan),
            covariance=np.where(shape, covariance, np.nan),
            outside=np.where(row, np.einsum("nij,nj->ni", kept, wrench), np.nan),
            outside_covariance=np.where(shape, kept @ covariance @ kept.transpose(0, 2, 1), np.nan),
            poses=poses,
        )


def outside_contact(compartment: IntArray, *contacts: ContactPlaces) -> Array:
    """Matrix that removes the directions in which contact presses from a wrench, ``(5, 5)``.

    Parameters
    ----------
    compartment
        Compartment of each contact point.
    contacts
        Contact in one or several poses. The direction of a compartment is taken from the first pose
        in which it touches.
    """
    pressed: dict[int, Array] = {}
    for contact in contacts:
        touched = compartment[contact.index]
        for c in np.unique(touched).tolist():
            own = touched == c
            pressed.setdefault(c, contact.force[own] @ contact.deepening[own] / SCALE)
    if not pressed:
        return np.eye(5)
    normals, _ = np.linalg.qr(np.array([*pressed.values()]).T)
    kept: Array = (np.eye(5) - normals @ normals.T) * SCALE[:, None] / SCALE
    return kept


def along_plateau(pose: Array) -> Array:
    """Matrix to the anterior and lateral force and internal moment in tibial axes, ``(3, 5)``."""
    # Poses and forces are given in femoral axes turned with flexion, before varus and rotation.
    to_tibia = rotation_matrix(0.0, float(pose[0]), float(pose[1])).T
    rows = np.zeros((3, 5))
    rows[:2, 2:] = to_tibia[[0, 2]]
    rows[2, 1] = 1.0
    return rows
