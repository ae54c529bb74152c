"""Lines of action that a cause outside the library may have, and what each would do."""

from dataclasses import dataclass, replace

import numpy as np

from identknee.mechanics.equilibria import Lines
from identknee.mechanics.grood_suntay import coordinate_jacobian, coordinates_from_pose
from identknee.mechanics.ligament_tensions import ligament_tensions
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.setting import PER_KN, PER_PCT
from identknee.runs.arrays import Array, BoolArray, frozen
from identknee.subject.insertion_surfaces import insertion_surfaces
from identknee.subject.knee import Knee

LENGTHS = (12.0, 90.0)  # mm
MOST_LINES = 3000
SLACK_STRAINS = (-4.0, 0.0, 4.0, 8.0)  # %


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidateLines:
    """Lines between femur and tibia.

    Attributes
    ----------
    femur, tibia
        Their ends in the common frame of the scanned pose [mm], shape ``(m, 3)``.
    """

    femur: Array
    tibia: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "femur", frozen(self.femur, None, 3, name="femur"))
        object.__setattr__(self, "tibia", frozen(self.tibia, self.n, 3, name="tibia"))

    @property
    def n(self) -> int:
        """How many there are."""
        return len(self.femur)

    @property
    def directions(self) -> Array:
        """Unit vectors from tibia to femur, shape ``(m, 3)``."""
        along = self.femur - self.tibia
        return np.asarray(along / np.linalg.norm(along, axis=1, keepdims=True))

    def close_to(self, line: int, distance: float) -> BoolArray:
        """Which lines have both ends closer to the `line` than a distance [mm], shape ``(m,)``.

        The line goes on beyond its own ends: how far along it a force acts makes no difference.
        """
        along = self.directions[line]
        is_close = np.ones(self.n, bool)
        for ends in (self.femur, self.tibia):
            away = ends - self.femur[line]
            away = away - (away @ along)[:, None] * along
            is_close &= np.linalg.norm(away, axis=1) < distance
        return is_close


def candidate_lines(knee: Knee, *, seed: int = 0) -> CandidateLines:
    """Lines between places of both bones that lie on one side, 12 to 90 mm apart.

    Central places go with either side. Where there are more than 3,000, some are taken at random.

    Raises
    ------
    ValueError
        If the femoral surface has no posterior condyle on one side.
    """
    femur, tibia = insertion_surfaces(knee)
    length = np.linalg.norm(femur.positions[:, None] - tibia.positions, axis=2)
    on_femur, on_tibia = np.array(femur.sides)[:, None], np.array(tibia.sides)
    fits = (on_femur == on_tibia) | (on_femur == "central") | (on_tibia == "central")
    fits &= (length > LENGTHS[0]) & (length < LENGTHS[1])
    pairs = np.argwhere(fits)
    chosen = np.random.default_rng(seed).permutation(len(pairs))[:MOST_LINES]
    at_femur, at_tibia = pairs[np.sort(chosen)].T
    return CandidateLines(femur=femur.positions[at_femur], tibia=tibia.positions[at_tibia])


def line_columns(model: LaxityModel, prediction: Prediction, lines: CandidateLines) -> Array:
    """What each line of 1 kN would change of the measured coordinates, at every slack strain.

    To first order, shape ``(n, 5, len(SLACK_STRAINS), m)`` [mm, deg per kN]; NaN in trials that did
    not converge.

    Raises
    ------
    ValueError
        If the prediction is one of mesh contact, which has no Hessians.
    """
    if prediction.hessians is None:
        raise ValueError('lines of action need a prediction with contact="field"')
    setting = model.setting(prediction.theta)
    flexion = setting.flexion[model.paths.trial_node]
    unmeasured = Lines(
        femoral=model.knee.femur_frame.to_local(lines.femur),
        tibial=model.knee.tibia_frame.to_local(lines.tibia),
        reference_length=np.ones(lines.n),
    )
    measured = replace(unmeasured, reference_length=setting.lengths_at_start(unmeasured))
    converged = prediction.is_converged
    hessians = np.where(converged[:, None, None], prediction.hessians, np.eye(5))
    seen, _ = model.extension.observed_slopes(
        coordinates_from_pose(prediction.poses), model.amplitudes(prediction.theta), model.tests
    )
    compliance = seen @ coordinate_jacobian(prediction.poses) @ np.linalg.inv(hessians)
    stiffness = np.full(lines.n, PER_KN)
    columns = np.empty((len(flexion), 5, len(SLACK_STRAINS), lines.n))
    for k, strain in enumerate(SLACK_STRAINS):
        pulled = ligament_tensions(
            measured, flexion, prediction.poses, stiffness, np.full(lines.n, PER_PCT * strain)
        )
        pulls = pulled.tensions[:, :, None] * pulled.lengthening
        columns[:, :, k] = -compliance @ pulls.transpose(0, 2, 1)
    columns[~converged] = np.nan
    return columns
