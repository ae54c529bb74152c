"""The answer of a diagnosis, with the evidence for it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from identknee.checks.data_noise import NoiseSource
from identknee.checks.fit_checks import ComparedForces
from identknee.diagnosis.advice import Advice
from identknee.diagnosis.believability import CauseUnderLimits
from identknee.diagnosis.candidates import Exclusion
from identknee.diagnosis.fitting import Refit, Rival, RivalState
from identknee.diagnosis.gain import (
    Assessment,
    ElpdDifference,
    FamilyDifference,
    Gain,
    ParameterChange,
    Process,
    Rmse,
)
from identknee.diagnosis.investigation import (
    Investigation,
)
from identknee.diagnosis.misfit import LEVEL, CellScore, ResidualTest
from identknee.diagnosis.missing_line import LineEnds, LineFinding, Pull
from identknee.diagnosis.verdict import (
    Cause,
    Estimate,
    Verdict,
    causes_of,
    ligament_estimates,
    made_by_priors,
)
from identknee.identify.laplace import Interval
from identknee.laxity.protocol import shown_flexion
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS
from identknee.model.parameters import STIFFNESS, STRAIN
from identknee.runs.declare import (
    OF_COORDINATE,
    OF_PARAMETER,
    Array,
    array,
    declared,
    derived,
    entry,
)
from identknee.runs.findings import Doubt, Finding, doubt_of
from identknee.runs.record import Outcome
from identknee.subject.insertion_sites import PlaceSide
from identknee.subject.knee import EffectChoice, Knee
from identknee.verbs.answer import Answer
from identknee.verbs.values import AdvisedTrial, Trials, advised, trials_of

OF_MODEL = "of the model without causes (before), with them (after), with a process (absorbed)"


@declared
class FamilyGain:
    """The gain on trials held out of one family: an angle, a direction, the largest loads."""

    elpd_difference: float = entry("Gain in log predictive density, in nats", unit="1")
    elpd_se: float = entry("Its standard error", unit="1")
    elpd_absorbed_difference: float = entry(
        "Gain in log predictive density of a Gaussian process in place of the cause", unit="1"
    )
    elpd_absorbed_se: float = entry("Its standard error", unit="1")
    folds: tuple[str, ...] = entry("Folds that count")
    without_signature: tuple[str, ...] = entry("Folds in which both models predict alike")
    not_scored: Mapping[str, str] = entry("Folds that could not be predicted, and why")
    rmse_held_out: Mapping[str, Rmse] = entry(f"Error of trials held out, {OF_MODEL}")
    rmse_held_out_expected: Mapping[str, Rmse] = entry(f"Error that it expects itself, {OF_MODEL}")


@declared
class GainFound:
    """What the causes gain over the model without them."""

    rmse_held_out_before: float = entry(
        "Error of trials held out without causes, in units of noise", unit="1"
    )
    rmse_held_out_after: float = entry("Error of trials held out with the causes", unit="1")
    elpd_difference: float = entry(
        "Gain in log predictive density of trials held out, in nats", unit="1"
    )
    elpd_se: float = entry("Its standard error", unit="1")
    elpd_absorbed_difference: float = entry(
        "Gain in log predictive density of a Gaussian process fitted to the residuals", unit="1"
    )
    elpd_absorbed_se: float = entry("Its standard error", unit="1")
    log_evidence_difference: float = entry("Log evidence with less without the causes", unit="1")
    rmse_in_sample: Mapping[str, Rmse] = entry(f"Error of the trials fitted, {OF_MODEL}")
    rmse_held_out: Mapping[str, Rmse] = entry(f"Error of trials held out, {OF_MODEL}")
    rmse_held_out_expected: Mapping[str, Rmse] = entry(f"Error that it expects itself, {OF_MODEL}")
    misfit: Mapping[str, ResidualTest] = entry(f"Test of the size of the misfit, {OF_MODEL}")
    families: Mapping[str, FamilyGain] = entry("Gain by what is held out")
    explained: Mapping[str, float] = entry("Share of each coordinate's misfit that goes")
    discrepancy: Process = entry("The process")
    parameters: Mapping[str, ParameterChange] = entry("Parameters of both models by name")
    forces: Mapping[str, Mapping[str, Mapping[str, float]]] = entry(
        "Force of each ligament under the largest loads, by trial, before_N and after_N", unit="N"
    )


def gain_found(gain: Gain) -> GainFound:
    """A gain as its answer keeps it."""
    models = {"before": gain.before, "after": gain.after, "absorbed": gain.absorbed}
    forces = gain.forces
    held_out = _held_out(gain, models)
    return GainFound(
        rmse_held_out_before=held_out["rmse_held_out"]["before"].noise,
        rmse_held_out_after=held_out["rmse_held_out"]["after"].noise,
        **_density(gain.elpd, gain.elpd_absorbed),
        log_evidence_difference=gain.log_evidence_difference,
        rmse_in_sample={name: x.in_sample for name, x in models.items()},
        **held_out,
        misfit={name: x.check for name, x in models.items()},
        families={
            one.family: FamilyGain(
                **_density(one, absorbed),
                folds=tuple(x.name for x in one.folds),
                without_signature=tuple(x.name for x in one.without_signature),
                not_scored={x.name: reason for x, reason in one.not_scored},
                **_held_out(gain, models, one.family),
            )
            for one, absorbed in zip(gain.elpd.families, gain.elpd_absorbed.families, strict=True)
        },
        explained=gain.explained,
        discrepancy=gain.discrepancy.process,
        parameters={x.name: x for x in gain.parameters},
        forces={
            trial: {
                ligament: {"before_N": float(before), "after_N": float(after)}
                for ligament, before, after in zip(forces.ligaments, *pair, strict=True)
            }
            for trial, *pair in zip(forces.trials, forces.before, forces.after, strict=True)
        },
    )


def _density(
    found: ElpdDifference | FamilyDifference, absorbed: ElpdDifference | FamilyDifference
) -> dict[str, Any]:
    return {
        "elpd_difference": found.difference,
        "elpd_se": found.se,
        "elpd_absorbed_difference": absorbed.difference,
        "elpd_absorbed_se": absorbed.se,
    }


def _held_out(
    gain: Gain, models: Mapping[str, Assessment], family: str | None = None
) -> dict[str, Any]:
    return {
        "rmse_held_out": {k: gain.rmse_held_out(x, family) for k, x in models.items()},
        "rmse_held_out_expected": {k: gain.expected_rmse(x, family) for k, x in models.items()},
    }


OF_WRENCH = "N or N·m, as the component's name says"
WRENCH = ("varus_Nm", "internal_Nm", "x_N", "y_N", "z_N")
ByLigament = Mapping[str, Mapping[str, float]]
IntervalsByLigament = Mapping[str, Mapping[str, Interval]]


@declared
class LineFound(LineEnds):
    """The line of force that explains most where no known cause does."""

    is_line: bool = entry("Whether one line of force explains the data")
    sentence: str = entry("What is near it")
    offset_95: float = entry("How far it may be off, with 95 %", unit="mm", key="offset_95_mm")
    angle_95: float = entry(
        "How far its direction may be off, with 95 %", unit="deg", key="angle_95_deg"
    )
    side: PlaceSide = entry("Side on which it crosses the joint")
    near: Mapping[str, float] = entry("Share of likely lines by the place they are near to")
    force: float = entry("Force along it in its trial", unit="N", key="force_N")
    force_interval: tuple[float, float] = entry(
        "95 % interval of the force", unit="N", key="force_ci95_N"
    )
    trial: str = entry("Trial in which the line pulls most", key="force_trial")
    p_value: float = entry("Probability that noise gives some line as high a score", unit="1")


@declared
class RivalFound:
    """Another explanation, and what the data say of it."""

    causes: tuple[str, ...] = entry("Names of its causes")
    log_evidence_deficit: float | None = entry(
        "How far its log evidence is below the best; null if not tested",
        unit="1",
        key="log_evidence_below",
    )
    distance: float | None = entry(
        "Distance from what the best explanation expects, in units of noise; null if not tested",
        unit="1",
    )
    state: RivalState = entry("Whether it is open, excluded, or no fit with it could be finished")
    reason: str | None = entry("Why it was not tested; null if it was")
    could_matter: bool = entry(
        "Whether its score leaves it possible; a rival not tested then blocks NAMED"
    )
    is_excluded: bool = entry("Whether the data exclude it")
    amplitudes: tuple[Cause, ...] = entry("Its causes", only="an open rival")
    parameters: ByLigament | None = entry(
        "Ligaments' parameters with it", unit=OF_PARAMETER, only="an open rival"
    )


@declared
class Misfit:
    """Where the model is wrong, and how clearly."""

    sentence: str = entry("Where the misfit is")
    share: float = entry("Share of the excess misfit that is there", unit="1")
    cells: tuple[CellScore, ...] = entry("Fields of the map that stand out together")
    map: tuple[CellScore, ...] = entry("All fields of the map", rows="cell", group="misfit")
    chi_square_before: float = entry("Chi-square of the data without causes", unit="1")
    chi_square_after: float = entry("Chi-square of the data with the causes", unit="1")
    n_measured: int = entry("Values measured", unit="1")
    p_value_before: float = entry(
        "Probability of size and pattern of the residuals without causes", unit="1"
    )
    p_value_after: float = entry("Probability of the residuals with the causes", unit="1")
    p_value_largest_score: float = entry(
        "Probability of the library's largest score under noise", unit="1"
    )

    def __post_init__(self) -> None:
        unknown = [x.coordinate for x in self.map if x.coordinate not in COORDINATES]
        if unknown:
            raise ValueError(f"there is no coordinate {unknown[0]!r} on the map of misfit")


@declared
class NoiseFound:
    """The noise of the data."""

    sentence: str = entry("Where its size comes from")
    source: NoiseSource = entry("Where its size comes from, in a word")
    sd: Mapping[str, float | None] = entry("Typical standard deviation by unit, mm and deg")
    correlation: float = entry(
        "Correlation that the errors of a trial share", unit="1", key="within_trial_correlation"
    )
    times_stated: tuple[float, float] | None = entry(
        "Noise found over noise stated, of lengths and angles; null where none is stated"
    )
    degrees_of_freedom: float = entry(
        "Degrees of freedom of its estimate; null where it is taken as stated", unit="1"
    )


@declared
class Explanation:
    """A model that was compared with others in the end: without causes, the best, a rival."""

    label: str = entry("Its causes, joined by +; none without any", key="explanation")
    names: tuple[str, ...] = entry("Names of its causes")
    log_evidence: float = entry("Log evidence up to a constant of the data", unit="1")
    chi_square: float = entry("Chi-square of the data", unit="1")
    p_value: float = entry("Probability of its misfit under noise", unit="1")
    outcome: Outcome = entry("How its fit ended")
    theta: Array = array("Ligaments' parameters", "parameter", unit=OF_PARAMETER)
    residuals: Array = array("Measured less predicted", "trial", "coordinate", unit=OF_COORDINATE)


@declared
class Residuals:
    """Measured less predicted laxity."""

    before: Array = array("Without causes", "trial", "coordinate", unit=OF_COORDINATE)
    after: Array = array("With the causes", "trial", "coordinate", unit=OF_COORDINATE)
    sd: Array = array("Noise used", "trial", "coordinate", unit=OF_COORDINATE)


@declared
class TrialWrench:
    """What else would have to act in every trial, in axes that turn with flexion."""

    components: tuple[str, ...] = array("Components", "component", is_in_arrays=False)
    whole: Array = array("All of it", "trial", "component", unit=OF_WRENCH)
    sd_whole: Array = array("Its standard error", "trial", "component", unit=OF_WRENCH)
    outside: Array = array("Its part outside contact", "trial", "component", unit=OF_WRENCH)
    sd_outside: Array = array("Standard error of that part", "trial", "component", unit=OF_WRENCH)


@declared
class StepScores:
    """Scores of all effects beside one fit."""

    beside: tuple[str, ...] = entry("Causes in the fit")
    quantile: float = entry("Largest score of all by chance in 5 % of data", unit="1")
    scores: Mapping[str, float] = entry("Score of each effect, as a z-score")


@declared
class AddedVariable:
    """What is left of the data against what the leading cause would leave, fit taken out."""

    name: str = entry("Name of the cause")
    variant: str = entry("Its variant that scores highest")
    score: float = entry("Its score", unit="1")
    expected: Array = array("Expected of the cause, in units of noise", "value")
    left: Array = array("Left of the data, in units of noise", "value")
    flexion_deg: Array = array(
        "Flexion of the trial; angles that a rig reads a little apart are one", "value", unit="deg"
    )


@declared
class AddedEffect:
    """An effect of the extended subject, as its file holds it."""

    name: str = entry("Name of the effect")
    values: Mapping[str, float] = entry("Amplitudes by name")
    fixed: tuple[str, ...] = entry("Amplitudes that are not calibrated")
    lines: tuple[LineEnds, ...] = entry("Lines of a structure, in the axes of the scan")
    stiffness_sd: float | None = entry(
        "Prior standard deviation of its stiffness", unit="kN", key="stiffness_sd_kN"
    )
    site_sd: float | None = entry(
        "Prior standard deviation of its insertions", unit="mm", key="site_sd_mm"
    )


@declared
class Diagnosis(Answer):
    """What the data say against the model of a subject."""

    verdict: Verdict = entry("ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED or NOT_TESTABLE")
    sentence: str = entry("The verdict as a sentence")
    reasons: tuple[str, ...] = entry("Why this verdict and no other")
    p_value: float | None = entry(
        "How often noise alone would leave a misfit as clear", unit="1", default=None
    )
    causes: tuple[Cause, ...] = entry("Causes of the best explanation", default=())
    group: tuple[str, ...] = entry(
        "Names that the data leave open, those of the causes among them", default=()
    )
    line: LineFound | None = entry(
        "Line of force where no known cause explains the data", only="UNEXPLAINED", default=None
    )
    rivals: tuple[RivalFound, ...] = entry("Other explanations, likeliest first", default=())
    misfit: Misfit | None = entry("Where the model is wrong", default=None)
    missing_wrench: tuple[Pull, ...] = entry(
        "What else would have to act on the tibia, by flexion and direction of load", default=()
    )
    noise: NoiseFound | None = entry("Noise of the data", default=None)
    advised_trials: tuple[AdvisedTrial, ...] = entry(
        "Trials that would tell the rivals apart", only="AMBIGUOUS", default=()
    )
    advice: Advice | None = entry("What they would do", only="AMBIGUOUS", default=None)
    gain: GainFound | None = entry("What the causes gain", only="a cause found", default=None)
    parameters_before: ByLigament | None = entry(
        "Ligaments' parameters fitted without causes", unit=OF_PARAMETER, default=None
    )
    parameters_after: ByLigament | None = entry(
        "Ligaments' parameters fitted with the causes", unit=OF_PARAMETER, default=None
    )
    parameters_before_ci95: IntervalsByLigament | None = entry(
        "95 % intervals without causes; an open end is null", unit=OF_PARAMETER, default=None
    )
    parameters_after_ci95: IntervalsByLigament | None = entry(
        "95 % intervals with the causes; an open end is null", unit=OF_PARAMETER, default=None
    )
    made_by_priors_before: tuple[str, ...] = entry(
        "Ligaments' parameters whose interval without causes priors make more than the data",
        default=(),
    )
    made_by_priors_after: tuple[str, ...] = entry(
        "Ligaments' parameters whose interval with the causes priors make more than the data",
        default=(),
    )
    effects: Mapping[str, Exclusion] = entry(
        "What the data say of every effect of the library",
        rows="effect",
        group="scores",
        default_factory=dict,
    )
    trials: Trials | None = entry("The data", group="observed_data", default=None)
    residuals: Residuals | None = entry("What is left of them", group="residuals", default=None)
    forces_before: ComparedForces | None = entry(
        "Measured forces, and what the model without causes predicts of them",
        group="forces_before",
        only="measured forces",
        default=None,
    )
    forces_after: ComparedForces | None = entry(
        "Measured forces, and what the best explanation predicts of them",
        group="forces_after",
        only="measured forces",
        default=None,
    )
    trial_wrench: TrialWrench | None = entry(
        "What is missing in every trial", group="missing_wrench", default=None
    )
    parameter_names: tuple[str, ...] = array(
        "Names of the ligaments' parameters", "parameter", is_in_arrays=False, default=()
    )
    explanations: tuple[Explanation, ...] = entry(
        "Models compared in the end: without causes, the best, its rivals",
        rows="explanation",
        group="refits",
        default=(),
    )
    steps: tuple[StepScores, ...] = entry(
        "Scores beside the model without causes, and beside the explanation", default=()
    )
    added_variable: AddedVariable | None = entry(
        "The leading cause against the data", group="added_variable", default=None
    )
    extension: tuple[AddedEffect, ...] = entry(
        "Effects of the subject extended by the causes", default=()
    )
    under_limits: tuple[CauseUnderLimits, ...] = entry(
        "The model without causes and with some where limits of plausibility count beside the data",
        only="`--plausible`",
        default=(),
    )

    @property
    @override
    def best_deviance(self) -> float:
        """Infinite: its deviance is in units of the noise found, and compares with no other's."""
        return float("inf")

    @property
    @derived("Why no value without the causes is known, in words; null where nothing says so")
    def doubt_before(self) -> str | None:
        """Data that reject the model make its values conditional on the misfit."""
        if self.p_value is not None and self.p_value <= LEVEL:
            return Doubt.MISFIT.value
        return _words(None if self.causes else doubt_of(self.findings))

    @property
    @derived("Why no value with the causes is known; null where nothing says so or without a cause")
    def doubt_after(self) -> str | None:
        """None without causes, or if NAMED, the model fits, and no finding speaks against it."""
        if not self.causes:
            return None
        if self.misfit is not None and self.misfit.p_value_after <= LEVEL:
            return Doubt.MISFIT.value
        is_named = self.verdict is Verdict.NAMED
        return _words(doubt_of(self.findings) or (None if is_named else Doubt.CAUSE))

    def __post_init__(self) -> None:
        trees = (
            self.parameters_before,
            self.parameters_after,
            self.parameters_before_ci95,
            self.parameters_after_ci95,
        )
        named = {tuple((owner, *own) for owner, own in x.items()) for x in trees if x is not None}
        if len(named) > 1 or (None in trees and any(trees)):
            raise ValueError("the parameters before and after do not name the same")
        if any(
            {STIFFNESS, STRAIN} - names.keys() for names in (self.parameters_before or {}).values()
        ):
            raise ValueError("a ligament lacks its stiffness or its reference strain")
        if self.misfit is not None and not (self.trials and self.residuals and self.steps):
            raise ValueError("the data that the misfit is of are missing")

    @property
    def cause_names(self) -> tuple[str, ...]:
        """Names of the causes found."""
        return tuple(x.name for x in self.causes)

    def extended_knee(self, knee: Knee) -> Knee:
        """The subject with the causes found, for every other calculation."""
        return knee.with_effects([_choice(x, knee) for x in self.extension])


def _words(doubt: Doubt | None) -> str | None:
    return None if doubt is None else doubt.value


def _choice(effect: AddedEffect, knee: Knee) -> EffectChoice:
    lines = [x.in_common_frame(knee) for x in effect.lines]
    return EffectChoice(
        name=effect.name,
        values=dict(effect.values),
        fixed=effect.fixed,
        lines=tuple((x[0], x[1]) for x in lines),
        stiffness_sd_kN=effect.stiffness_sd,
        site_sd_mm=effect.site_sd,
    )


# From N mm to N·m, for the components of a wrench.
WRENCH_UNITS = np.array([0.001, 0.001, 1.0, 1.0, 1.0])


def untestable(reason: str, findings: tuple[Finding, ...] = ()) -> Diagnosis:
    """The answer where the data cannot be tested, with what they say against themselves."""
    verdict = Verdict.NOT_TESTABLE
    return Diagnosis(
        verdict=verdict, sentence=verdict.sentence, reasons=(reason,), findings=findings
    )


def diagnosis_of(found: Investigation) -> Diagnosis:
    """The answer that fits and tests give."""
    conclusion, base, best = found.conclusion, found.base, found.explanation
    before, after = ligament_estimates(base), ligament_estimates(best)
    knee, n = base.fitted.model.knee, base.fitted.model.n_ligament_parameters
    wrench = found.missing_wrench
    first, *others = found.attribution.steps
    return Diagnosis(
        assumptions=(knee.uncertainty.sentence,),
        uncertainty=knee.uncertainty.words,
        nuisances=base.fitted.nuisances,
        evidence=base.fitted.evidence,
        verdict=conclusion.verdict,
        sentence=conclusion.sentence,
        p_value=conclusion.p_value,
        reasons=conclusion.reasons,
        causes=causes_of(best),
        group=conclusion.group,
        line=None if found.line is None else _line(found.line),
        rivals=tuple(_rival(x) for x in found.attribution.rivals),
        misfit=_misfit(found),
        missing_wrench=found.missing_pulls,
        noise=_noise(found),
        advised_trials=() if found.advice is None else advised(found.advice.trials),
        advice=found.advice,
        gain=None if found.gain is None else gain_found(found.gain),
        parameters_before=_values(before),
        parameters_after=_values(after),
        parameters_before_ci95=_intervals(before),
        parameters_after_ci95=_intervals(after),
        made_by_priors_before=made_by_priors(base),
        made_by_priors_after=made_by_priors(best),
        effects={x.name: x for x in found.exclusions},
        trials=trials_of(found.laxity),
        residuals=Residuals(
            before=base.fitted.differences, after=best.fitted.differences, sd=found.noise.sd
        ),
        forces_before=base.fitted.compared_forces,
        forces_after=best.fitted.compared_forces,
        trial_wrench=TrialWrench(
            components=WRENCH,
            whole=WRENCH_UNITS * wrench.wrench,
            sd_whole=WRENCH_UNITS * np.sqrt(np.einsum("nii->ni", wrench.covariance)),
            outside=WRENCH_UNITS * wrench.outside,
            sd_outside=WRENCH_UNITS * np.sqrt(np.einsum("nii->ni", wrench.outside_covariance)),
        ),
        parameter_names=base.fitted.model.parameters.names[:n],
        explanations=tuple(
            Explanation(
                label=" + ".join(x.names) or "none",
                names=x.names,
                log_evidence=x.log_evidence,
                chi_square=x.fitted.misfit,
                p_value=x.misfit_p_value,
                outcome=x.fitted.outcome,
                theta=x.fitted.theta[:n],
                residuals=x.fitted.differences,
            )
            for x in _compared(found)
        ),
        steps=tuple(
            StepScores(
                beside=x.at.names,
                quantile=x.scores.quantile,
                scores={y.name: y.score for y in x.scores.candidates},
            )
            for x in (first, *(x for x in others if x.at is found.explanation))
        ),
        added_variable=_added_variable(found),
        extension=tuple(_added_effect(x, knee) for x in found.extended_knee.effects),
        findings=found.findings,
    )


def _line(line: LineFinding) -> LineFound:
    low, high = line.force_interval.tolist()
    ends = LineEnds.of(np.stack([line.femur, line.tibia]), line.refit.fitted.model.knee)
    return LineFound(
        femur=ends.femur,
        tibia=ends.tibia,
        is_line=line.is_line,
        sentence=line.sentence,
        offset_95=line.offset_95,
        angle_95=line.angle_95_deg,
        side=line.side,
        near=dict(line.place.shares),
        force=line.force,
        force_interval=(low, high),
        trial=line.trial,
        p_value=line.p_value,
    )


def _rival(rival: Rival) -> RivalFound:
    is_open, is_tested = rival.state is RivalState.OPEN, rival.state is not RivalState.NOT_TESTED
    return RivalFound(
        causes=rival.refit.names,
        log_evidence_deficit=rival.log_evidence_deficit if is_tested else None,
        distance=rival.distance if is_tested else None,
        state=rival.state,
        reason=rival.reason or None,
        could_matter=rival.could_matter,
        is_excluded=rival.is_excluded,
        amplitudes=causes_of(rival.refit) if is_open else (),
        parameters=_values(ligament_estimates(rival.refit)) if is_open else None,
    )


def _misfit(found: Investigation) -> Misfit:
    base, best = found.base, found.explanation
    return Misfit(
        sentence=found.localisation.sentence,
        share=found.localisation.share,
        cells=found.localisation.region,
        map=found.localisation.cells,
        chi_square_before=base.fitted.misfit,
        chi_square_after=best.fitted.misfit,
        n_measured=base.fitted.n_data,
        p_value_before=base.misfit_p_value,
        p_value_after=best.misfit_p_value,
        p_value_largest_score=found.attribution.steps[0].scores.p_value,
    )


def _noise(found: Investigation) -> NoiseFound:
    noise = found.noise
    columns = {"mm": noise.sd[:, TRANSLATIONS], "deg": noise.sd[:, ROTATIONS]}
    known = {unit: sd[np.isfinite(sd)] for unit, sd in columns.items()}
    return NoiseFound(
        sentence=noise.sentence,
        source=noise.source,
        sd={unit: float(np.median(sd)) if sd.size else None for unit, sd in known.items()},
        correlation=noise.correlation,
        times_stated=noise.factors,
        degrees_of_freedom=noise.degrees_of_freedom,
    )


def _compared(found: Investigation) -> list[Refit]:
    """The base model, the best explanations, their rivals, each once."""
    best = {x.names: x for x in (found.explanation, found.attribution.best) if x.causes}
    rivals = [x.refit for x in found.attribution.rivals if x.refit is not found.base]
    return [found.base, *best.values(), *rivals]


def _added_variable(found: Investigation) -> AddedVariable:
    step, fitted = found.attribution.steps[0], found.base.fitted
    scored = [x for x in step.scores.candidates if x.name in found.explanation.names]
    candidate = [*scored, *step.scores.candidates][0]
    signature = step.test.signature(candidate.name, candidate.variant)
    measured = found.laxity.is_measured
    flexion = np.broadcast_to(shown_flexion(found.laxity.protocol)[:, None], measured.shape)
    return AddedVariable(
        name=candidate.name,
        variant=candidate.variant,
        score=candidate.score,
        expected=(signature.projected @ candidate.amplitude)[: fitted.n_coordinates],
        left=step.test.projector.project(fitted.scored_rows)[: fitted.n_coordinates],
        flexion_deg=flexion[measured],
    )


def _added_effect(choice: EffectChoice, knee: Knee) -> AddedEffect:
    return AddedEffect(
        name=choice.name,
        values=choice.values,
        fixed=choice.fixed,
        lines=tuple(LineEnds.of(np.stack(x), knee) for x in choice.lines),
        stiffness_sd=choice.stiffness_sd_kN,
        site_sd=choice.site_sd_mm,
    )


def _values(tree: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, float]]:
    return {owner: {k: x.value for k, x in own.items()} for owner, own in tree.items()}


def _intervals(tree: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, Any]]:
    return {owner: {k: x.ci95 for k, x in own.items()} for owner, own in tree.items()}
