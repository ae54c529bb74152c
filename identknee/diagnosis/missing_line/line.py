"""The line along which a cause that is not in the library acts, if it acts along one."""

import numpy as np
from scipy.stats import chi2

from identknee.diagnosis.explanations.refit import Refit, refit
from identknee.diagnosis.missing_line.scan import (
    NAME,
    STIFFNESS_SD,
    CandidateLines,
    LineScan,
    ScannedLine,
    candidate_lines,
    scan_lines,
)
from identknee.mechanics.ligament_tensions import LigamentTensions, ligament_tensions
from identknee.model.effects.structures import MissingStructure
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.setting import Setting
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry
from identknee.subject.place_names import Place, PlaceSide, name_of_place

SITE_SD = 10.0  # mm, around the bone
LEAST_STIFFNESS = 0.02  # kN, of a line at the start of its refit
TRIES = 3  # lines of each scan that are refitted
MOST_ROUNDS = 3
# While lines are compared, and for the one that is reported.
ROUGH_STEPS, FINE_STEPS = 15, 60
ENOUGH = 1.0  # of the deviance, that another round must gain
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
        """The finding in words."""
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
        return float(np.sqrt(chi2.ppf(LEVEL, 2) * largest))


def find_line(base: Refit, *, seed: int = 0) -> LineFinding | None:
    """The line of action that explains most of what a fitted model leaves; None if none does.

    Lines are scored where the model is linearised at the fit, and again at the centre of the
    priors: parameters that were fitted without a strong structure have compensated for it and may
    be far from those with it. The best lines of both are refitted with all parameters, stiffness,
    slack strain and both ends free. Lines are then scored again at the best refit, where the
    parameters are nearly right, until that brings nothing new.

    Parameters
    ----------
    base
        The model without a line, fitted.
    seed
        Seed of the choice of lines and of the draws behind the p-value.

    Raises
    ------
    ValueError
        If the fit has no prediction.
    """
    fitted = base.fitted
    lines = candidate_lines(fitted.model.knee, seed=seed)
    first = scan_lines(fitted, fitted.theta, lines)
    if first is None:
        raise ValueError("the fit has no prediction; lines are sought from the best fit")
    refits = _refits(base, fitted.theta, first)
    center = fitted.model.parameters.center
    refits += _refits(base, center, scan_lines(fitted, center, lines))
    if not any(x.fitted.evaluation.is_finite for x in refits):
        return None
    refits += _rescanned(base, refits, lines)
    best = _lowest(refits)
    last = refit(base, best.causes, [best.fitted.theta], most_steps=FINE_STEPS)
    n_simulations = sum(x.fitted.constrained.n_simulations for x in [*refits, last])
    return _finding(base, first, last, n_simulations, seed)


def _rescanned(base: Refit, refits: list[Refit], lines: CandidateLines) -> list[Refit]:
    """Refits of the lines that score best at the best refit so far."""
    added: list[Refit] = []
    best = _lowest(refits)
    for _ in range(MOST_ROUNDS):
        scan = scan_lines(best.fitted, best.fitted.theta, lines)
        added += _refits(base, best.fitted.theta[: best.n_base], scan)
        lower = _lowest([best, *added])
        if lower.fitted.deviance > best.fitted.deviance - ENOUGH:
            break
        best = lower
    return added


def _refits(base: Refit, theta: Array, scan: LineScan | None) -> list[Refit]:
    """Refits from theta with the best lines of a scan."""
    if scan is None:
        return []
    return [_refit(base, theta, x) for x in scan.best(TRIES)]


def _refit(base: Refit, theta: Array, line: ScannedLine) -> Refit:
    knee = base.fitted.model.knee
    structure = MissingStructure(
        name=NAME,
        femoral=knee.femur_frame.to_local(line.femur[None]),
        tibial=knee.tibia_frame.to_local(line.tibia[None]),
        stiffness_sd=STIFFNESS_SD,
        site_sd=SITE_SD,
    )
    stiffness = max(line.amplitude, LEAST_STIFFNESS)
    start = np.r_[theta, stiffness, line.strain_pct, np.zeros(6)]
    return refit(base, [structure], [start], most_steps=ROUGH_STEPS)


def _lowest(refits: list[Refit]) -> Refit:
    return min(refits, key=lambda x: x.fitted.deviance)


def _finding(
    base: Refit, scan: LineScan, last: Refit, n_simulations: int, seed: int
) -> LineFinding:
    """The refit and the scan that led to it, in words of the subject."""
    model, theta, covariance = last.fitted.model, last.fitted.theta, last.covariance()
    ends, ends_covariance = _ends(model, theta, covariance)
    cloud = np.random.default_rng(seed).multivariate_normal(ends, ends_covariance, N_CLOUD)
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


def _ends(model: LaxityModel, theta: Array, covariance: Array) -> tuple[Array, Array]:
    """Both ends of the line in the common frame [mm], shape ``(6,)``, and their covariance."""
    lines, knee = model.setting(theta).lines, model.knee
    turn = np.zeros((6, 6))
    turn[:3, :3], turn[3:, 3:] = knee.femur_frame.axes.T, knee.tibia_frame.axes.T
    ends = np.r_[
        knee.femur_frame.to_common(lines.femoral[-1]),
        knee.tibia_frame.to_common(lines.tibial[-1]),
    ]
    return ends, turn @ covariance[-6:, -6:] @ turn.T


def _largest_force(model: LaxityModel, prediction: Prediction) -> tuple[int, float, Array]:
    """The trial in which the line pulls most, its force there [N] and the slopes by theta."""
    theta, slope = prediction.theta, np.zeros(model.parameters.n)
    pulled = _tensions(model, model.setting(theta), prediction)
    trial = int(np.nanargmax(np.where(prediction.is_converged, pulled.tensions[:, -1], np.nan)))
    if prediction.pose_jacobian is not None:
        slope += pulled.by_pose[trial, -1] @ prediction.pose_jacobian[trial]
    unchanged, amplitudes = model.setting(theta, is_changed=False), model.amplitudes(theta)
    for k, move in enumerate(model.extension.moves(), start=model.n_ligament_parameters):
        low, high = (
            _tensions(model, model.extension.change(unchanged, amplitudes + x), prediction)
            for x in (-move, move)
        )
        change = high.tensions[trial, -1] - low.tensions[trial, -1]
        slope[k] += change / (2.0 * move[k - model.n_ligament_parameters])
    return trial, float(pulled.tensions[trial, -1]), slope


def _tensions(model: LaxityModel, setting: Setting, prediction: Prediction) -> LigamentTensions:
    """Tensions of all lines at the poses of a prediction, the missing one last."""
    flexion = setting.flexion[model.paths.trial_node]
    return ligament_tensions(
        setting.measured_lines,
        flexion,
        prediction.poses,
        setting.stiffness,
        setting.reference_strain,
    )
