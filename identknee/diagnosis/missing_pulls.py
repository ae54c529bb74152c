"""The force and moment that a model lacks, on the plateau, by flexion and direction of load."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from identknee.diagnosis.causes import explanation_of
from identknee.diagnosis.diagnose import Diagnosis, layout_of
from identknee.diagnosis.localisation import TrialLayout
from identknee.diagnosis.missing_wrench import MissingWrench, missing_wrench
from identknee.mechanics.pose import rotation_matrix
from identknee.runs.arrays import Array, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MissingPull:
    """What else would have to act on the tibia, on average over the trials of one kind.

    The part along the plateau: contact hides what presses on it.

    Attributes
    ----------
    flexion_deg, direction
        Of the trials, as on the map of misfit.
    n_trials
        How many of them have every coordinate.
    mean, covariance
        Anterior and lateral force at the tibial origin [N] and moment of internal rotation about
        the tibial axis [N mm], shape ``(3,)``, and of its errors, ``(3, 3)``.
    """

    flexion_deg: float
    direction: str
    n_trials: int
    mean: Array
    covariance: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", frozen(self.mean, 3, name="mean"))
        object.__setattr__(self, "covariance", frozen(self.covariance, 3, 3, name="covariance"))

    @property
    def sd(self) -> Array:
        """Of the errors of `mean`, shape ``(3,)``."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def p_value(self) -> float:
        """Probability that noise alone asks for as much."""
        square = float(self.mean @ np.linalg.solve(self.covariance, self.mean))
        return float(stats.chi2.sf(square, 3))


def wrench_of(found: Diagnosis) -> MissingWrench:
    """What the model without causes lacks in every trial, with the parameters of the explanation.

    Ligaments that were fitted without the cause have taken over what they can of it; those fitted
    beside it leave it to be seen.
    """
    base = found.base.fitted
    theta = explanation_of(found).fitted.theta[: base.model.parameters.n]
    return missing_wrench(base.compared, theta, found.noise)


def pulls_of(found: Diagnosis) -> tuple[MissingPull, ...]:
    """Its mean along the plateau by flexion and direction of load."""
    return missing_pulls(wrench_of(found), layout_of(found.laxity))


def missing_pulls(found: MissingWrench, layout: TrialLayout) -> tuple[MissingPull, ...]:
    """The mean of what is missing outside contact, for every flexion and direction with data."""
    turn = np.stack([_along_plateau(x) for x in found.poses])
    values = np.einsum("nij,nj->ni", turn, found.outside)
    covariances = turn @ found.outside_covariance @ turn.transpose(0, 2, 1)
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
