"""Measured laxity and the model of it in units of the noise: what verbs of inference share."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from identknee.calibrate.fit import Fit, StartLike, fit, load_start
from identknee.calibrate.problem import (
    BELIEFS,
    Problem,
    RestrictedProblem,
    WhitenedResiduals,
    evidence_terms,
    restricted,
    with_all_priors,
    with_bounds,
    with_nuisance_priors,
)
from identknee.checks.fit_checks import (
    Fitted,
    bound_findings,
    check_fit,
    conditional_findings,
    feasibility_findings,
    idle_parameters,
    nuisance_findings,
    start_findings,
    unstated_misfit_findings,
)
from identknee.checks.usable_trials import (
    TrialSearch,
    blank_cell_findings,
    defined_everywhere,
    excluded_trial_findings,
    experiment_sentences,
    needs_weights,
    prediction_finding,
    starts_elsewhere,
    table_model,
    trial_names,
    with_other_terms,
)
from identknee.identify.optimum import (
    MOST_STARTS,
    REACH,
    EstimatedNoise,
    check_within_bounds,
    nuisance_estimates,
    sobol_around,
    with_estimated_noise,
)
from identknee.identify.optimum import best_fits as find_best_fits
from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.discrepancy import SmoothDiscrepancy, smooth_discrepancy
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import FreeParameters
from identknee.model.residuals import LaxityResiduals, has_shared_errors, with_shared
from identknee.runs.declare import Array, declared, entry
from identknee.runs.errors import NotComputable
from identknee.runs.executors import Executor
from identknee.runs.findings import Finding, Severity
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee
from identknee.subject.plausibility import limit_sentences
from identknee.verbs.values import (
    BoundsLike,
    DiscrepancyLike,
    NoiseLike,
    bounds_of,
    discrepancy_of,
    noise_of,
)
from identknee.verbs.verb import warm_up

# Simulations of a search that is only to tell whether it is the lowest. Of a measured knee with 104
# parameters 15 of 17 came within 4 of their last deviance in so many.
BRIEF = 100
# Fits after which a smooth error of the model is found again.
DISCREPANCY_ROUNDS = 2
# Of lengths and of angles [mm, deg].
Sizes = tuple[float | None, float | None]


@declared
class Identification:
    """Measured laxity and the model of it, ready to be asked what they determine."""

    knee: Knee = entry("The subject")
    laxity: Laxity = entry("The data, cells of trials without equilibrium blank")
    table: Laxity = entry("All of the data")
    model: LaxityModel = entry("The model under the protocol of the data")
    problem: Problem = entry("Residuals in units of their noise, over the parameters not fixed")
    everywhere: Problem = entry(
        "The same for searches that begin anywhere: where measured poses are known, a trial "
        "without equilibrium is held near its own"
    )
    free: FreeParameters = entry(
        "The parameters of the problem, and the values of those of the model that are fixed"
    )
    start: Array = entry("Where fits begin, shape ``(n,)``")
    degrees_of_freedom: int | None = entry(
        "Degrees of freedom of a noise estimated from the fit; None where the noise is stated"
    )
    estimated_noise: Sizes = entry(
        "Its standard deviation for lengths and for angles [mm, deg]; None where it is stated or "
        "no such coordinate was measured"
    )
    assumptions: tuple[str, ...] = entry("Assumptions, as sentences for the user")
    lost: tuple[Finding, ...] = entry(
        "Which measured trials have no equilibrium and blank cells in `laxity`, as findings",
        default=(),
    )
    discrepancy: SmoothDiscrepancy | None = entry(
        "The smooth error of the model that was marginalised; None for none", default=None
    )
    nuisances_at: tuple[Problem, Array] | None = entry(
        "Where the nuisances were marginalised: the problem that has them, and its best fit; "
        "None where they are among the parameters",
        default=None,
    )

    @property
    def trials_used(self) -> tuple[str, ...]:
        """Measured trials that answers rest on."""
        return trial_names(self.laxity)

    def findings_at(
        self, theta: Array, deviance: float, fits: Sequence[Fit] = ()
    ) -> tuple[Finding, ...]:
        """Findings about the best fit: table, misfit, bounds, other fits, model.

        Parameters
        ----------
        theta
            The best parameters of the problem, shape ``(n,)``.
        deviance
            Sum of squared residuals there, in units of their noise.
        fits
            All fits that it is the best of, nuisances among their parameters.
        """
        theta, parameters = np.asarray(theta), self.problem.parameters
        whole = self.free.expand(theta)
        # A ligament far from its prior, or a knee that is not plausible, is no misfit of the model.
        terms = evidence_terms(self.problem, theta)
        deviance -= sum(x.deviance for x in terms if x.name in BELIEFS)
        if self.degrees_of_freedom is None:
            n = self.laxity.n_values
            misfit = conditional_findings(deviance, n, int(parameters.is_of_interest.sum()))
        else:
            # That the noise was estimated is among the assumptions.
            left = unstated_misfit_findings(*self.estimated_noise)
            misfit = tuple(x for x in left if x.severity is not Severity.INFO)
        prediction = self.model.predict_once(whole)
        held_at = (*parameters.nuisance_names, *idle_parameters(self.model, prediction))
        bounds = bound_findings(theta, parameters, held_at)
        others = [*self.lost, *feasibility_findings(self.problem, theta)]
        if fits:
            thetas = np.array([x.theta for x in fits])
            deviances = 2.0 * np.array([x.objective for x in fits])
            others += start_findings(thetas, deviances, fits[0].parameters)
        others += nuisance_findings(*(self.nuisances_at or (self.problem, theta)))
        held = set(self.model.parameters.names) - set(parameters.names_of_interest)
        fitted = Fitted(
            model=self.model,
            laxity=self.laxity,
            table=self.table,
            start=self.free.expand(self.start),
            prediction=prediction,
            held=tuple(held),
            misfit=(*misfit, *bounds),
        )
        return check_fit(fitted, others)

    def uncertain_at(self, theta: Array) -> dict[str, Any]:
        """What an answer rests on: its trials, and what of geometry and tests is uncertain."""
        problem, best = self.nuisances_at or (self.problem, np.asarray(theta))
        nuisances = nuisance_estimates(problem, best)
        discrepancy = {} if self.discrepancy is None else {"discrepancy": self.discrepancy.words}
        return {
            "trials_used": self.trials_used,
            "evidence": evidence_terms(problem, best),
            "uncertainty": {**self.knee.uncertainty.words, **discrepancy},
            "nuisances": nuisances,
        }

    def free_index(self, name: str, option: str) -> int:
        """Where the parameter called `name` stands among those that vary.

        Raises
        ------
        ValueError
            If there is no such parameter, or `--fix` holds it.
        """
        index = self.model.parameters.index(name)
        if index not in self.free.free_indices:
            raise ValueError(
                f"{option} {name}: --fix holds this parameter; leave out one of the two"
            )
        return self.free.free_indices.index(index)


def identification(
    knee: Knee,
    laxity: Laxity,
    *,
    noise: NoiseLike = None,
    start: StartLike = "subject",
    fixed: Sequence[str] | None = None,
    bounds: BoundsLike = None,
    priors: bool = False,
    discrepancy: DiscrepancyLike = "none",
) -> Identification:
    """A knee and its laxity, checked and compared in units of the noise.

    Parameters
    ----------
    knee, laxity
        The subject and the data.
    noise
        Standard deviations of lengths and of angles [mm, deg], in place of those of the data: two
        numbers or a text such as ``0.5mm,0.5deg``.
    start
        Where fits begin: ``"subject"``, ``"IG1"`` to ``"IG4"``, or a TOML file.
    fixed
        Names of parameters held at the start.
    bounds
        Lower and upper bound by parameter name, or texts such as ``ACL.stiffness_kN=5:15``.
    priors
        Whether the priors of ligament parameters count, beside those of nuisances.
    discrepancy
        A smooth error of the model to average over: ``"none"``, ``"smooth"``, or the scales of its
        prior.

    Raises
    ------
    ValueError
        If an argument is wrong, or the data cannot say anything about the noise that they leave
        unstated.
    NotComputable
        If the noise is to be estimated and the model has no prediction at the start.
    """
    limits = bounds_of(bounds) if bounds else {}
    laxity = with_noise(laxity, noise)
    model, pattern = table_model(knee, laxity)
    knee = model.knee
    trials = TrialSearch(
        model=model,
        laxity=laxity,
        weighting="unit" if laxity.sd is None else "noise",
        bounds=limits,
        fixed=fixed or (),
    )
    theta = load_start(start, trials.problem(laxity).parameters)
    warm_up(knee, laxity.protocol)
    used = trials.used(theta)
    lost = excluded_trial_findings(knee, laxity, used.laxity)
    blanks = blank_cell_findings(laxity)
    laxity, theta = used.laxity, used.start
    residuals = LaxityResiduals(model=model, laxity=laxity, weighting=trials.weighting)
    scales = discrepancy_of(discrepancy)
    if scales is not None and residuals.weighting == "unit":
        raise ValueError(
            "an error of the model is marginalised only where the noise is stated; add --noise, "
            "for example --noise 0.5mm,0.5deg"
        )
    if has_shared_errors(knee.uncertainty) and residuals.weighting == "unit":
        raise ValueError(
            "zero, trial_flexion and surface can be uncertain only beside a stated noise; add "
            "--noise, for example --noise 0.5mm,0.5deg"
        )
    if has_shared_errors(knee.uncertainty) or needs_weights(laxity):
        held = (fixed or ()) if needs_weights(laxity) else ()
        first = fit(with_nuisance_priors(with_other_terms(residuals)), theta, fixed=held)
        if first.outcome is Outcome.START_FAILED:
            raise NotComputable(
                prediction_finding(residuals.model, residuals.laxity, theta).sentence
            )
        linear = replace(trials, laxity=laxity).linear_at(first.theta)
        laxity, residuals = linear.laxity, linear.residuals(linear.laxity)
    wrong: SmoothDiscrepancy | None = None
    if scales is not None:
        wrong = _discrepancy(residuals, theta, fixed or (), scales)
        residuals = with_shared(residuals, wrong.columns)
    part = restricted(with_bounds(with_other_terms(residuals), limits), fixed or (), theta)
    with_its_priors = with_all_priors if priors else with_nuisance_priors
    problem = everywhere = with_its_priors(part)
    if begins_at_poses := model.poses is not None or model.fallback_poses is not None:
        searched = with_bounds(defined_everywhere(residuals), limits)
        anywhere = restricted(searched, fixed or (), theta)
        everywhere = with_its_priors(anywhere)
    degrees: int | None = None
    sizes: Sizes = (None, None)
    asked = int(part.parameters.is_of_interest.sum())
    experiments = experiment_sentences(laxity)
    beliefs = limit_sentences(knee.plausibility)
    said = (knee.uncertainty.sentence, *beliefs, *experiments, *pattern, *used.sentences, *blanks)
    assumptions = [*said, *_data_findings(laxity, asked)]
    if wrong is not None:
        assumptions.append(wrong.sentence)
    if laxity.sd is None:
        estimate, sizes = _with_estimated_noise(part, residuals, theta)
        problem = with_all_priors(estimate.problem) if priors else estimate.problem
        degrees = estimate.degrees_of_freedom
        everywhere = problem
        if begins_at_poses:
            sds = np.array(sizes, float)[residuals.units]
            sds = np.r_[sds, np.full(laxity.n, sds.min())]
            everywhere = with_its_priors(WhitenedResiduals(problem=anywhere, sd=sds))
        shown = ", ".join(
            f"{sd:.3g} {unit}"
            for sd, unit in zip(sizes, ("mm", "deg"), strict=True)
            if sd is not None
        )
        assumptions.append(
            "The data state no noise: one standard deviation for lengths and one for angles was "
            f"estimated from the residuals of the best fit ({shown}, {degrees} degrees of "
            "freedom), and F thresholds are used."
        )
    return Identification(
        knee=knee,
        laxity=laxity,
        table=trials.laxity,
        model=model,
        problem=problem,
        everywhere=everywhere,
        free=part.free,
        start=part.free.restrict(theta),
        degrees_of_freedom=degrees,
        estimated_noise=sizes,
        assumptions=tuple(assumptions),
        lost=lost,
        discrepancy=wrong,
    )


def _discrepancy(
    residuals: LaxityResiduals, theta: Array, fixed: Sequence[str], scales: tuple[float, float]
) -> SmoothDiscrepancy:
    """The smooth error of the model at the fit that averages over it."""
    found, averaged = theta, residuals
    for _ in range(DISCREPANCY_ROUNDS):
        found = fit(with_nuisance_priors(with_other_terms(averaged)), found, fixed=fixed).theta
        plain = restricted(with_nuisance_priors(with_other_terms(residuals)), fixed, found)
        at = plain.free.restrict(found)
        wrong = smooth_discrepancy(residuals, -plain.residuals(at), plain.jacobian(at), scales)
        averaged = with_shared(residuals, wrong.columns)
    return wrong


def with_noise(laxity: Laxity, noise: NoiseLike) -> Laxity:
    """The data, their noise as stated where it is given.

    Raises
    ------
    ValueError
        If the noise is none, or the data state that of some coordinates only.
    """
    if noise is not None:
        mm, deg = noise_of(noise)
        sd = np.where(laxity.is_measured, np.array([mm] * 3 + [deg] * 2), np.nan)
        return replace(laxity, sd=sd)
    if laxity.sd is None:
        return laxity
    lacking = np.any(np.isnan(laxity.sd) & laxity.is_measured, axis=0).tolist()
    if any(lacking):
        columns = [f"sd_{x}" for x, lacks in zip(COORDINATES, lacking, strict=True) if lacks]
        raise ValueError(
            f"the data state the noise of some coordinates only: {', '.join(columns)} is missing. "
            "Add it, or state the noise of all with --noise, for example --noise 0.5mm,0.5deg"
        )
    return laxity


def best_fits(setup: Identification, *, seed: int, executor: Executor) -> tuple[Fit, ...]:
    """Fits from the start and from around it, the lowest first.

    Beside nuisances all but the lowest are brief: searches among so many parameters creep for
    hundreds of simulations, long after the lowest is known.

    Raises
    ------
    ValueError
        If the start lies outside the bounds.
    NotComputable
        If none of them found a prediction; it says which trials are to blame.
    """
    check_within_bounds(setup.start, setup.problem.parameters)
    budget = BRIEF if setup.problem.parameters.nuisance_names else None
    if setup.model.poses is None:
        points = sobol_around(
            setup.problem.parameters, setup.start, MOST_STARTS, reach=REACH, seed=seed
        )
    else:
        start = setup.free.expand(setup.start)
        points = setup.free.restrict(starts_elsewhere(setup.model, start, MOST_STARTS, seed=seed))
    try:
        fits = find_best_fits(
            setup.everywhere,
            start=setup.start,
            seed=seed,
            executor=executor,
            budget=budget,
            points=points,
        )
    except ValueError as error:
        raise no_prediction(setup) from error
    if not np.isfinite(setup.problem.residuals(fits[0].theta)).all():
        raise no_prediction(setup)
    return fits


def no_prediction(setup: Identification) -> NotComputable:
    """The error that no parameters near the start predict all measured trials; it names them."""
    return NotComputable(no_prediction_finding(setup).sentence)


def no_prediction_finding(setup: Identification) -> Finding:
    """The finding behind `no_prediction`."""
    return prediction_finding(setup.model, setup.laxity, setup.free.fixed_values)


def _with_estimated_noise(
    part: RestrictedProblem, residuals: LaxityResiduals, theta: Array
) -> tuple[EstimatedNoise, Sizes]:
    if not np.isfinite(residuals.residuals(theta)).all():
        raise NotComputable(prediction_finding(residuals.model, residuals.laxity, theta).sentence)
    # Where only lengths or only angles were measured there is one group.
    units, groups = np.unique(residuals.units, return_inverse=True)
    found = with_estimated_noise(part, groups, part.free.restrict(theta))
    sizes = dict(zip(units.tolist(), found.sds.tolist(), strict=True))
    return found, (sizes.get(0), sizes.get(1))


def _data_findings(laxity: Laxity, n_parameters: int) -> list[str]:
    n = laxity.n_values
    if not laxity.is_measured.any():
        raise ValueError("no coordinate was measured in any trial; fill in at least one column")
    if n >= n_parameters:
        return []
    sentence = (
        f"{n} measured values cannot determine {n_parameters} parameters: some intervals must be "
        "open. Measure more trials, or fix parameters with --fix."
    )
    return [sentence]
