"""What the model of a subject gets wrong in data, or what a protocol could show."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Unpack, overload

import numpy as np

from identknee.calibrate.fit import StartLike
from identknee.checks.broken_convention import convention_findings
from identknee.checks.data_noise import noise_of
from identknee.checks.fit_checks import implausible_findings
from identknee.checks.subject_checks import rim_findings
from identknee.checks.table_checks import (
    SuspiciousRow,
    columns_by_trial,
    end_point_findings,
    leave_one_out,
    suspicious_end_points,
    suspicious_rows,
    trial_findings,
    without_rows,
)
from identknee.checks.usable_trials import (
    TrialSelection,
    candidate_path_findings,
    excluded_trial_findings,
    knee_with_equilibria,
)
from identknee.diagnosis.base_fit import FURTHER, FurtherSearch, priors_set_aside, with_wider_priors
from identknee.diagnosis.believability import causes_under_limits
from identknee.diagnosis.investigation import (
    REPEATING,
    Investigation,
    investigate,
    work_from_poses,
    work_of,
)
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.protocol import zero_of_added_trials
from identknee.laxity.table import Laxity, TrialsLike, write_laxity
from identknee.model.effects.effect import OF, Effect
from identknee.model.laxity_model import LaxityModel
from identknee.model.limit_residuals import LimitResiduals
from identknee.model.parameters import STRAIN
from identknee.runs.files import PathLike, write_atomically
from identknee.runs.findings import Finding, finding, without_repeats
from identknee.runs.progress import planned, stage, whole_stage
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee, UncertainLike
from identknee.subject.plausibility import PlausibleLike
from identknee.verbs import options
from identknee.verbs.answer import has_priors
from identknee.verbs.diagnosis import Diagnosis, diagnosis_of, untestable
from identknee.verbs.identification import with_noise
from identknee.verbs.isolability import Isolability, isolability
from identknee.verbs.options import (
    Candidates,
    Data,
    ExtraStart,
    FitOptions,
    Noise,
    Priors,
    Seed,
    Subject,
    documented,
    trials_option,
)
from identknee.verbs.values import NoiseLike
from identknee.verbs.verb import Run, recorded_as, verb, warm_up

# Trials in which most misfit is left are named up to this number.
MOST_REPEATED = 3

Investigate = Callable[[Laxity], Investigation | None]


def rows_of(found: Investigation) -> list[SuspiciousRow]:
    """The trials that the other ones contradict, beside the best explanation of the misfit."""
    fitted = found.explanation.fitted
    noise, compared, measured = fitted.noise, fitted.compared, fitted.laxity.is_measured
    # Nuisances are parameters with a prior here: marginalised they would tie all trials together.
    own, at, k = noise.alone, fitted.evaluation, noise.nuisances.shape[1]
    n, n_table = fitted.n_data, fitted.n_coordinates
    trials, coordinates = np.nonzero(measured)
    units = own.whiten(np.eye(measured.shape[1])[coordinates])
    rows = np.concatenate(
        [own.whiten(-compared.residuals(at.theta)), -at.residuals[n:], np.zeros(k)]
    )
    jacobian = np.block(
        [
            [own.whiten(np.hstack([compared.jacobian(at.theta), noise.nuisances]))],
            [at.jacobian[n:], np.zeros((len(at.residuals) - n, k))],
            [np.zeros((k, at.theta.size)), np.eye(k)],
        ]
    )
    columns = columns_by_trial(units, measured)
    columns.resize(len(rows), n_table)
    return suspicious_rows(leave_one_out(rows, jacobian, columns), trials, coordinates)


def row_findings(found: Investigation, again: Investigate) -> tuple[Finding, ...]:
    """The rows that the fit contradicts, with the verdict that the other trials have."""
    rows = rows_of(found)
    if not rows:
        return ()
    it = "it" if len(rows) == 1 else "these trials"
    with whole_stage(REPEATING):
        rest = again(without_rows(found.laxity, rows))
    then = _verdict(rest, found, f"Without {it}")
    return trial_findings(rows, found.laxity, "trial-against-fit", then=then)


def _contradicted(
    run: Run, noise: NoiseLike, found: Investigation, again: Investigate
) -> tuple[Finding, ...]:
    """The trials that the table contradicts, with the verdict with them beside those kept."""
    names = () if run.trials is None else run.trials.contradicted
    if run.trials is None or not names:
        return ()
    whole = with_noise(run.trials.with_contradicted, noise)
    is_used = found.laxity.is_measured.any(axis=1) | np.isin(found.laxity.protocol.trials, names)
    whole = whole.without(~is_used)
    rows = [x for x in suspicious_end_points(whole) if whole.protocol.trials[x.trial] in names]
    if not rows:
        return ()
    with whole_stage(REPEATING):
        rest = again(whole)
    then = _verdict(rest, found, f"With {'it' if len(rows) == 1 else 'them'}")
    return trial_findings(rows, whole, "trial-against-course", then=then, is_left_out=True)


def _verdict(
    rest: Investigation | None, found: Investigation, start: str
) -> tuple[str, dict[str, object]]:
    """The verdict on other trials as a sentence, and as values."""
    if rest is None:
        return f"{start} the data cannot be tested.", {"verdict": Verdict.NOT_TESTABLE.value}
    verdict, causes = rest.conclusion.verdict.value, [*rest.explanation.names]
    names = f" ({' and '.join(causes)})" if causes else ""
    still = "still " if rest.conclusion.verdict is found.conclusion.verdict else ""
    why = " ".join(rest.conclusion.reasons)
    values: dict[str, object] = {"verdict": verdict, "causes": causes}
    return f"{start} the verdict is {still}{verdict}{names}. {why}", values


def implausible_explanation(found: Investigation) -> tuple[Finding, ...]:
    """What the best explanation says of contact, forces and strains that no knee has."""
    fitted = found.explanation.fitted
    model = fitted.compared.model
    prediction = model.predict_once(fitted.theta)
    return (
        *rim_findings(model.protocol.trials, prediction),
        *implausible_findings(model, prediction),
    )


def advice_findings(found: Investigation) -> tuple[Finding, ...]:
    """That no trial can be advised, where some should be, and what to ask for instead."""
    verdict = found.conclusion.verdict
    if found.advice is not None or verdict not in (Verdict.AMBIGUOUS, Verdict.UNEXPLAINED):
        return ()
    if verdict is Verdict.AMBIGUOUS:
        sentence = (
            "No trial can be recommended: the causes that are left differ in nothing that a "
            "load could show, or the model has no equilibrium in the trials that could be added."
        )
        return (finding("no-trial-advised", "trials", sentence=sentence),)
    # What would help where nothing explains the misfit: repeats, and errors known better.
    fitted, trials = found.explanation.fitted, found.laxity.protocol.trials
    left = np.nansum((fitted.differences / found.noise.sd) ** 2, axis=1)
    worst = [trials[i] for i in np.argsort(-left, kind="stable")[:MOST_REPEATED]]
    values: dict[str, object] = {"trials": worst}
    sentence = (
        "No trial can be recommended: nothing explains the misfit, so there are no explanations "
        f"that a trial could tell apart. Most of it is left in {', '.join(worst)}: measure these "
        "again, to separate errors of a trial from properties of the knee."
    )
    if fitted.nuisance_groups:
        farthest = min(fitted.nuisance_groups, key=lambda x: x.p_value)
        values["nuisances"] = farthest.name
        sentence += (
            f" Of what is stated as uncertain, {farthest.name} has the least probable estimate "
            "under its prior: measure it."
        )
    return (finding("no-trial-advised", "trials", values, sentence=sentence),)


SET_ASIDE = (
    "Priors of the reference strains do not count: the data contradict them, and without them "
    "noise explains what the fit leaves."
)
EXTENDED, FITTED, ADVICE = "extended", "fitted.toml", "advised_trials.csv"


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
    priors: Priors = None,
    seed: Seed = 0,
    **_: Unpack[FitOptions],
) -> Diagnosis:
    """`identknee.diagnose` of data."""
    laxity = with_noise(data, noise)
    # Limits do not enter the verdict: they are prior belief, not evidence of the data.
    limits, subject = subject.plausibility, replace(subject, plausibility=())
    warm_up(subject, laxity.protocol)
    run.start_clock()
    model = LaxityModel(knee=subject, protocol=laxity.protocol)
    # Refuses a limit that names no ligament before the long diagnosis.
    LimitResiduals(model=model, limits=limits)
    if conventions := convention_findings(model, laxity, model.parameters.start):
        return untestable(conventions[0].sentence, conventions)
    asked = model.parameters.names_of_interest
    stated = with_wider_priors(subject, model.parameters, asked, wider=1.0).priors
    if not has_priors("diagnose", priors):
        subject = with_wider_priors(subject, model.parameters, asked)
    knee, used = knee_with_equilibria(subject, laxity.without_forces(), start)
    # Strains at which trials have no equilibrium may be placeholders: no prior knowledge.
    strains = tuple(x for x in asked if x.endswith(STRAIN) and used.is_moved)
    search = replace(FURTHER, doubted=strains if has_priors("diagnose", priors) else ())
    kept = _with_forces(knee, laxity, used)
    lost = excluded_trial_findings(subject, laxity, kept)
    asked_of = partial(
        investigate, effects=effects, seed=seed, executor=run.executor, search=search
    )
    from_poses = model.with_tests(kept).poses is not None
    is_repeated = run.trials is not None and bool(run.trials.contradicted)
    work = work_from_poses(is_repeated=is_repeated) if from_poses else work_of(model.parameters.n)
    with planned("diagnosing", work):
        found = asked_of(knee, kept)
        if found is None:
            return untestable(
                _reason_untestable(knee, laxity), (*lost, *end_point_findings(laxity))
            )
        with stage("telling what follows"):
            answer = diagnosis_of(found)
        fitted, own = found.base.fitted, LaxityModel(knee=knee, protocol=laxity.protocol).parameters
        run.priors_set_aside = priors_set_aside(fitted.model.parameters, own)
        # Other trials of the same knee are fitted from where these were, under the same priors.
        at = dict(zip(fitted.model.parameters.names, fitted.theta.tolist(), strict=True))
        are_wide = bool(search.doubted) and set(search.doubted) <= set(run.priors_set_aside)
        priors_then = fitted.model.knee.priors if are_wide else knee.priors
        same = replace(knee, fitted=at, priors=priors_then)
        again = partial(asked_of, same, search=FurtherSearch(from_poses=False, doubted=()))
        answer = replace(
            answer,
            trials_used=used.names,
            under_limits=causes_under_limits(
                found, limits, stated, seed=seed, executor=run.executor
            )
            if limits
            else (),
            assumptions=(
                *answer.assumptions,
                *used.sentences,
                *((SET_ASIDE,) if are_wide else ()),
                *(
                    ()
                    if found.advice is None
                    else candidate_path_findings(found.explanation.fitted.model)
                ),
            ),
            findings=without_repeats(
                (
                    *lost,
                    *_contradicted(run, noise, found, again),
                    *row_findings(found, again),
                    *implausible_explanation(found),
                    *answer.findings,
                    *advice_findings(found),
                )
            ),
        )
    if run.out is not None:
        _write_extended(found, run.out)
    return answer


def _write_extended(found: Investigation, out: Path) -> None:
    """Write the subject with the causes found, where it was fitted, and the trials advised."""
    folder = write_subject(found.extended_knee, out / EXTENDED)
    lines = ["# Where the fit of the extended model lies: --start of other verbs."]
    for owner, values in found.explanation.fitted_values.items():
        # A cause of one rig has a name that TOML takes in quotes alone.
        table = f'["{owner}"]' if OF in owner else f"[{owner}]"
        lines += ["", table, *(f"{name} = {value!r}" for name, value in values.items())]
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
            out / ADVICE,
        )


def _with_forces(knee: Knee, laxity: Laxity, used: TrialSelection) -> Laxity:
    """The trials used, with the forces of those that have an equilibrium."""
    if not laxity.has_forces:
        return used.laxity
    model = LaxityModel(knee=knee, protocol=laxity.protocol).with_tests(laxity)
    begin = np.array(model.parameters.start)
    begin[: used.start.size] = used.start
    is_lost = laxity.is_measured.any(axis=1) & ~used.laxity.is_measured.any(axis=1)
    only_forces = ~laxity.is_measured.any(axis=1)
    is_lost |= only_forces & ~model.predict(begin, derivatives=False).is_converged
    return laxity.without(is_lost)


ADVISED = "Trials advised by identknee diagnose: measure, fill in, append to the data."


def _reason_untestable(knee: Knee, laxity: Laxity) -> str:
    if noise_of(laxity, laxity.coordinates) is None:
        return (
            "The data state no noise and their load curves are too short to show it: state it with "
            "--noise, for example --noise 0.3mm,0.3deg."
        )
    n_parameters = LaxityModel(knee=knee, protocol=laxity.protocol).parameters.n
    if (n_values := int(laxity.is_measured.sum())) <= n_parameters:
        return (
            f"{n_values} measured values cannot test a model of {n_parameters} parameters, as no "
            "degree of freedom is left for a misfit. Measure more trials."
        )
    return (
        "No parameters near the subject's have a prediction in every measured trial. See: "
        f"identknee subject check; or leave the cells of such trials of {knee.name} blank."
    )


@overload
def diagnose(
    subject: options.SubjectLike,
    data: options.LaxityLike,
    *,
    protocol: None = None,
    noise: NoiseLike = None,
    uncertain: UncertainLike = None,
    start: StartLike = "subject",
    effects: Sequence[Effect] | None = None,
    priors: bool | None = None,
    keep: Sequence[str] | None = None,
    leave_out: Sequence[str] | None = None,
    plausible: PlausibleLike = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: options.Workers = 1,
) -> Diagnosis: ...
@overload
def diagnose(
    subject: options.SubjectLike,
    data: None = None,
    *,
    protocol: TrialsLike,
    noise: str | float | tuple[float, float],
    uncertain: UncertainLike = None,
    out: PathLike | None = None,
    seed: int = 0,
    workers: options.Workers = 1,
) -> Isolability: ...
@documented
def diagnose(
    subject: options.GivenSubject,
    data: options.GivenData = None,
    *,
    protocol: Annotated[
        TrialsLike | None,
        trials_option(
            "Instead of {DATA}: find out what planned trials could show, given {--noise}. The "
            "trials: {}."
        ),
    ] = None,
    noise: options.Noise = None,
    uncertain: options.Uncertain = None,
    start: options.ExtraStart = "subject",
    effects: options.Candidates = None,
    priors: options.Priors = None,
    keep: options.Keep = None,
    leave_out: options.LeaveOut = None,
    plausible: options.Plausible = None,
    out: options.Out = None,
    seed: options.Seed = 0,
    workers: options.Workers = 1,
) -> Diagnosis | Isolability:
    """What the model of a subject gets wrong in the data, and which physical cause it has.

    The verdict is ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED or NOT_TESTABLE. With it come the other
    causes that would fit, and the trials that would tell them apart. The folder extended holds the
    subject with the causes found, for use with every other command. With {--protocol} instead of
    {DATA}, it says which causes such trials could show and tell apart.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do.
    NotComputable
        If the subject has no prediction in any trial of the protocol.
    """
    if (data is None) == (protocol is None):
        raise ValueError(
            "diagnose needs either DATA.csv or --protocol; give one of the two, for example "
            "identknee diagnose reference --protocol seed63 --noise 0.3mm,0.3deg"
        )
    if data is not None:
        return diagnose_data(
            subject,
            data,
            noise=noise,
            uncertain=uncertain,
            start=start,
            effects=effects,
            priors=priors,
            keep=keep,
            leave_out=leave_out,
            plausible=plausible,
            out=out,
            seed=seed,
            workers=workers,
        )
    if plausible is not None:
        raise ValueError("--plausible compares causes by data; leave it out with --protocol")
    if noise is None or protocol is None:
        raise ValueError("--protocol needs --noise; add for example --noise 0.3mm,0.3deg")
    return isolability(
        subject, protocol, noise, uncertain=uncertain, out=out, seed=seed, workers=workers
    )
