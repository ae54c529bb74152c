"""Lines of action that a cause outside the library may have, and how residuals speak for each."""

from dataclasses import replace

import numpy as np

from identknee.diagnosis.explanations.fitting import Fitted, weighed
from identknee.diagnosis.score.misfit import base_projector
from identknee.mechanics.equilibria import Lines
from identknee.mechanics.grood_suntay import coordinate_jacobian, coordinates_from_pose
from identknee.mechanics.ligament_tensions import ligament_tensions
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.setting import PER_KN, PER_PCT
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared, entry
from identknee.subject.insertion_surfaces import insertion_surfaces
from identknee.subject.knee import Knee

LENGTHS = (12.0, 90.0)  # mm
MOST_LINES = 3000
SLACK_STRAINS = (-4.0, 0.0, 4.0, 8.0)  # %
NAME = "missing_line"
STIFFNESS_SD = 1.5  # kN, of the half-normal prior
APART = 12.0  # mm
N_DRAWS = 1000
# A line of which less is left is explained by the fitted parameters.
LEAST_LEFT = 1e-6


@declared
class CandidateLines:
    """Lines between femur and tibia."""

    femur: Array = array(
        "Femoral ends in the common frame of the scanned pose", "line", "axis", unit="mm"
    )
    tibia: Array = array("Tibial ends, likewise", "line", "axis", unit="mm")

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
    measured = setting.as_measured(
        replace(unmeasured, reference_length=setting.lengths_at_start(unmeasured))
    )
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


@declared
class ScannedLine:
    """A line worth a refit."""

    femur: Array = entry("Femoral end in the common frame of the scanned pose [mm], shape ``(3,)``")
    tibia: Array = entry("Tibial end, likewise")
    amplitude: float = entry("Expected stiffness [kN]")
    strain_pct: float = entry("Slack strain at which it explains most [%]")
    score: float = entry("Root of the expected fall of the objective")


@declared
class LineScan:
    """Scores of all lines in one linearisation of a model."""

    lines: CandidateLines = entry("All m lines")
    scores: Array = array(
        "Root of the expected fall of the objective; 0 where a line would have to push",
        *("slack_strain", "line"),
    )
    amplitudes: Array = array("Expected stiffness", "slack_strain", "line", unit="kN")
    signatures: Array = entry(
        "What is left of each line's effect after all that the parameters explain, in units of the "
        "noise and so long that its product with the residuals is the score, shape "
        "``(rows, strains, m)``"
    )

    def best(self, number: int) -> tuple[ScannedLine, ...]:
        """The lines of the highest scores, no two of them close to each other."""
        highest, strain = self.scores.max(axis=0), self.scores.argmax(axis=0)
        found: list[ScannedLine] = []
        is_free = highest > 0.0
        while is_free.any() and len(found) < number:
            line = int(np.argmax(np.where(is_free, highest, 0.0)))
            found.append(
                ScannedLine(
                    femur=self.lines.femur[line],
                    tibia=self.lines.tibia[line],
                    amplitude=float(self.amplitudes[strain[line], line]),
                    strain_pct=SLACK_STRAINS[strain[line]],
                    score=float(highest[line]),
                )
            )
            is_free &= ~self.lines.close_to(line, APART)
        return tuple(found)

    def p_value(self, seed: int) -> float:
        """Probability that noise alone gives some line a score as high as the highest."""
        draws = np.random.default_rng(seed).standard_normal((N_DRAWS, len(self.signatures)))
        highest = np.zeros(N_DRAWS)
        for strain in range(len(SLACK_STRAINS)):
            np.maximum(highest, (draws @ self.signatures[:, strain]).max(axis=1), out=highest)
        return float((1 + np.count_nonzero(highest >= self.scores.max())) / (1 + N_DRAWS))


def scan_lines(fitted: Fitted, theta: Array, lines: CandidateLines) -> LineScan | None:
    """Scores of lines of action where a model is linearised at `theta`.

    Theta need not be the best fit: what a change of it could explain is taken out. If the model
    has a missing line already, the scan is for what might take its place. None where the model has
    no prediction at theta.

    Parameters
    ----------
    fitted
        The model, the data and their noise.
    theta
        Where, shape ``(p,)``.
    lines
        The lines to score.
    """
    problem = weighed(fitted.model, fitted.laxity, fitted.noise)
    residuals = -problem.residuals(theta)
    if not np.isfinite(residuals).all():
        return None
    residuals, jacobian = _without_line(fitted, theta, residuals, problem.jacobian(theta))
    changes = line_columns(fitted.model, fitted.model.predict_once(theta), lines)
    signatures = fitted.columns(changes.reshape(*changes.shape[:2], -1))
    projector = base_projector(jacobian)
    left = projector.project(signatures)
    square = (left**2).sum(axis=0)
    is_seen = square > LEAST_LEFT**2 * (signatures**2).sum(axis=0)
    precision = square + STIFFNESS_SD**-2.0
    left *= is_seen / np.sqrt(precision)
    scores = np.maximum(projector.project(residuals) @ left, 0.0)
    shape = (len(SLACK_STRAINS), lines.n)
    return LineScan(
        lines=lines,
        scores=scores.reshape(shape),
        amplitudes=(scores / np.sqrt(precision)).reshape(shape),
        signatures=left.reshape(-1, *shape),
    )


def _without_line(
    fitted: Fitted, theta: Array, residuals: Array, jacobian: Array
) -> tuple[Array, Array]:
    """Rows of the residuals and of their Jacobian without those of a line the model has already."""
    names = fitted.model.parameters.names
    kept = [i for i, name in enumerate(names) if not name.startswith(f"{NAME}.")]
    if len(kept) == len(names):
        return residuals, jacobian
    # Its force is proportional to its stiffness, the first of its parameters.
    stiffness = len(kept)
    rows = np.r_[np.arange(fitted.n_data), fitted.n_data + np.array(kept)]
    removed = residuals + jacobian[:, stiffness] * theta[stiffness]
    return removed[rows], jacobian[np.ix_(rows, kept)]
