"""The forces a model lacks: what else would have to act to hold the knee where it was measured."""

import numpy as np
from scipy import stats

from identknee.diagnosis.score.localisation import TrialLayout
from identknee.mechanics.contact_places import ContactPlaces
from identknee.mechanics.grood_suntay import coordinate_jacobian, coordinates_from_pose
from identknee.mechanics.pose import rotation_matrix
from identknee.model.residuals import LaxityResiduals
from identknee.model.trial_contacts import trial_contacts
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry

LEVER = 20.0  # mm, what a moment is divided by to be compared with a force
SCALE = np.array([LEVER, LEVER, 1.0, 1.0, 1.0])


@declared
class MissingWrench:
    """Generalised forces that are missing in n trials: of varus, internal [N mm], x, y, z [N].

    They hold no more than the residuals do, in newtons. Contact is so stiff that noise alone asks
    for hundreds of newtons along its normals: only what lies outside is fit to be shown. NaN in
    trials that lack a measured coordinate or did not converge.
    """

    wrench: Array = array("Missing forces of each trial", "trial", "5")
    covariance: Array = array("Covariance of their errors", "trial", "5", "5")
    outside: Array = array(
        "Their part outside the directions in which contact presses, moments compared with forces "
        "over a lever of 20 mm",
        "trial",
        "5",
    )
    outside_covariance: Array = array("Covariance of its errors", "trial", "5", "5")
    poses: Array = array(
        "Where the model predicts each trial: varus, internal [rad], x, y, z [mm]", "trial", "5"
    )


def missing_wrench(
    problem: LaxityResiduals, theta: Array, sd: Array, correlation: float
) -> MissingWrench:
    """What is missing in every trial: the Hessian times the way from the predicted pose.

    The Hessian is that of the predicted pose, where contact is well defined. For data counted from
    the unloaded pose it is what is missing beyond what is missing there.

    Parameters
    ----------
    problem
        The model and the data.
    theta
        Where, shape ``(p,)``.
    sd
        Standard deviation of each value, shape ``(n, 5)``.
    correlation
        What the errors of a trial share.

    Raises
    ------
    ValueError
        If the contact is that of meshes.
    """
    model, laxity = problem.model, problem.laxity
    prediction = model.predict_once(theta)
    if prediction.hessians is None:
        raise ValueError('a missing wrench needs a model with contact="field"')
    seen, _ = model.extension.observed_slopes(
        coordinates_from_pose(prediction.poses), model.amplitudes(theta), model.tests
    )
    is_whole = laxity.is_measured.all(axis=1) & prediction.is_converged
    shape = is_whole[:, None, None]
    hessians = np.where(shape, prediction.hessians, np.eye(5))
    stiffness = hessians @ np.linalg.inv(seen @ coordinate_jacobian(prediction.poses))
    shared = np.full((5, 5), correlation)
    np.fill_diagonal(shared, 1.0)
    errors = sd[:, :, None] * shared * sd[:, None]
    wrench = np.einsum("nij,nj->ni", stiffness, problem.differences(theta))
    covariance = stiffness @ errors @ stiffness.transpose(0, 2, 1)
    kept = np.stack(
        [
            _outside_contact(x, model.joint.contact.compartment)
            for x in trial_contacts(model, prediction)
        ]
    )
    return MissingWrench(
        wrench=np.where(is_whole[:, None], wrench, np.nan),
        covariance=np.where(shape, covariance, np.nan),
        outside=np.where(is_whole[:, None], np.einsum("nij,nj->ni", kept, wrench), np.nan),
        outside_covariance=np.where(shape, kept @ covariance @ kept.transpose(0, 2, 1), np.nan),
        poses=prediction.poses,
    )


def _outside_contact(contact: ContactPlaces, compartment: IntArray) -> Array:
    """What is left (5, 5) of a wrench without its parts along the forces of either contact."""
    touched = compartment[contact.index]
    pressed = [
        contact.force[touched == c] @ contact.deepening[touched == c] / SCALE
        for c in np.unique(touched)
    ]
    if not pressed:
        return np.eye(5)
    normals, _ = np.linalg.qr(np.array(pressed).T)
    kept: Array = (np.eye(5) - normals @ normals.T) * SCALE[:, None] / SCALE
    return kept


@declared
class MissingPull:
    """What else would have to act on the tibia, on average over the trials of one kind.

    The part along the plateau: contact hides what presses on it.
    """

    flexion_deg: float = entry("Flexion of the trials, as on the map of misfit")
    direction: str = entry("Direction of their load, as on the map of misfit")
    n_trials: int = entry("How many of them have every coordinate")
    mean: Array = array(
        "Anterior and lateral force at the tibial origin [N] and moment of internal rotation about "
        "the tibial axis [N mm]",
        "3",
    )
    covariance: Array = array("Covariance of its errors", "3", "3")

    @property
    def sd(self) -> Array:
        """Standard deviation of the errors of `mean`, shape ``(3,)``."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def p_value(self) -> float:
        """Probability that noise alone asks for as much."""
        square = float(self.mean @ np.linalg.solve(self.covariance, self.mean))
        return float(stats.chi2.sf(square, 3))


def missing_pulls(missing: MissingWrench, layout: TrialLayout) -> tuple[MissingPull, ...]:
    """The mean of what is missing outside contact, for every flexion and direction with data."""
    turn = np.stack([_along_plateau(x) for x in missing.poses])
    values = np.einsum("nij,nj->ni", turn, missing.outside)
    covariances = turn @ missing.outside_covariance @ turn.transpose(0, 2, 1)
    is_whole = np.isfinite(values).all(axis=1)
    pulls = []
    for flexion in np.unique(layout.flexion_deg):
        for direction, side in layout.sides().items():
            own = side & (layout.flexion_deg == flexion) & is_whole
            n = int(own.sum())
            if n:
                pulls.append(
                    MissingPull(
                        flexion_deg=float(flexion),
                        direction=direction,
                        n_trials=n,
                        mean=values[own].mean(axis=0),
                        covariance=covariances[own].sum(axis=0) / n**2,
                    )
                )
    return tuple(pulls)


def _along_plateau(pose: Array) -> Array:
    """Anterior and lateral force and internal moment in tibial axes, of a wrench, ``(3, 5)``."""
    # Both the pose and its forces are counted in the axes of the flexed tibia before it turns.
    to_tibia = rotation_matrix(0.0, float(pose[0]), float(pose[1])).T
    rows = np.zeros((3, 5))
    rows[:2, 2:] = to_tibia[[0, 2]]
    rows[2, 1] = 1.0
    return rows
