"""What measured laxity says against a model: the misfit, its cause, the extended model."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

from identknee.calibrate.fit import load_start
from identknee.checks.data_noise import DataNoise
from identknee.checks.fit_checks import (
    bound_findings,
    idle_parameters,
    ligament_findings,
    parameters_at_zero,
)
from identknee.checks.subject_checks import stability_findings
from identknee.checks.usable_trials import needs_weights
from identknee.diagnosis.advice import AdvisedProtocol, advise
from identknee.diagnosis.base_fit import (
    FURTHER,
    LOOKING_LOWER,
    FurtherSearch,
    fit_base,
    lowest_fit,
)
from identknee.diagnosis.candidates import Exclusion, insertions_beyond_prior, remounting_errors
from identknee.diagnosis.fitting import (
    BaseFit,
    Refit,
    best_fit_from,
    without_causes,
)
from identknee.diagnosis.gain import Gain, measure_gain
from identknee.diagnosis.misfit import Localisation, TrialLayout, localise
from identknee.diagnosis.missing_line import (
    LineFinding,
    Pull,
    find_line,
    missing_pulls,
)
from identknee.diagnosis.score import LEVEL
from identknee.diagnosis.verdict import (
    FAR_FROM_DONE,
    SIMPLE,
    Attribution,
    Cause,
    Conclusion,
    Verdict,
    attribute,
    causes_of,
    conclude,
)
from identknee.identify.optimum import REACH_OF_HOPS
from identknee.laxity.protocol import as_shown
from identknee.laxity.table import COORDINATES, Laxity
from identknee.laxity.trial_words import SHORT_DIRECTIONS
from identknee.model.effects.effect import Effect
from identknee.model.effects.facts import cause_label
from identknee.model.effects.library import library
from identknee.model.experiments import causes_in_experiments
from identknee.model.force_residuals import weighed
from identknee.model.laxity_model import LaxityModel
from identknee.model.missing_wrench import MissingWrench, missing_wrench
from identknee.runs.declare import Array
from identknee.runs.executors import Executor, serial
from identknee.runs.findings import Finding, Severity, finding
from identknee.runs.progress import finished, stage
from identknee.runs.record import Outcome
from identknee.runs.words import listed
from identknee.subject.knee import Knee

# A fall of the deviance by more means another minimum of the base model.
LOWER = 1.0
# Predicted reduction with which a fit that ended before its minimum is still taken for it.
SMALL_REDUCTION = 1.0
REPEATING = "repeating it with other trials"


@dataclass(frozen=True, kw_only=True, eq=False)
class Investigation:
    """The fits behind a diagnosis, and what follows from them.

    What follows from the fits (causes, exclusions, the gain and so on) is computed when it is first
    asked for, once.

    Attributes
    ----------
    knee
        The subject.
    laxity
        The data.
    noise
        Their errors.
    base
        The fit of the model without causes.
    localisation
        Where its misfit is.
    attribution
        The explanations tried.
    conclusion
        The verdict.
    line
        The line of force that explains most where no known cause does; None elsewhere.
    seed
        Seed of the distributions under no effect.
    """

    knee: Knee
    laxity: Laxity
    noise: DataNoise
    base: Refit
    localisation: Localisation
    attribution: Attribution
    conclusion: Conclusion
    line: LineFinding | None
    seed: int

    @cached_property
    def explanation(self) -> Refit:
        """The model with the causes found; the base model where there are none.

        A line of force that explains what no known cause does is a cause too.
        """
        if self.conclusion.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS):
            return self.conclusion.best
        if self.line is not None and self.line.is_line:
            return self.line.refit
        return self.base

    @cached_property
    def advice(self) -> AdvisedProtocol | None:
        """Trials to add; None where nothing is to be distinguished."""
        if self.conclusion.verdict is not Verdict.AMBIGUOUS:
            return None
        noise, found = self.noise, self.attribution
        known = replace(self.laxity, sd=noise.sd, within_trial_correlation=noise.correlation)
        with stage("choosing trials"):
            return advise(found.best, found.open_rivals, known)

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """The causes of the explanation, with their amplitudes in physical units."""
        return causes_of(self.explanation)

    @cached_property
    def extended_knee(self) -> Knee:
        """The subject with the causes found, for every other calculation."""
        # The priors of the subject, not those that a diagnosis widens for idle ligaments.
        return replace(self.explanation.extended_knee, priors=self.knee.priors)

    @cached_property
    def gain(self) -> Gain | None:
        """What the causes gain on trials held out; None where there are none."""
        if not self.explanation.causes:
            return None
        return measure_gain(
            self.base.fitted,
            self.explanation.fitted,
            self.noise.sd,
            noise_degrees=self.noise.degrees_of_freedom,
        )

    @cached_property
    def exclusions(self) -> tuple[Exclusion, ...]:
        """The result for each effect of the library.

        Effects in the explanation have the score that they had before they joined it, all others
        the score beside it.
        """
        first, *others = self.attribution.steps
        beside = next((x for x in others if x.at is self.explanation), first)
        joined = self.explanation.names
        named = {x.name: x for x in self._library()}.values()
        steps = ((first if x.name in joined else beside, x) for x in named)
        return tuple(step.exclusion(effect, step.scores) for step, effect in steps)

    @cached_property
    def missing_wrench(self) -> MissingWrench:
        """What the model without causes lacks in every trial, ligaments as in the explanation.

        Ligaments fitted without the cause compensate for part of it; those fitted with it do not.
        """
        base = self.base.fitted
        theta = self.explanation.fitted.theta[: base.model.parameters.n]
        return missing_wrench(base.compared, theta, self.noise.sd, self.noise.correlation)

    @cached_property
    def missing_pulls(self) -> tuple[Pull, ...]:
        """Its mean along the plateau by flexion and direction of load."""
        return missing_pulls(self.missing_wrench, trial_layout(self.laxity))

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the fits behind the diagnosis."""
        findings = list(_unfinished(self.base, "without causes"))
        if self.explanation is not self.base:
            labels = listed(map(cause_label, self.explanation.names))
            findings += _unfinished(self.explanation, f"with {labels}")
        fitted = self.explanation.fitted
        parameters = fitted.model.parameters
        # An amplitude of zero is at its bound because that part of the cause is absent.
        amplitudes = parameters.names[fitted.model.n_ligament_parameters :]
        absent = (x for x in parameters_at_zero(fitted.theta, parameters) if x in amplitudes)
        found = fitted.model.predict_once(fitted.theta)
        # Nor do bounds of a ligament that carries nothing limit the fit.
        idle = idle_parameters(fitted.model, found)
        held = (*parameters.nuisance_names, *absent, *idle)
        findings += bound_findings(fitted.theta, parameters, held)
        findings += ligament_findings(fitted.model, found)
        findings += fitted.nuisance_findings
        findings += [
            finding(
                "cause-not-compared",
                " and ".join(x.refit.names),
                {"causes": x.refit.names},
                sentence=x.reason,
                severity=Severity.WARNING if x.could_matter else Severity.INFO,
            )
            for x in self.attribution.rivals
            if x.reason
        ]
        return (*findings, *stability_findings(self.base.fitted.model))

    def _library(self) -> tuple[Effect, ...]:
        base = self.base.fitted.model
        # What the knee states to be uncertain is a nuisance, and no cause that was looked for.
        stated = {x.name for x in base.effects if not x.parameters.is_of_interest.all()}
        return tuple(x for x in _library(base.knee, self.laxity) if x.name not in stated)


def investigate(
    knee: Knee,
    laxity: Laxity,
    *,
    starts: Sequence[Array | str | os.PathLike[str]] = (),
    effects: Sequence[Effect] | None = None,
    seed: int = 0,
    executor: Executor = serial,
    search: FurtherSearch = FURTHER,
) -> Investigation | None:
    """What the data say against the model of a knee; None where they cannot be tested.

    Parameters
    ----------
    knee, laxity
        The subject and the data.
    starts
        Where fits begin besides the subject's own values: ligament parameters, each shape
        ``(2m,)``, or names and files of starts, see `identknee.load_start`.
    effects
        Candidates; the whole library where None.
    seed
        Seed of the distributions under no effect.
    executor
        Who refits causes.
    search
        How the fit of the base model is searched for beyond its first minimum.

    Raises
    ------
    ValueError
        If there is no such start.
    """
    own = LaxityModel(knee=knee, protocol=laxity.protocol, effects=()).parameters
    begin = [load_start(x, own) if isinstance(x, str | os.PathLike) else x for x in starts]
    if effects is None:
        present = {x.name for x in LaxityModel(knee=knee, protocol=laxity.protocol).effects}
        effects = [x for x in _library(knee, laxity) if x.name not in present]
    with stage("fitting the knee"):
        base_fit = fit_base(knee, laxity, starts=begin, seed=seed)
        if base_fit is None or not base_fit.fitted.evaluation.is_finite:
            return None
        if needs_weights(laxity):
            # The weights of in-situ forces need stiffnesses, which the first fit gives.
            first = base_fit.fitted
            laxity = weighed(laxity, first.model, first.theta)
            begin = [*begin, first.theta[: first.model.n_ligament_parameters]]
            base_fit = fit_base(knee, laxity, starts=begin, seed=seed) or base_fit
        if base_fit.fitted.misfit_projector.degrees_of_freedom == 0:
            return None
        base_fit = lowest_fit(base_fit, seed, search)
    attribution, p_value = _explained(base_fit, effects, seed, executor)
    if (start := better_start(attribution)) is not None:
        again = fit_base(knee, laxity, starts=[*begin, start], seed=seed)
        near = replace(search, from_poses=False)
        base_fit = base_fit if again is None else lowest_fit(again, seed, near)
        attribution, p_value = _explained(base_fit, effects, seed, executor)
    finished("scoring causes", "trying causes", "fitting causes")
    base, noise = attribution.base, base_fit.noise
    conclusion = conclude(attribution, p_value)
    fitted = base.fitted
    localised = localise(
        fitted.misfit_rows, fitted.misfit_projector, fitted.noise, trial_layout(laxity), seed=seed
    )
    line = find_line(base, seed=seed) if conclusion.verdict is Verdict.UNEXPLAINED else None
    return Investigation(
        knee=knee,
        laxity=laxity,
        noise=noise,
        base=base,
        localisation=localised,
        attribution=attribution,
        conclusion=conclusion,
        line=line,
        seed=seed,
    )


def work_of(n: int) -> dict[str, list[float]]:
    """What each piece of a diagnosis with n parameters costs, beside the others."""
    # A fit takes longer with more parameters; its derivatives by them and by effects the more so.
    size = (24.0 + n) / 32.0
    return {
        "fitting the knee": [0.45],
        "scoring causes": [0.6 / size] * 2,
        "trying causes": [0.05] * 8,
        "fitting causes": [SIMPLE] * 7 + [FAR_FROM_DONE],
        "choosing trials": [1.6 * size],
        "telling what follows": [1.3 * size],
    }


def work_from_poses(*, is_repeated: bool) -> dict[str, list[float]]:
    """The same where the knee is fitted from measured poses, repeated or not with other trials."""
    # Of single runs on `s192803` and `s192803_bundles`, insertions uncertain by 2 and 4 mm. However
    # many parameters there are, equilibria take most of the time.
    return {
        "fitting the knee": [0.5],
        LOOKING_LOWER: [2.4] + [0.9] * len(REACH_OF_HOPS),
        "scoring causes": [0.06] * 2,
        "trying causes": [0.02] * 8,
        "fitting causes": [SIMPLE] * 8,
        "choosing trials": [0.3],
        "telling what follows": [1.2],
        REPEATING: [2.5] * is_repeated,
    }


def _library(knee: Knee, laxity: Laxity) -> tuple[Effect, ...]:
    causes = library(knee, has_order=laxity.order is not None, has_phase=laxity.phase is not None)
    return causes_in_experiments(causes, laxity.protocol)


def _explained(
    base_fit: BaseFit, effects: Sequence[Effect], seed: int, executor: Executor
) -> tuple[Attribution, float]:
    """The explanation of what a fit leaves, and how probable so clear a misfit is."""
    base = without_causes(base_fit)
    beyond = insertions_beyond_prior(base.fitted)
    effects = [*effects, *beyond.causes]
    explained = partial(attribute, base, seed=seed, executor=executor)
    attribution = explained(effects)
    p_value = base.alarm_p_value(attribution.steps[0].scores.p_value)
    is_alarm = p_value <= LEVEL
    if not attribution.steps[0].is_significant and (is_alarm or beyond.causes):
        forced = explained(effects, is_forced=True)
        # An insertion beyond its prior is an alarm of its own where a cause explains it.
        if is_alarm or forced.best.causes:
            attribution, p_value = forced, p_value if is_alarm else beyond.p_value
    mounted = remounting_errors(base, attribution.best) if p_value <= LEVEL else None
    if mounted is None:
        return attribution, p_value
    return explained([*effects, mounted], is_forced=True), p_value


def better_start(attribution: Attribution) -> Array | None:
    """Ligament parameters from which the base model fits better than it did; None without any.

    A cause that has no size may have led the fit to a better minimum of the base model.
    """
    base, best = attribution.base.fitted, attribution.best.fitted
    if best is base:
        return None
    start, ends = best.theta[: attribution.base.n_base], [base.evaluation]
    again = best_fit_from(base.model, base.laxity, base.noise, [start], ends=ends)
    if again.evaluation.deviance > base.evaluation.deviance - LOWER:
        return None
    return again.theta[: base.model.n_ligament_parameters]


def trial_layout(laxity: Laxity) -> TrialLayout:
    """The layout of the trials on the map of misfit."""
    shown = as_shown(laxity.protocol)
    return TrialLayout(
        flexion_deg=shown.flexion_deg,
        loads=shown.loads,
        directions=SHORT_DIRECTIONS,
        coordinates=COORDINATES,
        is_measured=laxity.is_measured,
    )


def _unfinished(refit: Refit, which: str) -> list[Finding]:
    fitted = refit.fitted
    if fitted.outcome is Outcome.MINIMUM or refit.predicted_reduction < SMALL_REDUCTION:
        return []
    reduction = refit.predicted_reduction
    sentence = (
        f"The fit {which} did not reach its minimum, and the linear model predicts a misfit lower "
        f"by {reduction:.2g}: {fitted.outcome.sentence} Begin it elsewhere with --start."
    )
    values = {"explanation": refit.names, "promised_fall": reduction}
    return [finding("fit-unfinished", "starts", values, sentence=sentence)]
