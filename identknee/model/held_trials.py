"""Trials without equilibrium: the knee held near its measured pose by a spring.

Residuals of such a trial are those of the held pose. They are smooth in the parameters, with exact
derivatives, and a search that lowers them leads to where the knee holds the pose by itself. A
further residual, larger than any that an equilibrium can have, says that it does not: to gain an
equilibrium always pays.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from identknee.laxity.table import Laxity
from identknee.mechanics.equilibria import NEAR
from identknee.mechanics.memory import BEGINNINGS, HOLDS, ROTATION_SCALE
from identknee.model.laxity_model import LaxityModel
from identknee.model.mechanics_inputs import holding_poses
from identknee.runs.arrays import Array

# Size of what an equilibrium may differ by from where it is looked for [mm, deg].
LEVELS = np.unique(np.r_[HOLDS, BEGINNINGS])[::-1]
STEP = 0.005
FARTHEST = np.array([NEAR] * 3 + [np.degrees(NEAR / ROTATION_SCALE)] * 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldTrials:
    """The trials of a model, each held near its measured pose.

    Attributes
    ----------
    model
        The model of the trials.
    laxity
        Their measured poses. What was not measured is that of the trial nearest in flexion, or of
        the scanned pose.
    held_model
        The model, each trial held near its measured pose where it has no equilibrium.
    """

    model: LaxityModel
    laxity: Laxity
    held_model: LaxityModel = field(init=False, repr=False)

    def __post_init__(self) -> None:
        held = self.model
        if not held.paths.is_released:
            poses = holding_poses(held.joint.start, self.laxity)
            held = replace(held, poses=poses, fallback_poses=None)
        object.__setattr__(self, "held_model", held)

    def predict(self, theta: Array) -> tuple[Array, Array, Array]:
        """Poses of the trials, each held as far as it takes, and how much is lacking.

        Parameters
        ----------
        theta
            Parameters, shape ``(p,)``.

        Returns
        -------
        coordinates, jacobian
            Of the held pose [mm, deg], shape ``(n, 5)``, and its derivatives by theta,
            ``(n, 5, p)``.
        lack
            1 where the softest spring holds the knee, one more for each stiffer one that it takes,
            shape ``(n,)``.
        """
        found = self.held_model.predict_once(theta)
        is_held = found.released > 0.0
        stiffer = np.searchsorted(-LEVELS, -found.released)
        # Nothing holds it: it is as if it stood where it is held, whatever the parameters are.
        coordinates = np.where(is_held[:, None], found.held_coordinates, self.laxity.coordinates)
        if found.held_jacobian is None:  # pragma: no cover - it was asked for
            raise AssertionError
        jacobian = np.where(is_held[:, None, None], found.held_jacobian, 0.0)
        return coordinates, jacobian, 1.0 + STEP * np.where(is_held, stiffer, LEVELS.size)
