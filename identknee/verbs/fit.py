"""One parameter set fitted from one start, with findings."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Literal, Unpack

import numpy as np
from scipy.special import stdtrit

from identknee.calibrate.agreement import Agreement
from identknee.calibrate.fit import (
    DEGREES,
    Fit,
    StartLike,
    fit_student,
    load_start,
    start_word,
    student_scales,
)
from identknee.calibrate.fit import fit as search
from identknee.calibrate.problem import (
    ROUNDING,
    Problem,
    evaluate,
    evidence_terms,
    misfit_square,
    with_all_priors,
)
from identknee.checks.ambiguous_translations import refitted_translations_findings
from identknee.checks.fit_checks import (
    ComparedForces,
    Fitted,
    agreement_findings,
    bound_findings,
    check_fit,
    check_unfitted,
    compared_forces,
    conditional_findings,
    distinct_ends,
    idle_parameters,
    misfit_findings,
    start_findings,
    term_agreement,
    too_few_findings,
    unstated_misfit_findings,
)
from identknee.checks.left_out_trials import named_trials
from identknee.checks.limit_price import PlausibilityPrice, plausibility_price
from identknee.checks.missing_restraint import missing_restraint_findings
from identknee.checks.usable_trials import (
    TrialSearch,
    TrialSelection,
    excluded_trial_findings,
    input_findings,
    residuals_of,
    starts_elsewhere,
    table_model,
    unfitted_findings,
    with_other_terms,
)
from identknee.identify.optimum import (
    MOST_STARTS,
    N_STARTS,
    nuisance_estimates,
    with_fits_from,
)
from identknee.laxity.protocol import ABSOLUTE
from identknee.laxity.table import (
    COORDINATES,
    ROTATIONS,
    TRANSLATIONS,
    Laxity,
    LaxityError,
    laxity_rmse,
)
from identknee.mechanics.equilibria import Continuation
from identknee.model.candidate_laxity import continued_from_own_poses
from identknee.model.effects.effect import is_error_of_rig
from identknee.model.effects.library import choice_of
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.mechanics_inputs import poses_of
from identknee.model.nuisances import contact_rounding
from identknee.model.prediction import Prediction
from identknee.model.quantities import AT, TENSION
from identknee.runs.declare import (
    OF_COORDINATE,
    OF_PARAMETER,
    Array,
    BoolArray,
    array,
    declared,
    derived,
    entry,
)
from identknee.runs.errors import ValueRefused
from identknee.runs.findings import Finding
from identknee.runs.record import Outcome
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.subject.plausibility import limit_sentences
from identknee.verbs import options
from identknee.verbs.answer import has_priors
from identknee.verbs.identification import BRIEF, with_noise
from identknee.verbs.options import option
from identknee.verbs.simulate import SimulatedLaxity, TrialEnd, simulated
from identknee.verbs.values import bounds_of, by_ligament
from identknee.verbs.verb import Run, verb, warm_up

LEVEL = 0.9
ROUNDS = 20


@declared
class HeldValue:
    """A measured value that the fit did not see, and its prediction."""

    trial: str = entry("Name of the trial")
    coordinate: str = entry("Name of the coordinate")
    measured: float = entry("Measured value", unit=OF_COORDINATE)
    predicted: float = entry("Predicted value; null where the model has none", unit=OF_COORDINATE)
    sd: float = entry(
        "Standard deviation of the prediction, to first order: of noise as large as the fit left, "
        "of parameters and of stated errors",
        unit=OF_COORDINATE,
    )


@declared
class HeldOut:
    """What a fit predicts of the trials that were kept from it."""

    values: tuple[HeldValue, ...] = entry("The measured values of these trials")
    degrees_of_freedom: float = entry("Of the noise that the fit left", unit="1")

    @property
    @derived("Names of the trials")
    def trials(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(x.trial for x in self.values))

    @property
    @derived("Trials in which the model has no prediction")
    def lost(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(x.trial for x in self.values if np.isnan(x.predicted)))

    @property
    @derived("Root-mean-square error by coordinate", unit=OF_COORDINATE)
    def rmse(self) -> dict[str, float]:
        """Root-mean-square error of the values predicted, by coordinate."""
        return {
            name: float(np.sqrt(np.mean(own**2)))
            for name in COORDINATES
            if (own := self._errors([x for x in self.values if x.coordinate == name])).size
        }

    @property
    @derived("Share of the values predicted that lie in their 90 % intervals", unit="1")
    def within_90(self) -> float:
        """Share of the values predicted that lie in their 90 % intervals; NaN without any."""
        reach = stdtrit(self.degrees_of_freedom, 0.5 + 0.5 * LEVEL)
        known = [x for x in self.values if not np.isnan(x.predicted)]
        if not known:
            return float("nan")
        return float(np.mean([abs(x.predicted - x.measured) <= reach * x.sd for x in known]))

    @staticmethod
    def _errors(values: Sequence[HeldValue]) -> Array:
        errors = np.array([x.predicted - x.measured for x in values])
        return np.asarray(errors[~np.isnan(errors)])


def split(laxity: Laxity, held_out: Sequence[str]) -> tuple[Laxity, BoolArray]:
    """The data with the cells of the trials held out blank, and which these are, shape ``(n,)``.

    Raises
    ------
    ValueError
        If no trial is called so, none is left, or coordinates are not absolute.
    """
    if held_out and laxity.zero != ABSOLUTE:
        raise ValueError(
            "--hold-out predicts absolute coordinates, and those of the table count from the zero "
            f"{laxity.zero}; leave cells blank instead"
        )
    held = named_trials(laxity, held_out, "--hold-out")
    if not (laxity.is_measured.any(axis=1) & ~held).any():
        why = "no coordinate of the table is measured; fill in what was"
        if held.any():
            why = "--hold-out leaves no trial to fit to; hold out fewer"
        raise ValueError(why)
    return laxity.without(held), held


def predicted(
    knee: Knee, fitted: tuple[Problem, Laxity, Array], measured: Laxity, fixed: Sequence[str]
) -> HeldOut:
    """What the fitted knee predicts of trials, without using their measured poses.

    Parameters
    ----------
    knee
        The subject with the parameters, errors and poses of the fit.
    fitted
        The problem of the fit, in residuals of its data, those data, and where it ended.
    measured
        The trials held out.
    fixed
        Parameters that were not fitted.
    """
    problem, data, theta = fitted
    covariance, noise, degrees = prediction_uncertainty(problem, data, theta, fixed)
    model = LaxityModel(
        knee=knee, protocol=measured.protocol, order=measured.order, phase=measured.phase
    )
    found = continued_from_own_poses(model, theta).predict(theta)
    spread = np.einsum("nip,pq,niq->ni", found.slopes, covariance, found.slopes)
    if residuals_of(problem).weighting == "noise" and measured.sd is not None:
        noise = noise * measured.sd
    sd = np.sqrt(spread + noise**2)
    values = tuple(
        HeldValue(
            trial=measured.protocol.trials[i],
            coordinate=COORDINATES[j],
            measured=float(measured.coordinates[i, j]),
            predicted=float(found.coordinates[i, j]),
            sd=float(sd[i, j]),
        )
        for i, j in np.argwhere(measured.is_measured).tolist()
    )
    return HeldOut(values=values, degrees_of_freedom=degrees)


def prediction_uncertainty(
    problem: Problem, data: Laxity, theta: Array, fixed: Sequence[str] = ()
) -> tuple[Array, Array, float]:
    """Covariance of the parameters, noise by coordinate (5,), its degrees of freedom.

    The noise of lengths and that of angles are what the fit leaves over their own degrees of
    freedom, in the unit of the residuals: mm and deg, or the stated noise. A parameter without a
    prior is known to lie within its bounds.
    """
    parameters, at = problem.parameters, evaluate(problem, theta)
    is_angle = np.isin(np.nonzero(data.is_measured)[1], np.arange(5)[ROTATIONS]).astype(int)
    n, residuals = is_angle.size, at.residuals[: is_angle.size]
    free = ~np.isin(parameters.names, list(fixed))
    weak = np.diag(np.sqrt(12.0) / (parameters.upper - parameters.lower))
    rows = np.vstack([at.jacobian[n:], weak[parameters.is_of_interest]])[:, free]
    jacobian, size = at.jacobian[:n, free], np.ones(2)
    known = rows.T @ rows
    for _ in range(ROUNDS):
        scaled = jacobian / size[is_angle][:, None]
        covariance = np.linalg.inv(scaled.T @ scaled + known)
        left = 1.0 - np.einsum("ip,pq,iq->i", scaled, covariance, scaled)
        degrees = np.maximum(np.bincount(is_angle, weights=left, minlength=2), 1.0)
        squares = np.bincount(is_angle, weights=residuals**2, minlength=2)
        size = np.where(squares > 0.0, np.sqrt(squares / degrees), 1.0)
    whole = np.zeros((parameters.n, parameters.n))
    whole[np.ix_(free, free)] = covariance
    noise = np.empty(len(COORDINATES))
    noise[TRANSLATIONS], noise[ROTATIONS] = size
    return whole, noise, float(degrees.sum())


# Values with a weight below the first number are named, at most as many as the second.
LIGHT, MOST_FAR = 0.5, 6


def fit_student_errors(
    plain: Callable[..., Fit], problem: Problem, start: Array, fixed: Sequence[str]
) -> Fit:
    """A fit whose errors have heavy tails."""
    return fit_student(problem, residuals_of(problem).units, start, partial(plain, fixed=fixed))


def heavy_tail_findings(problem: Problem, laxity: Laxity, found: Fit) -> tuple[str, ...]:
    """The scales of errors with heavy tails, and the values that count least."""
    if not np.isfinite(found.objective):
        return ()
    data = residuals_of(problem)
    scales, weights = student_scales(data, data.units, found.theta)
    units = ("mm", "deg") if data.weighting == "unit" else ("sd of lengths", "sd of angles")
    shown = " and ".join(
        f"{scales[k]:.2g} {unit}" for k, unit in enumerate(units) if np.any(data.units == k)
    )
    trials, coordinates = np.nonzero(laxity.is_measured)
    light = [k for k in np.argsort(weights)[:MOST_FAR].tolist() if weights[k] < LIGHT]
    least = ", ".join(
        f"{COORDINATES[coordinates[k]].rpartition('_')[0].replace('_', ' ')} of "
        f"{laxity.protocol.trials[trials[k]]} ({weights[k]:.2f})"
        for k in light
    )
    counted = f" Values with the smallest weights: {least}." if least else ""
    sentence = (
        f"Errors were modelled as Student's t with {DEGREES:.0f} degrees of freedom and a scale of "
        f"{shown}, estimated with the parameters.{counted}"
    )
    return (sentence,)


@declared
class Optimum:
    """Another parameter set that fits about as well."""

    theta: Array = array("Where the search ended", "parameter", unit=OF_PARAMETER)
    rise: float = entry("Deviance above that of the fit, in units of the noise", unit="1")
    quantity: str = entry("The ligament force that differs most from that of the fit")
    force_N: float = entry("That force here", unit="N")  # noqa: N815 - the unit
    force_at_fit_N: float = entry("That force at the fit", unit="N")  # noqa: N815 - the unit


def _optima(model: LaxityModel, fits: Sequence[Fit], scale: float) -> tuple[Optimum, ...]:
    """The ends of other searches that fit as well at the 95 % level, each once."""
    made: list[Optimum] = []
    best, *others = distinct_ends(fits, scale)
    at_fit = tensions_of(model, model.predict(best.theta, derivatives=False))
    for other in others:
        forces = tensions_of(model, model.predict(other.theta, derivatives=False))
        apart = np.nan_to_num(np.abs(forces - at_fit))
        trial, ligament = np.unravel_index(int(np.argmax(apart)), apart.shape)
        owner, where = model.knee.ligaments[ligament].name, model.protocol.trials[trial]
        made.append(
            Optimum(
                theta=other.theta,
                rise=(other.deviance - best.deviance) / scale,
                quantity=f"{owner}.{TENSION}{AT}{where}",
                force_N=float(forces[trial, ligament]),
                force_at_fit_N=float(at_fit[trial, ligament]),
            )
        )
    return tuple(made)


def _origin(best: Fit, start: Array) -> str:
    if np.array_equal(best.start, start):
        return "the given start"
    return "another start: one of the Sobol points, or a hop from where another search ended"


def _scale(trials: TrialSearch, laxity: Laxity, found: Fit) -> float:
    """Variance of the residuals: 1 where they are in units of a stated noise."""
    if trials.weighting == "noise":
        return 1.0
    n_free = int(found.parameters.is_of_interest.sum()) - len(found.fixed)
    degrees = max(int(laxity.is_measured.sum()) - n_free, 1)
    return max(found.deviance / degrees, ROUNDING)


# The subject as fitted, in the folder of the results.
FITTED = "fitted"
Weighting = Literal["unit", "noise"]
Likelihood = Literal["normal", "student"]


@declared
class Calibration(SimulatedLaxity):
    """One parameter set fitted to measured laxity, and the laxity it predicts."""

    start: str = entry("Start of the search, as it was asked for")
    search: Fit = entry("The search", group="optimization")
    data: Laxity = entry("The measured laxity", group="observed_data")
    rmse: LaxityError = entry("Root-mean-square error of the predicted laxity")
    origin: str = entry("Where the search began that ended lowest", default="the given start")
    optima: tuple[Optimum, ...] = entry(
        "Other ends that fit as well at the 95 % level", rows="optimum", group="optima", default=()
    )
    plausibility: PlausibilityPrice | None = entry(
        "Limits of plausibility at the fit and what they cost; none where none count",
        default=None,
    )
    agreement: Agreement | None = entry(
        "Whether experiments, states and forces agree; null where the data have one term",
        default=None,
    )
    compared_forces: ComparedForces | None = entry(
        "Measured forces, and what the fit predicts of them",
        group="compared_forces",
        only="measured forces",
        default=None,
    )
    held_out: HeldOut | None = entry(
        "Trials kept from the fit, and what it predicts of them", only="`--hold-out`", default=None
    )

    @property
    @derived("How the search ended")
    def outcome(self) -> Outcome:
        return self.search.outcome

    @property
    @derived("How the search ended, as a sentence")
    def sentence(self) -> str:
        return self.search.message

    @property
    @derived("Half the sum of squared residuals", unit="mm2 and deg2, or 1 with noise weighting")
    def objective(self) -> float:
        return self.search.objective

    @property
    @derived("Simulations made by the search", unit="1")
    def n_simulations(self) -> int:
        return self.search.n_simulations

    @property
    @derived("The optimizer")
    def method(self) -> str:
        return self.search.method

    @property
    @derived("Parameters begun at, by ligament and quantity", unit=OF_PARAMETER)
    def start_parameters(self) -> dict[str, dict[str, float]]:
        return by_ligament(dict(zip(self.parameter_names, self.search.start.tolist(), strict=True)))

    @property
    @derived("Names of parameters at a bound")
    def at_bounds(self) -> tuple[str, ...]:
        return self.search.at_bounds

    @property
    @derived("Measured trials in which the model has no prediction", only="a trial lost")
    def trials_without_equilibrium(self) -> tuple[TrialEnd, ...]:
        measured = np.any(self.data.is_measured, axis=1).tolist()
        return tuple(
            x
            for x, is_measured in zip(self.trials, measured, strict=True)
            if is_measured and x.outcome is not Outcome.CONVERGED
        )


@verb
def fit(
    run: Run,
    subject: options.Subject,
    data: options.Data,
    *,
    start: Annotated[
        StartLike,
        option(
            "Where the search starts: subject (its own values), IG1 to IG4 of the paper, or a file "
            "ending in .toml.",
            in_python=options.VALUES,
            typed=str,
        ),
    ] = "subject",
    method: options.Method = "least-squares",
    budget: Annotated[
        int | None, option("Largest number of simulations; 2,500 if not given.")
    ] = None,
    weighting: Annotated[
        Weighting,
        option(
            "How errors are weighted. unit: in mm and deg, as in equation 6 of the paper. noise: "
            "divided by the {sd_} columns. Always noise with {--noise}, and where {sd_} columns "
            "stand beside forces, several experiments or limits of plausibility.",
        ),
    ] = "unit",
    noise: options.Noise = None,
    likelihood: Annotated[
        Likelihood,
        option(
            "normal: least squares. student: errors with heavy tails and an estimated scale, so "
            "that values far off count little."
        ),
    ] = "normal",
    priors: options.Priors = None,
    fixed: Annotated[
        Sequence[str] | None,
        option(
            "Hold this parameter at its start.",
            "--fix",
            in_python="A list of names.",
            metavar="NAME",
        ),
    ] = None,
    bounds: options.Bounds = None,
    hold_out: Annotated[
        Sequence[str] | None,
        option(
            "Keep this trial from the fit and predict it, with intervals. * stands for any "
            "letters, as in 'Internal*'.",
            in_python="A list of names.",
            metavar="TRIAL",
        ),
    ] = None,
    more_starts: Annotated[
        int,
        option(
            "At most so many further searches by least squares, from points around the start or, "
            "from measured poses, by the stretch of ligaments; the lowest end is the fit. They "
            "begin in groups of 16 until four have ended there. 0 for the search from the start "
            "alone.",
            least=0,
        ),
    ] = MOST_STARTS,
    continuation: Annotated[Continuation, options.LOAD_STEPS] = "continuation",
    seed: options.Seed = 0,
    **_: Unpack[options.FitOptions],
) -> Calibration:
    """One parameter set fitted to measured laxity: the lowest end of a few searches.

    Writes the fitted parameters, the error that is left and how the search ended to result.json.
    The folder fitted holds the subject with the parameters and errors found, for use with other
    commands.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do. That the model has no
        prediction at the start is no error: the outcome says it.
    """
    measured = data
    if noise is not None:
        measured, weighting = with_noise(measured, noise), "noise"
    elif measured.sd is not None and (
        measured.has_forces or measured.protocol.experiments or subject.plausibility
    ):
        # Only in units of the noise can forces, limits and rigs of different noise be added.
        weighting = "noise"
    laxity, is_held = split(measured, hold_out or ())
    model, pattern = table_model(subject, laxity, continuation)
    trials = TrialSearch(
        model=model, laxity=laxity, weighting=weighting, bounds=bounds_of(bounds), fixed=fixed or ()
    )
    theta = load_start(start, trials.problem(laxity).parameters)
    warm_up(subject, laxity.protocol)
    run.start_clock()
    is_with_priors = has_priors("fit", priors)
    plain = partial(search, method=method, seed=seed, budget=budget, priors=is_with_priors)
    is_robust = likelihood == "student"
    if is_robust and laxity.has_forces:
        raise ValueRefused(
            "heavy tails are of coordinates alone", "leave out the columns of forces"
        )
    used, found = trials.fitted(theta, partial(fit_student_errors, plain) if is_robust else plain)
    if found.outcome is not Outcome.START_FAILED and not is_robust:
        trials, used, found = _fit_again(trials, used, found, plain)
        laxity = trials.laxity
    problem = trials.problem(used.laxity)
    fits: tuple[Fit, ...] = (found,)
    without: tuple[Fit, ...] = ()
    if more_starts and not is_robust and method == "least-squares":
        points = starts_elsewhere(model, used.start, more_starts, seed=seed)
        further = partial(
            with_fits_from,
            executor=run.executor,
            budget=BRIEF if problem.parameters.nuisance_names else budget,
        )
        fits, without = _fits_from(trials, used, found, points, plain, further)
        # The lowest of all may hold every trial at its measured pose.
        fits = fits if np.isfinite(problem.residuals(fits[0].theta)).all() else (found,)
        found = replace(fits[0], start=theta)
    prediction = model.predict(found.theta, derivatives=False)
    error = laxity_rmse(
        Laxity(protocol=laxity.protocol, coordinates=prediction.coordinates), laxity
    )
    held = None
    if found.outcome is not Outcome.START_FAILED:
        knee = extended_by_fit(model, prediction)
        if run.out is not None:
            write_subject(knee, run.out / FITTED)
        if is_held.any():
            kept = measured.select(is_held)
            of_values = replace(trials, shared=None).problem(used.laxity)
            held = predicted(knee, (of_values, used.laxity, found.theta), kept, fixed or ())
    tails = heavy_tail_findings(problem, used.laxity, found) if is_robust else ()
    whole = with_all_priors(problem) if is_with_priors else problem
    price = None
    if np.isfinite(found.objective):
        price = plausibility_price(
            whole,
            partial(trials.problem_everywhere, used.laxity),
            [x.theta for x in (*fits, *without)],
            search=partial(search, seed=seed, budget=budget, fixed=trials.fixed),
            executor=run.executor,
        )
    compared = None
    if weighting == "noise" and not is_robust and np.isfinite(found.objective):
        ends = [x.theta for x in fits[1:]]
        compared = term_agreement(whole, used.laxity, found.theta, ends=ends, seed=seed)
    return Calibration(
        **simulated(model, prediction),
        start=start_word(start),
        search=found,
        data=replace(laxity, is_definition_stated=True),
        rmse=error,
        trials_used=() if found.outcome is Outcome.START_FAILED else used.names,
        origin=_origin(fits[0], used.start),
        optima=_optima(model, fits, _scale(trials, used.laxity, found)),
        held_out=held,
        compared_forces=None
        if found.outcome is Outcome.START_FAILED
        else compared_forces(problem, found.theta),
        evidence=evidence_terms(whole, found.theta),
        plausibility=price,
        agreement=compared,
        assumptions=(
            *input_findings(subject, measured),
            *limit_sentences(subject.plausibility),
            *pattern,
            *used.sentences,
            *tails,
        ),
        uncertainty=subject.uncertainty.words,
        nuisances=() if np.isinf(found.objective) else nuisance_estimates(problem, found.theta),
        findings=_findings(trials, used, fits, prediction, error, agreement_findings(compared)),
    )


def _fit_again(
    trials: TrialSearch, used: TrialSelection, found: Fit, search_from: Callable[..., Fit]
) -> tuple[TrialSearch, TrialSelection, Fit]:
    """A fit with errors linearised at the first fit; the first fit where there are none."""
    linear, start = trials.linear_at(found.theta), found.start
    if linear is trials:
        return trials, used, found
    # The end of a fit with exact zeros may lie in a valley of its own.
    used, found = linear.fitted(found.theta if linear.shared is None else start, search_from)
    return linear, used, replace(found, start=start)


def _fits_from(
    trials: TrialSearch,
    used: TrialSelection,
    found: Fit,
    points: Array,
    search_from: Callable[..., Fit],
    further: Callable[..., tuple[Fit, ...]],
) -> tuple[tuple[Fit, ...], tuple[Fit, ...]]:
    """Fits from other points, the lowest first, and those without limits where limits count."""
    without: tuple[Fit, ...] = ()
    if trials.model.knee.plausibility:
        # The price is relative to the best fit without limits; one more search begins there.
        plain = trials.without_limits.problem_everywhere(used.laxity)
        without = further(plain, search_from(plain, used.start, fixed=trials.fixed), points)
        points = np.vstack([without[0].theta, points[:N_STARTS]])
    everywhere = trials.problem_everywhere(used.laxity)
    return further(everywhere, replace(found, start=used.start), points), without


def extended_by_fit(model: LaxityModel, prediction: Prediction) -> Knee:
    """The subject of a fit with all that was found: parameters, effects, errors and poses.

    Ligaments keep the values that the subject came with, on which priors are centred. Errors of a
    rig among several, and cuts, are none of the knee's.
    """
    knee, parameters, theta = model.knee, model.parameters, prediction.theta
    choices = [
        choice_of(knee, x, theta[[parameters.index(name) for name in x.parameters.names]])
        for x in model.effects
        if not is_error_of_rig(x)
    ]
    return replace(
        knee.with_effects(choices),
        fitted=dict(zip(parameters.names, theta.tolist(), strict=True)),
        poses=() if model.poses is None else poses_of(model.protocol, prediction.coordinates),
        contact_rounding_mm=contact_rounding(knee),
    )


def _findings(
    trials: TrialSearch,
    used: TrialSelection,
    fits: Sequence[Fit],
    prediction: Prediction,
    error: LaxityError,
    others: tuple[Finding, ...],
) -> tuple[Finding, ...]:
    """Findings about a fit, the first of several, beside others about it."""
    found = fits[0]
    model, table, laxity = trials.model, trials.laxity, used.laxity
    lost = excluded_trial_findings(model.knee, table, laxity)
    if found.outcome is Outcome.START_FAILED:
        return check_unfitted(model, table, (*lost, *unfitted_findings(laxity, prediction)))
    n_free = int(found.parameters.is_of_interest.sum()) - len(found.fixed)
    if laxity.sd is not None and not np.isnan(laxity.sd[laxity.is_measured]).any():
        weighted = replace(trials, weighting="noise").residuals(laxity)
        square = misfit_square(with_other_terms(weighted), found.theta)
        judged = square, laxity.n_values, n_free
        misfit = misfit_findings(*judged) or conditional_findings(*judged)
    else:
        misfit = unstated_misfit_findings(error.mm, error.deg)
    held = (*found.fixed, *found.parameters.nuisance_names)
    # A ligament that carries nothing is named as such.
    idle = idle_parameters(model, prediction)
    fitted = Fitted(
        model=model,
        laxity=laxity,
        table=table,
        start=found.start,
        prediction=prediction,
        held=held,
        misfit=(*misfit, *bound_findings(found.theta, found.parameters, (*held, *idle))),
    )
    few = too_few_findings(laxity.n_values, n_free)
    scale = _scale(trials, laxity, found)
    starts = start_findings(
        np.array([x.theta for x in fits]),
        np.array([x.deviance for x in fits]) / scale,
        found.parameters,
    )
    defined = refitted_translations_findings(trials, laxity, fits, scale)
    missing = missing_restraint_findings(model, table, prediction, error)
    return check_fit(fitted, (*lost, *missing, *few, *starts, *defined, *others))
