"""The line along which a cause that is not in the library acts, if it acts along one."""

from typing import Self

import numpy as np
import scipy

from identknee.diagnosis.fitting import FittedModel, Refit, refit
from identknee.diagnosis.misfit import TrialLayout, base_projector
from identknee.mechanics.pose import coordinate_jacobian
from identknee.model.effects.structures import MissingStructure
from identknee.model.laxity_model import LaxityModel, observed_slopes
from identknee.model.line_loads import added_line_tensions, line_loads
from identknee.model.mechanics_inputs import PER_KN, PER_PCT
from identknee.model.missing_wrench import MissingWrench, along_plateau
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array, BoolArray, array, declared, entry
from identknee.subject.insertion_sites import Place, PlaceSide, insertion_surfaces, name_of_place
from identknee.subject.knee import Knee

LENGTHS = (12.0, 90.0)  # mm
MOST_LINES = 3000
# Of all lines on all measured values at every slack strain: 333 lines for 3,000 trials.
MOST_EFFECTS = 20_000_000
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

        The line extends beyond its own ends: how far along it a force acts makes no difference.
        """
        along = self.directions[line]
        is_close = np.ones(self.n, bool)
        for ends in (self.femur, self.tibia):
            away = ends - self.femur[line]
            away = away - (away @ along)[:, None] * along
            is_close &= np.linalg.norm(away, axis=1) < distance
        return is_close


def candidate_lines(knee: Knee, *, seed: int = 0, most: int = MOST_LINES) -> CandidateLines:
    """Lines between places of both bones that lie on one side, 12 to 90 mm apart.

    Central places go with either side. Where there are more than `most`, some are taken at random.

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
    chosen = np.random.default_rng(seed).permutation(len(pairs))[:most]
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
    converged = prediction.is_converged
    hessians = np.where(converged[:, None, None], prediction.hessians, np.eye(5))
    seen = observed_slopes(model, prediction)
    compliance = seen @ coordinate_jacobian(prediction.poses) @ np.linalg.inv(hessians)
    pulls = line_gradients(model, prediction, lines)
    columns = -(compliance @ pulls.reshape(*pulls.shape[:2], -1)).reshape(pulls.shape)
    columns[~converged] = np.nan
    return np.asarray(columns)


def line_gradients(model: LaxityModel, prediction: Prediction, lines: CandidateLines) -> Array:
    """What each line of 1 kN adds to the gradient of the energy at every slack strain.

    Shape ``(n, 5, len(SLACK_STRAINS), m)``.
    """
    ends = (
        model.knee.femur_frame.to_local(lines.femur),
        model.knee.tibia_frame.to_local(lines.tibia),
    )
    stiffness = np.full(lines.n, PER_KN)
    gradients = np.empty((len(prediction.codes), 5, len(SLACK_STRAINS), lines.n))
    for k, strain in enumerate(SLACK_STRAINS):
        strains = np.full(lines.n, PER_PCT * strain)
        pulled = added_line_tensions(model, prediction, ends, stiffness, strains)
        pulls = pulled.tensions[:, :, None] * pulled.lengthening
        gradients[:, :, k] = pulls.transpose(0, 2, 1)
    return gradients


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


def scan_lines(fitted: FittedModel, theta: Array, lines: CandidateLines) -> LineScan | None:
    """Scores of lines of action where a model is linearised at `theta`.

    Theta need not be the best fit: what a change of it could explain is taken out. If the model
    has a missing line already, the scan is for what might take its place. None where the model has
    no prediction at theta.
    """
    problem = fitted.problem
    residuals = -problem.residuals(theta)
    if not np.isfinite(residuals).all():
        return None
    # Without the rows and columns of a line that the model has already.
    jacobian, names = problem.jacobian(theta), fitted.model.parameters.names
    kept = [i for i, name in enumerate(names) if not name.startswith(f"{NAME}.")]
    if len(kept) < len(names):
        # Its force is proportional to its stiffness, the first of its parameters.
        stiffness = len(kept)
        rows = np.r_[np.arange(fitted.n_data), fitted.n_data + np.array(kept)]
        residuals = (residuals + jacobian[:, stiffness] * theta[stiffness])[rows]
        jacobian = jacobian[np.ix_(rows, kept)]
    prediction = fitted.model.predict_once(theta)
    changes = line_columns(fitted.model, prediction, lines)
    of_forces = None
    if fitted.laxity.has_forces:
        pulls = line_gradients(fitted.model, prediction, lines)
        of_forces = fitted.forces.changes(theta, pulls.reshape(*pulls.shape[:2], -1))
    signatures = fitted.columns(changes.reshape(*changes.shape[:2], -1), of_forces)
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


Point = tuple[float, float, float]


@declared
class LineEnds:
    """Ends of a line of action in the scanned pose, in the axes of the scan."""

    femur: Point = entry("Femoral end", unit="mm")
    tibia: Point = entry("Tibial end", unit="mm")

    @classmethod
    def of(cls, ends: Array, knee: Knee) -> Self:
        """From both ends in the common frame of the scanned pose [mm], shape ``(2, 3)``."""
        femur, tibia = map(tuple, knee.in_scan_frame(ends).tolist())
        return cls(femur=femur, tibia=tibia)

    def in_common_frame(self, knee: Knee) -> Array:
        """Both ends in the common frame of the scanned pose [mm], shape ``(2, 3)``."""
        return knee.in_scan_frame(np.array([self.femur, self.tibia]))


SITE_SD = 10.0  # mm, around the bone
LEAST_STIFFNESS = 0.02  # kN, of a line at the start of its refit
TRIES = 3  # lines of each scan that are refitted
MOST_ROUNDS = 3
# While lines are compared, and for the one that is reported.
ROUGH_STEPS, FINE_STEPS = 15, 60
ENOUGH = 1.0  # least reduction of the deviance for another round
LEAST_FIT = 1e-3  # a line whose fit is less probable is no explanation
LEVEL = 0.95
N_CLOUD = 200


@declared
class LineFinding:
    """The best line of action, what lies there, and whether it explains the data."""

    refit: Refit = entry("The model extended by the line, fitted")
    femur: Array = array(
        "Femoral end of the line in the common frame of the scanned pose; where along the line it "
        "lies is hardly known",
        "axis",
        unit="mm",
    )
    tibia: Array = array("Tibial end, likewise", "axis", unit="mm")
    covariance: Array = array("Covariance of both ends", "6", "6", unit="mm2")
    place: Place = entry("What the line is near to, averaged over the lines that fit as well")
    trial: str = entry("The trial in which the line pulls most")
    force: float = entry(
        "Force of the line in that trial [N]. Stiffness and slack strain trade with each other; "
        "the force is what is known"
    )
    force_interval: Array = array("Ends of the 95 % interval of the force", "2", unit="N")
    score: float = entry("Highest score of the scan")
    p_value: float = entry("Probability that noise gives some line as high a score")
    misfit_before: float = entry("Chi-square of the data without the line")
    n_simulations: int = entry("Made in all refits")
    seed: int = entry("Seed of the lines and of the draws")

    @property
    def is_line(self) -> bool:
        """Whether a force along the line explains the data; if not, it is not a line force."""
        return self.refit.misfit_p_value > LEAST_FIT

    @property
    def side(self) -> PlaceSide:
        """The side on which the line crosses the joint."""
        return self.place.sides[0][0]

    @property
    def offset_95(self) -> float:
        """How far the line may be off at its middle, across itself, with 95 % probability [mm]."""
        return self._radius(0.5, 0.5)

    @property
    def angle_95_deg(self) -> float:
        """How far its direction may be off with 95 % probability [deg]."""
        length = float(np.linalg.norm(self.femur - self.tibia))
        return float(np.degrees(np.arctan(self._radius(1.0, -1.0) / length)))

    @property
    def sentence(self) -> str:
        """The finding as a sentence."""
        left = f"residuals of probability {self.refit.misfit_p_value:.2g}"
        if not self.is_line:
            return f"Not a line force: the best line leaves {left}."
        low, high = self.force_interval
        return (
            f"A line of force, {self.place.sentence}: {self.force:.0f} N "
            f"({low:.0f} to {high:.0f}) in {self.trial}, within {self.offset_95:.0f} mm and "
            f"{self.angle_95_deg:.0f} deg."
        )

    def _radius(self, of_femur: float, of_tibia: float) -> float:
        """Radius of the circle across the line that holds a mix of its ends [mm]."""
        along = (self.femur - self.tibia) / np.linalg.norm(self.femur - self.tibia)
        across = np.eye(3) - np.outer(along, along)
        mix = np.hstack([of_femur * across, of_tibia * across])
        largest = float(np.linalg.eigvalsh(mix @ self.covariance @ mix.T)[-1])
        return float(np.sqrt(scipy.stats.chi2.ppf(LEVEL, 2) * largest))


def find_line(base: Refit, *, seed: int = 0) -> LineFinding | None:
    """The line of action that explains most of what a fitted model leaves; None if none does.

    Lines are scored where the model is linearised at the fit, and again at the centre of the
    priors: parameters that were fitted without a strong structure have compensated for it and may
    be far from those with it. The best lines of both are refitted with all parameters, stiffness,
    slack strain and both ends free. Lines are then scored again at the best refit, where the
    parameters are nearly right, until that brings nothing new.

    Raises
    ------
    ValueError
        If the fit has no prediction.
    """
    fitted = base.fitted
    # Fewer lines for very many values, so that their effects need no more memory.
    most = min(MOST_LINES, MOST_EFFECTS // (len(SLACK_STRAINS) * fitted.n_data))
    lines = candidate_lines(fitted.model.knee, seed=seed, most=most)
    first = scan_lines(fitted, fitted.theta, lines)
    if first is None:
        raise ValueError("the fit has no prediction; lines are sought from the best fit")
    refits = _refits(base, fitted.theta, first)
    center = fitted.model.parameters.center
    refits += _refits(base, center, scan_lines(fitted, center, lines))
    if not any(x.fitted.evaluation.is_finite for x in refits):
        return None
    # Refits of the lines that score best at the best refit so far.
    best = _lowest(refits)
    for _ in range(MOST_ROUNDS):
        scan = scan_lines(best.fitted, best.fitted.theta, lines)
        refits += _refits(base, best.fitted.theta[: best.n_base], scan)
        before, best = best, _lowest(refits)
        if best.fitted.deviance > before.fitted.deviance - ENOUGH:
            break
    last = refit(base, best.causes, [best.fitted.theta], most_steps=FINE_STEPS)
    n_simulations = sum(x.fitted.constrained.n_simulations for x in [*refits, last])
    return _finding(base, first, last, n_simulations, seed)


def _refits(base: Refit, theta: Array, scan: LineScan | None) -> list[Refit]:
    knee, found = base.fitted.model.knee, []
    for line in () if scan is None else scan.best(TRIES):
        structure = MissingStructure(
            name=NAME,
            femoral=knee.femur_frame.to_local(line.femur[None]),
            tibial=knee.tibia_frame.to_local(line.tibia[None]),
            stiffness_sd=STIFFNESS_SD,
            site_sd=SITE_SD,
        )
        stiffness = max(line.amplitude, LEAST_STIFFNESS)
        start = np.r_[theta, stiffness, line.strain_pct, np.zeros(6)]
        found.append(refit(base, [structure], [start], most_steps=ROUGH_STEPS))
    return found


def _lowest(refits: list[Refit]) -> Refit:
    return min(refits, key=lambda x: x.fitted.deviance)


def _finding(
    base: Refit, scan: LineScan, last: Refit, n_simulations: int, seed: int
) -> LineFinding:
    """The refit and the scan that led to it, in words of the subject."""
    model, theta, covariance = last.fitted.model, last.fitted.theta, last.covariance()
    # Both ends of the line in the common frame [mm], shape ``(6,)``, and their covariance.
    lines, knee = model.setting(theta).lines, model.knee
    turn = np.zeros((6, 6))
    turn[:3, :3], turn[3:, 3:] = knee.femur_frame.axes.T, knee.tibia_frame.axes.T
    ends = np.r_[
        knee.femur_frame.to_common(lines.femoral[-1]),
        knee.tibia_frame.to_common(lines.tibial[-1]),
    ]
    ends_covariance = turn @ covariance[-6:, -6:] @ turn.T
    # A direction that the data know to the last bit may have a variance just below zero.
    cloud = np.random.default_rng(seed).multivariate_normal(
        ends, ends_covariance, N_CLOUD, check_valid="ignore"
    )
    trial, force, slope = _largest_force(model, model.predict_once(theta))
    margin = 1.96 * float(np.sqrt(slope @ covariance @ slope))
    return LineFinding(
        refit=last,
        femur=ends[:3],
        tibia=ends[3:],
        covariance=ends_covariance,
        place=name_of_place(model.knee, cloud[:, :3], cloud[:, 3:]),
        trial=model.protocol.trials[trial],
        force=force,
        force_interval=np.array([max(force - margin, 0.0), force + margin]),
        score=float(scan.scores.max()),
        p_value=scan.p_value(seed),
        misfit_before=base.fitted.misfit,
        n_simulations=n_simulations,
        seed=seed,
    )


def _largest_force(model: LaxityModel, prediction: Prediction) -> tuple[int, float, Array]:
    """The trial in which the line pulls most, its force there [N] and the slopes by theta.

    The missing line is the last of all lines.
    """
    pulled = line_loads(model, prediction)
    tensions, slopes = pulled.tensions[:, -1], pulled.tension_jacobian[:, -1]
    trial = int(np.nanargmax(tensions))
    return trial, float(tensions[trial]), slopes[trial]


# From N mm to N·m, for the components of a pull.
PULL_UNITS = np.array([1.0, 1.0, 0.001])


@declared
class Pull:
    """What else would have to act on the tibia, on average over the trials of one kind.

    The part along the plateau, at the tibial origin and about the tibial axis: contact hides what
    presses on it.
    """

    flexion_deg: float = entry("Flexion of the trials", unit="deg")
    direction: str = entry("Direction of their load")
    n_trials: int = entry("Trials averaged", unit="1")
    p_value: float = entry("Probability that nothing is missing", unit="1")
    anterior_force_N: float = entry("Mean anterior force", unit="N")  # noqa: N815 - key in files
    lateral_force_N: float = entry("Mean lateral force", unit="N")  # noqa: N815
    internal_moment_Nm: float = entry("Mean internal moment", unit="N m")  # noqa: N815
    sd_anterior_force_N: float = entry("Its standard error", unit="N")  # noqa: N815
    sd_lateral_force_N: float = entry("Its standard error", unit="N")  # noqa: N815
    sd_internal_moment_Nm: float = entry("Its standard error", unit="N m")  # noqa: N815
    force_covariance: tuple[tuple[float, float], tuple[float, float]] = entry(
        "Covariance of both forces", unit="N2"
    )


def missing_pulls(missing: MissingWrench, layout: TrialLayout) -> tuple[Pull, ...]:
    """The mean of what is missing outside contact, for every flexion and direction with data."""
    turn = np.stack([along_plateau(x) for x in missing.poses])
    values = np.einsum("nij,nj->ni", turn, missing.outside)
    covariances = turn @ missing.outside_covariance @ turn.transpose(0, 2, 1)
    is_whole = np.isfinite(values).all(axis=1)
    pulls = []
    for flexion in np.unique(layout.flexion_deg):
        for direction, side in layout.sides().items():
            own = side & (layout.flexion_deg == flexion) & is_whole
            n = int(own.sum())
            if n:
                mean, covariance = values[own].mean(axis=0), covariances[own].sum(axis=0) / n**2
                anterior, lateral, internal = (PULL_UNITS * mean).tolist()
                sd = (PULL_UNITS * np.sqrt(np.diag(covariance))).tolist()
                (xx, xy), (yx, yy) = covariance[:2, :2].tolist()
                square = float(mean @ np.linalg.solve(covariance, mean))
                pulls.append(
                    Pull(
                        flexion_deg=float(flexion),
                        direction=direction,
                        n_trials=n,
                        p_value=float(scipy.stats.chi2.sf(square, 3)),
                        anterior_force_N=anterior,
                        lateral_force_N=lateral,
                        internal_moment_Nm=internal,
                        sd_anterior_force_N=sd[0],
                        sd_lateral_force_N=sd[1],
                        sd_internal_moment_Nm=sd[2],
                        force_covariance=((xx, xy), (yx, yy)),
                    )
                )
    return tuple(pulls)
