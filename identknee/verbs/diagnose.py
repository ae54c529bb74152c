"""What the model of a subject gets wrong in measured laxity, and which physical cause it has."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from identknee.checks.contradicted_trials import end_point_findings
from identknee.checks.conventions import convention_findings
from identknee.checks.usable_trials import (
    candidate_path_findings,
    excluded_trial_findings,
    knee_with_equilibria,
)
from identknee.diagnosis.data_noise import noise_of
from identknee.diagnosis.investigation import Investigation, investigate, work_of
from identknee.diagnosis.missing_line import LineEnds, LineFinding
from identknee.diagnosis.refit import Refit, Rival, RivalState
from identknee.diagnosis.verdict import Estimate, Verdict, causes_of, ligament_estimates
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity, write_laxity
from identknee.laxity.zero_conventions import zero_of_added_trials
from identknee.model.laxity_model import LaxityModel
from identknee.runs.files import write_atomically
from identknee.runs.findings import Finding, without_repeats
from identknee.runs.progress import planned, stage
from identknee.subject.effect_choice import EffectChoice
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import (
    WRENCH,
    AddedEffect,
    AddedVariable,
    Comparison,
    Diagnosis,
    Explanation,
    LineFound,
    Misfit,
    NoiseFound,
    Residuals,
    RivalFound,
    StepScores,
    TrialWrench,
    advice_findings,
    gain_found,
    implausible_explanation,
    with_contradictory_trials,
    without_contradictory_trials,
)
from identknee.verbs.identification import with_noise
from identknee.verbs.options import Candidates, Data, ExtraStart, KneeOptions, Noise, Seed, Subject
from identknee.verbs.values import advised, trials_of
from identknee.verbs.verb import Run, recorded_as, verb, warm_up

EXTENDED, FITTED, ADVICE = "extended", "fitted.toml", "advised_trials.csv"
# From N mm to N·m, for the components of a wrench.
WRENCH_UNITS = np.array([0.001, 0.001, 1.0, 1.0, 1.0])


@verb
@recorded_as("diagnose")
def diagnose_data(
    run: Run,
    subject: Subject,
    data: Data,
    *,
    noise: Noise = None,
    start: ExtraStart = "subject",
    effects: Candidates = None,
    seed: Seed = 0,
    **_: Unpack[KneeOptions],
) -> Diagnosis:
    """`identknee.diagnose` of data."""
    laxity = with_noise(data, noise)
    warm_up(subject, laxity.protocol)
    run.start_clock()
    model = LaxityModel(knee=subject, protocol=laxity.protocol)
    if conventions := convention_findings(model, laxity, model.parameters.start):
        return untestable(conventions[0].sentence, conventions)
    checked = without_contradictory_trials(laxity)
    knee, used = knee_with_equilibria(subject, checked, start)
    kept = used.laxity
    lost = excluded_trial_findings(subject, checked, kept)
    # Stiffness there as well: the knee has its strains already, and trials may hang on both.
    is_own = np.array_equal(used.start, model.parameters.start)
    begin = [] if is_own else [used.start[: model.n_ligament_parameters]]
    with planned("diagnosing", work_of(model.parameters.n)):
        found = investigate(knee, kept, starts=begin, effects=effects, seed=seed)
        if found is None:
            return untestable(
                _reason_untestable(knee, laxity), (*lost, *end_point_findings(laxity))
            )
        with stage("telling what follows"):
            answer = diagnosis_of(found)
    compared = Comparison(knee=knee, starts=begin, effects=effects, seed=seed)
    answer = replace(
        answer,
        trials_used=used.names,
        assumptions=(
            *answer.assumptions,
            *used.sentences,
            *(
                ()
                if found.advice is None
                else candidate_path_findings(found.explanation.fitted.model)
            ),
        ),
        findings=without_repeats(
            (
                *lost,
                *compared.table_findings(found, with_contradictory_trials(kept, laxity)),
                *compared.row_findings(found),
                *implausible_explanation(found),
                *answer.findings,
                *advice_findings(found),
            )
        ),
    )
    if run.out is not None:
        folder = write_subject(found.extended_knee, run.out / EXTENDED)
        lines = ["# Where the fit of the extended model lies: --start of other verbs."]
        for owner, values in found.explanation.fitted_values.items():
            lines += ["", f"[{owner}]", *(f"{name} = {value!r}" for name, value in values.items())]
        write_atomically(folder / FITTED, "\n".join(lines) + "\n")
        if found.advice is not None:
            write_laxity(
                Laxity(
                    protocol=found.advice.trials,
                    coordinates=np.full(
                        (found.advice.trials.n, found.laxity.coordinates.shape[1]), np.nan
                    ),
                    zero=zero_of_added_trials(found.laxity.zero),
                    comments=(ADVISED,),
                ),
                run.out / ADVICE,
            )
    return answer


def untestable(reason: str, findings: tuple[Finding, ...] = ()) -> Diagnosis:
    """The answer where the data cannot be tested, with what they say against themselves."""
    verdict = Verdict.NOT_TESTABLE
    return Diagnosis(
        verdict=verdict, sentence=verdict.sentence, reasons=(reason,), findings=findings
    )


ADVISED = "Trials advised by identknee diagnose: measure, fill in, append to the data."


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
        effects={x.name: x for x in found.exclusions},
        trials=trials_of(found.laxity),
        residuals=Residuals(
            before=base.fitted.differences, after=best.fitted.differences, sd=found.noise.sd
        ),
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


def _reason_untestable(knee: Knee, laxity: Laxity) -> str:
    if noise_of(laxity, laxity.coordinates) is None:
        return (
            "The data state no noise and their load curves are too short to show it: state it with "
            "--noise, for example --noise 0.3mm,0.3deg."
        )
    return (
        "No parameters near the subject's have a prediction in every measured trial. See: "
        f"identknee subject check; or leave the cells of such trials of {knee.name} blank."
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
    flexion = np.broadcast_to(found.laxity.protocol.flexion_deg[:, None], measured.shape)
    return AddedVariable(
        name=candidate.name,
        variant=candidate.variant,
        score=candidate.score,
        expected=(signature.projected @ candidate.amplitude)[: fitted.n_data],
        left=step.test.projector.project(fitted.residual_rows())[: fitted.n_data],
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
