"""Checks of a fit: misfit, bounds, starts, forces that no knee has; and all checks in one pass."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from identknee.calibrate.agreement import Agreement, agreement
from identknee.calibrate.fit import Fit
from identknee.calibrate.problem import (
    BELIEFS,
    TABLE_TERM,
    Problem,
    SumOfTerms,
    evaluate,
    innermost,
    typical_steps,
)
from identknee.checks.broken_convention import convention_findings
from identknee.checks.subject_checks import rim_findings, stability_findings
from identknee.checks.table_checks import (
    GROSS,
    IMPROBABLE,
    MOST_DEG,
    MOST_MM,
    end_point_findings,
    frame_findings,
    load_findings,
    load_sign_findings,
    row_findings,
)
from identknee.checks.usable_trials import residuals_of
from identknee.identify.binomial_interval import Proportion, share
from identknee.identify.optimum import group_name, nuisance_estimates, nuisance_groups
from identknee.identify.posterior.posterior import newton_kernel
from identknee.laxity.forces import RESULTANT, WRENCH
from identknee.laxity.protocol import LOADS, dominant_loads
from identknee.laxity.table import Laxity
from identknee.laxity.trial_words import load_words
from identknee.model.contact_loads import compartment_forces
from identknee.model.effects.facts import cause_label
from identknee.model.force_residuals import ForceResiduals, SuperpositionResiduals
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import (
    strains_of,
    structure_names,
    tensions_of,
    values_of_structures,
)
from identknee.model.parameters import STIFFNESS, STRAIN, Parameters
from identknee.model.prediction import Prediction
from identknee.runs.declare import OF_QUANTITY, Array, IntArray, array, declared, entry
from identknee.runs.findings import Finding, Severity, finding, without_repeats
from identknee.runs.words import (
    PLAIN,
    amount,
    error_words,
    label_without_unit,
    listed,
    two_values_words,
    unit_of,
)
from identknee.subject.plausibility import (
    BUTLER,
    FAILURE_PCT,
    OTHER_NAMES,
    strengths_by_name,
)


@declared
class ComparedForces:
    """Forces that were measured in trials, and their predictions by a model."""

    names: tuple[str, ...] = entry(
        "What was measured, such as `ACL.tension_N`, `contact.medial_N` or, of a replayed path, "
        "`ACL.force_x_N` and `ACL.insitu_N`",
    )
    trials: tuple[str, ...] = entry("Trial of each")
    measured: Array = array("Values measured", "force_value", unit=OF_QUANTITY)
    sd: Array = array(
        "Standard deviation of their errors, those of a replayed pose included",
        "force_value",
        unit=OF_QUANTITY,
    )
    predicted: Array = array("Values at the fit", "force_value", unit=OF_QUANTITY)


def compared_forces(problem: Problem, theta: Array) -> ComparedForces | None:
    """The forces of a problem at theta; None where none was measured."""
    whole = innermost(problem)
    terms = whole.terms.values() if isinstance(whole, SumOfTerms) else ()
    names: list[str] = []
    trials: list[str] = []
    columns = [np.zeros((3, 0))]
    for term in terms:
        if isinstance(term, ForceResiduals):
            measured, values, sd = term.forces.is_measured, term.forces.values, term.forces.sd
            of_row = term.model.protocol.trials
            labels = [term.forces.names] * len(of_row)
        elif isinstance(term, SuperpositionResiduals):
            made, sd = term.superposition, term.sd
            measured, values, of_row = made.is_measured, made.values, made.trials
            labels = [tuple(f"{cut}.{x}" for x in (*WRENCH, RESULTANT)) for cut in made.cut]
        else:
            continue
        places = np.argwhere(measured).tolist()
        names += [labels[i][k] for i, k in places]
        trials += [of_row[i] for i, _ in places]
        columns.append(np.array([x[measured] for x in (values, sd, term.predicted(theta))]))
    if not names:
        return None
    values, sds, predictions = np.hstack(columns)
    return ComparedForces(
        names=tuple(names),
        trials=tuple(trials),
        measured=values,
        sd=sds,
        predicted=predictions,
    )


# P-value below which terms are said to disagree.
LEVEL = 0.01
# Fewest values of a term.
LEAST_VALUES = 5
# Most ends of other searches from which fits to single terms begin.
MOST_STARTS = 3


def rows_by_term(problem: Problem, laxity: Laxity) -> dict[str, IntArray]:
    """Indices of the residuals of each experiment (or state, if there is one experiment) and force.

    Empty if several experiments or states share an error: whitening then mixes their residuals.

    Parameters
    ----------
    problem
        A problem with residuals in units of the noise.
    laxity
        Its data.
    """
    protocol, inner = laxity.protocol, innermost(problem)
    trials = np.nonzero(laxity.is_measured)[0]
    several = len(set(protocol.experiment_names)) > 1
    labels = protocol.experiment_names if several else protocol.states
    shared = residuals_of(problem).shared
    if shared is not None and _is_across(shared, labels):
        return {}
    of = np.array(labels, object)[trials]
    found = {name: np.flatnonzero(of == name) for name in dict.fromkeys(labels)}
    if len(found) == 1:
        found = {TABLE_TERM: next(iter(found.values()))}
    if isinstance(inner, SumOfTerms):
        ends = np.cumsum(inner.sizes)
        # Beliefs about a knee are no measurements, so they cannot disagree with one.
        names = [x for x in inner.terms if x not in BELIEFS]
        found |= {name: np.arange(ends[i - 1], ends[i]) for i, name in enumerate(names) if i > 0}
    return {name: rows for name, rows in found.items() if rows.size >= LEAST_VALUES}


def _is_across(shared: Array, labels: Sequence[str]) -> bool:
    """Whether an error (n, 5, k) reaches trials of several labels."""
    _, number = np.unique(labels, return_inverse=True)
    reached = np.any(np.nan_to_num(shared) != 0.0, axis=1)
    return any(np.unique(number[column]).size > 1 for column in reached.T)


def term_agreement(
    problem: Problem,
    laxity: Laxity,
    theta: Array,
    *,
    ends: Sequence[Array] = (),
    seed: int = 0,
) -> Agreement | None:
    """Whether the terms of a fit agree; None if there is only one.

    Parameters
    ----------
    problem, laxity
        The problem of the fit, and its data.
    theta
        The best fit.
    ends
        Ends of other searches. Fits to single terms begin there and at the problem's start too.
    seed
        Seed of the draws.
    """
    terms = rows_by_term(problem, laxity)
    if len(terms) < 2:
        return None
    starts = [x for x in ends if np.isfinite(problem.residuals(x)).all()][:MOST_STARTS]
    begin = problem.parameters.start
    if np.isfinite(problem.residuals(begin)).all():
        starts.append(begin)
    return agreement(problem, theta, terms, starts=starts, seed=seed)


def agreement_findings(found: Agreement | None) -> tuple[Finding, ...]:
    """A finding if terms differ by more than chance explains."""
    if found is None or found.p_value >= LEVEL:
        return ()
    worst = found.worst
    values = {
        "terms": ", ".join(x.name for x in found.terms),
        "difference": found.difference,
        "p_value": found.p_value,
        "worst": worst.name,
        "rise": worst.rise,
    }
    return (finding("terms-disagree", "data", values),)


# Share of a parameter's range within which it counts as at a bound.
AT_END = 1e-6
# Rise of the deviance within which a fit is as good (95 % quantile of chi-square with one degree of
# freedom), and within which it is the same minimum.
AS_GOOD, SAME = 3.84, 0.1
# Typical steps (3 kN, 2 %) from which on two parameter sets differ.
APART = 0.1
MISTAKES = "check signs, units and side of the data; otherwise the model may lack something"
# Share of the objective, and objective: ends that are the same, also where a search stops early.
ALIKE, ROUNDING = 1e-3, 1e-9
N_DRAWS = 100
# Share of the draws without prediction that is reported.
NOTEWORTHY = 0.02
# Probability of a misfit by noise alone below which intervals are conditional on it.
REJECTED = 0.05
# P-value below which the distance from a prior is reported: that of 3 standard deviations of a
# normal value, with Bonferroni's correction for all groups or ligaments.
BEYOND_PRIOR = 0.0027
TINY = 1e-12  # avoids a division by zero


def misfit_probability(square: float, n_values: int, n_parameters: int) -> float:
    """Probability that noise of the stated size leaves so much misfit or more.

    1 where it cannot be judged: without a degree of freedom or a prediction.
    """
    degrees = n_values - n_parameters
    if degrees < 1 or not np.isfinite(square):
        return 1.0
    return float(chdtrc(degrees, square))


def conditional_findings(square: float, n_values: int, n_parameters: int) -> tuple[Finding, ...]:
    """Findings if data and priors of nuisances reject a fit, so that its intervals are conditional.

    A misfit that `misfit_findings` calls improbable is not reported twice; a gross one is reported
    too.

    Parameters
    ----------
    square, n_values, n_parameters
        As in `misfit_findings`.
    """
    p = misfit_probability(square, n_values, n_parameters)
    if p >= REJECTED:
        return ()
    values = {"n": n_values, "deviance": square, "p": p, "command": "identknee diagnose"}
    more = misfit_findings(square, n_values, n_parameters)
    gross = (x for x in more if x.severity is Severity.ERROR)
    return (finding("conditional-on-misfit", "data", values), *gross)


def distinct_ends(fits: Sequence[Fit], scale: float = 1.0) -> tuple[Fit, ...]:
    """The ends that fit as well as the first, each once.

    Parameters
    ----------
    fits
        Searches, the lowest first.
    scale
        Variance of the residuals.
    """
    lowest, *others = fits
    steps, asked = typical_steps(lowest.parameters), lowest.parameters.is_of_interest
    known = [lowest]
    for other in others:
        away = [np.max(np.abs((other.theta - x.theta) / steps)[asked]) for x in known]
        if (other.deviance - lowest.deviance) / scale <= AS_GOOD and min(away) > APART:
            known.append(other)
    return tuple(known)


def misfit_findings(square: float, n_values: int, n_parameters: int) -> tuple[Finding, ...]:
    """A finding if the misfit is larger than noise of the stated size explains.

    Parameters
    ----------
    square
        Sum of the squared residuals in units of their noise. Infinity, where there is no
        prediction, gives no finding.
    n_values, n_parameters
        Values measured, and parameters fitted to them.
    """
    if misfit_probability(square, n_values, n_parameters) >= IMPROBABLE:
        return ()
    degrees = n_values - n_parameters
    ratio = square / degrees
    sentence = (
        f"The best fit leaves {ratio:.3g} times the misfit that noise of the stated size would "
        f"(chi-square {square:.4g} with {degrees} degrees of freedom): {MISTAKES}, or the noise is "
        "larger, and nothing said here allows for that. See: identknee diagnose"
    )
    code = "misfit-gross" if ratio > GROSS else "misfit-improbable"
    values = {"ratio": ratio, "chi_square": square, "degrees_of_freedom": degrees}
    return (finding(code, "data", values, sentence=sentence),)


def too_few_findings(n_values: int, n_parameters: int) -> tuple[Finding, ...]:
    """A finding if fewer values were measured than parameters are fitted to them."""
    if n_values >= n_parameters:
        return ()
    said = "1 value was" if n_values == 1 else f"{n_values} values were"
    sentence = (
        f"Only {said} measured for {n_parameters} free parameters: many other parameter sets fit "
        "just as well. Measure more trials, or fix parameters with --fix."
    )
    values = {"n_values": n_values, "n_parameters": n_parameters}
    return (finding("too-few-values", "data", values, sentence=sentence),)


def unstated_misfit_findings(mm: float | None, deg: float | None) -> tuple[Finding, ...]:
    """A finding for data without stated noise; another if the misfit exceeds errors of instruments.

    Parameters
    ----------
    mm, deg
        Root-mean-square residual; None or NaN where no coordinate in this unit was measured.
    """
    sizes = {
        f"rmse_{unit}": size
        for size, unit, most in ((mm, "mm", MOST_MM), (deg, "deg", MOST_DEG))
        if size is not None and size > most
    }
    if not sizes:
        return (finding("noise-unstated", "data"),)
    said = " and ".join(amount(size, unit_of(name)) for name, size in sizes.items())
    sentence = (
        f"The best fit leaves {said}, more than the expected error of a laxity test "
        f"({MOST_MM:g} mm, {MOST_DEG:g} deg): {MISTAKES}. See: identknee diagnose"
    )
    return (finding("error-large", "data", sizes, sentence=sentence),)


def bound_findings(
    theta: Array, parameters: Parameters, fixed: Sequence[str] = ()
) -> tuple[Finding, ...]:
    """A finding if fitted parameters lie at a bound, so that the bound limits the fit."""
    margin = AT_END * (parameters.upper - parameters.lower)
    standing = [
        (name, float(end))
        for name, value, low, high, near in zip(
            parameters.names, theta, parameters.lower, parameters.upper, margin, strict=True
        )
        for end in (low, high)
        if abs(value - end) <= near and name not in fixed and low < high
    ]
    if not standing:
        return ()
    many = "1 parameter stands" if len(standing) == 1 else f"{len(standing)} parameters stand"
    said = [f"{label_without_unit(name)} ({amount(end, unit_of(name))})" for name, end in standing]
    sentence = (
        f"{many} at a bound, where the bound limits the fit, not the data: "
        f"{listed(said)}. The other parameters compensate for it."
    )
    values = {"parameters": [x for x, _ in standing], "bounds": [x for _, x in standing]}
    return (finding("at-bound", "parameters", values, sentence=sentence),)


def parameters_at_zero(theta: Array, parameters: Parameters) -> tuple[str, ...]:
    """Names of the parameters at a lower bound of zero, where a structure or effect is absent."""
    zero = (theta <= 0.0) & (parameters.lower == 0.0)
    return tuple(x for x, is_zero in zip(parameters.names, zero, strict=True) if is_zero)


def start_findings(thetas: Array, deviances: Array, parameters: Parameters) -> tuple[Finding, ...]:
    """A finding if fits from several starts do not agree.

    Parameters
    ----------
    thetas
        Where each fit ended, shape ``(k, p)``.
    deviances
        Sum of squared residuals there in units of their noise, inf without a prediction,
        shape ``(k,)``.
    parameters
        What was fitted.
    """
    k = len(deviances)
    if k < 2 or not np.isfinite(deviances).any():
        return ()
    best = int(np.argmin(deviances))
    rises = deviances - deviances[best]
    # Fits may differ in nuisances and still agree: only parameters of interest are compared.
    asked = parameters.is_of_interest
    away = np.max((np.abs(thetas - thetas[best]) / typical_steps(parameters))[:, asked], axis=1)
    rivals = np.flatnonzero((rises <= AS_GOOD) & (away > APART))
    if rivals.size:
        farthest = rivals[int(np.argmax(away[rivals]))]
        rise = rises[farthest]
        # The two parameters that differ most in typical steps, and both values in words.
        theta, other = thetas[best], thetas[farthest]
        size = np.abs(other - theta) / typical_steps(parameters) * parameters.is_of_interest
        most = np.argsort(-size)[: min(2, int(parameters.is_of_interest.sum()))]
        names = [parameters.names[i] for i in most]
        apart = [two_values_words(parameters.names[i], theta[i], other[i]) for i in most]
        sentence = (
            f"Starts disagree: {rivals.size} of {k} ended at other parameters that also fit at "
            f"the 95 % level ({listed(apart)}; misfit higher by {rise:.2g}). "
            "A profile interval spans both."
        )
        values = {"n_starts": k, "n_apart": rivals.size, "rise": rise, "parameters": names}
        return (finding("starts-disagree", "starts", values, sentence=sentence),)
    if np.count_nonzero(rises <= SAME) > 1:
        return ()
    others = rises[np.isfinite(rises) & (rises > SAME)]
    next_best = (
        f" (the next lowest misfit is higher by {others.min():.3g})"
        if others.size
        else " and no other had a prediction"
    )
    sentence = (
        f"Only one of {k} starts ended at the lowest misfit{next_best}: a lower one may exist. "
        "See: identknee sweep"
    )
    values = {"n_starts": k, "rise_of_next": others.min() if others.size else None}
    return (finding("lowest-found-once", "starts", values, sentence=sentence),)


def infeasible_proportion(
    problem: Problem, theta: Array, *, n_draws: int = N_DRAWS, seed: int = 0
) -> Proportion:
    """Proportion of parameter sets that fit about as well as `theta` and have no prediction.

    The sets are drawn from the normal density around theta with the precision of data and priors,
    and clipped to the bounds.

    Raises
    ------
    ValueError
        If the model has no prediction at `theta`.
    """
    parameters = problem.parameters
    evaluation = evaluate(problem, theta)
    if not evaluation.is_finite:
        raise ValueError("the model has no prediction at these parameters; fit them first")
    kernel = newton_kernel(evaluation, parameters)
    draws = np.random.default_rng(seed).standard_normal((n_draws, parameters.n))
    steps = np.linalg.solve(kernel.factor.T, draws.T).T
    thetas = parameters.from_working(parameters.to_working(evaluation.theta) + steps)
    inside = np.clip(thetas, parameters.lower, parameters.upper)
    return share(sum(not np.isfinite(problem.residuals(x)).all() for x in inside), n_draws)


def feasibility_findings(problem: Problem, theta: Array) -> tuple[Finding, ...]:
    """A finding if parameter sets near a fit have no prediction, which cuts intervals off."""
    lost = infeasible_proportion(problem, theta)
    if lost.value < NOTEWORTHY:
        return ()
    return (finding("sets-without-prediction", "model", {"n": lost.n, "n_lost": lost.count}),)


def nuisance_findings(
    problem: Problem, theta: Array, *, hint: str = " See: identknee diagnose"
) -> tuple[Finding, ...]:
    """A finding for each group of nuisances that lies beyond its prior.

    Parameters
    ----------
    problem, theta
        As in `identknee.identify.optimum.nuisance_estimates`.
    hint
        Where a reader finds more, as the end of the sentence.
    """
    groups = nuisance_groups(problem, theta)
    found = []
    estimates = nuisance_estimates(problem, theta)
    for group in groups:
        if group.p_value * len(groups) >= BEYOND_PRIOR:
            continue
        own = [x for x in estimates if group_name(x.name) == group.name]
        farthest = max(own, key=lambda x: abs(x.value - x.center) / max(x.scatter, TINY))
        moved = farthest.value - farthest.center
        unit, where = shift_words(farthest.name)
        together = f" for its {group.n} values together" * (group.n > 1)
        sentence = (
            f"The fit moves the {error_words(group.name)} beyond its stated uncertainty: by "
            f"{amount(moved, unit)}{where}, where an error stated to "
            f"{amount(farthest.prior_sd, unit)} leaves at most "
            f"{amount(2.0 * farthest.scatter, unit)} in 95 % of fits (p = {group.p_value:.2g}"
            f"{together}). The stated uncertainty is too small, or there is another cause"
            f".{hint}"
        )
        values = {
            "nuisance": farthest.name,
            "moved": moved,
            "prior_sd": farthest.prior_sd,
            "scatter": farthest.scatter,
            "unit": unit,
            "n_together": group.n,
            "p_value": group.p_value,
        }
        found.append(finding("nuisance-beyond-prior", group.name, values, sentence=sentence))
    return tuple(found)


def shift_words(name: str) -> tuple[str, str]:
    """Unit of a nuisance, and words for its component, such as an axis.

    Examples
    --------
    >>> shift_words("insertion.ACL_femur_x_mm"), shift_words("load_gain.varus_moment")
    (('mm', ' along x'), ('1', ' in varus moment'))
    >>> shift_words("robot/load_cell.moment_z_Nm")
    ('N·m', ' about z')
    """
    *words, last = name.rpartition(".")[2].split("_")
    unit = unit_of(name) or PLAIN
    what = words if unit != PLAIN else [*words, last]
    if what[0] == "ln":
        return unit, " in its logarithm"
    if what[-1] in ("x", "y", "z"):
        return unit, f" {'along' if unit in ('mm', 'N') else 'about'} {what[-1]}"
    return unit, "" if what == ["offset"] else f" in {' '.join(what)}"


# Times the mean strength from which a force is implausible: no specimen is that strong.
BEYOND = 2.0
# Difference between the compartments [N] above which contact is one-sided, if the lighter one also
# has less than this share. In balanced knees without varus moment they differ by up to 67 N.
APART_N, LEAST_SHARE = 400.0, 0.1
CONTACT_SOURCE = "balanced knees: within 67 N, Gustke 2014, doi:10.1016/j.arth.2013.10.020"
# A ligament is idle if its load is at most this share of the load at its prior in the same poses,
# and the latter is at least this large [N]: no laxity test can tell smaller loads.
IDLE_SHARE, LEAST_LOAD_N = 0.05, 10.0
IDLE = "ligament-idle"
# Loads are taken for those of another unit if there are at least so many ligaments, their mean
# stiffness is so many times the stated one, and the ratios differ by at most such a factor.
LEAST_LIGAMENTS, MANY_TIMES, ALIKE_TIMES = 3, 5.0, 4.0
VARUS, DISTRACTION = LOADS.index("varus_moment_Nm"), LOADS.index("distraction_force_N")


@declared
class LigamentLoad:
    """The largest load of a ligament, its bundles together, and that at its prior."""

    name: str = entry("Name of the ligament or of its group")
    members: tuple[str, ...] = entry("Names of its lines")
    force_N: float = entry("Largest tension in any trial [N]")  # noqa: N815 - newton
    prior_force_N: float = entry("The same at its prior, in the same poses [N]")  # noqa: N815

    @property
    def is_idle(self) -> bool:
        """Whether the ligament carries next to nothing, but would carry a load at its prior."""
        return (
            self.prior_force_N >= LEAST_LOAD_N and self.force_N <= IDLE_SHARE * self.prior_force_N
        )


def ligament_loads(model: LaxityModel, prediction: Prediction) -> tuple[LigamentLoad, ...]:
    """The load of every ligament in a prediction; empty where no trial has an equilibrium."""
    if not prediction.is_converged.any():
        return ()
    n = model.n_ligament_parameters
    prior = np.r_[model.parameters.center[:n], prediction.theta[n:]]
    member = np.asarray(model.tied.member)
    own, expected = (
        np.nanmax(tensions_of(model, x) @ member, axis=0)
        for x in (prediction, replace(prediction, theta=prior))
    )
    names = [x.name for x in model.knee.ligaments]
    return tuple(
        LigamentLoad(
            name=name,
            members=tuple(np.array(names)[member[:, k] != 0.0].tolist()),
            force_N=float(own[k]),
            prior_force_N=float(expected[k]),
        )
        for k, name in enumerate(model.tied.names)
    )


def ligament_findings(model: LaxityModel, prediction: Prediction) -> tuple[Finding, ...]:
    """Findings on ligaments that carry nothing, and on others that are far from their prior.

    The distance from the prior is that of stiffness and reference strain together, and is reported
    if it is as improbable as 3 standard deviations, corrected for the number of ligaments.
    """
    p, found = model.parameters, list[Finding]()
    n = model.tied.n
    away = (p.to_working(prediction.theta) - p.to_working(p.center)) / p.prior_sd
    for k, load in enumerate(ligament_loads(model, prediction)):
        chance = float(chdtrc(2.0, away[k] ** 2 + away[n + k] ** 2))
        if load.is_idle:
            values: dict[str, object] = {
                "ligament": load.name,
                "force_N": load.force_N,
                "prior_force_N": load.prior_force_N,
            }
            found.append(finding(IDLE, load.name, values))
        elif chance * n < BEYOND_PRIOR:
            values = {
                "ligament": load.name,
                "p_value": chance,
                "stiffness_kN": prediction.theta[k],
                "prior_stiffness_kN": p.center[k],
                "strain_pct": prediction.theta[n + k],
                "prior_strain_pct": p.center[n + k],
            }
            found.append(finding("ligament-beyond-prior", load.name, values))
    return tuple(found)


def common_scale_findings(model: LaxityModel, theta: Array) -> tuple[Finding, ...]:
    """A finding if all ligaments are many times stiffer or more compliant than stated.

    Loads in another unit have this effect; only contact and limits of plausibility distinguish them
    from a soft or stiff knee.
    """
    n = model.tied.n
    times = theta[:n] / model.parameters.center[:n]
    if n < LEAST_LIGAMENTS or not np.all(np.isfinite(times) & (times > 0.0)):
        return ()
    mean = float(np.exp(np.log(times).mean()))
    if max(mean, 1.0 / mean) < MANY_TIMES or times.max() > ALIKE_TIMES * times.min():
        return ()
    word = "stiffer" if mean > 1.0 else "more compliant"
    values = {"times": max(mean, 1.0 / mean), "way": word}
    return (finding("stiffness-scaled", "ligaments", values),)


def idle_parameters(model: LaxityModel, prediction: Prediction) -> tuple[str, ...]:
    """Parameters of ligaments that carry nothing; bounds of these do not limit a fit."""
    return tuple(
        f"{x.name}.{quantity}"
        for x in ligament_loads(model, prediction)
        if x.is_idle
        for quantity in (STIFFNESS, STRAIN)
    )


def implausible_findings(model: LaxityModel, prediction: Prediction) -> tuple[Finding, ...]:
    """Findings on forces, strains and contact of a fit beyond published values of any knee.

    Trials without equilibrium are left out.
    """
    if not prediction.is_converged.any():
        return ()
    tension = tensions_of(model, prediction)
    return (
        *_forces(model, prediction),
        *_strains(model, prediction, tension),
        *_contact(model, prediction),
    )


@declared
class StrengthTension:
    """Tension of a ligament, its bundles together, and the load at which such ligaments fail."""

    tension: Array = entry("Tension in each trial [N], shape ``(n,)``")
    failure_N: float = entry("Mean load at failure", unit="N")  # noqa: N815 - newton
    source: str = entry("Where that is from")


def strength_tensions(model: LaxityModel, prediction: Prediction) -> dict[str, StrengthTension]:
    """Tension and strength of each ligament with a published strength, by its name.

    Lines whose names begin with that of the ligament are added up. Structures that effects add have
    the strengths of ligaments of other names.
    """
    added = (x for x in structure_names(model) if x in OTHER_NAMES)
    names = dict.fromkeys([*(x.name for x in model.knee.ligaments), *added])
    found = {}
    for name, (failure, _, source) in strengths_by_name(model.knee.donor_age).items():
        own = [x for x in names if x.startswith(name)]
        if own:
            tension = values_of_structures(model, prediction, own)[0].sum(axis=1)
            found[name] = StrengthTension(tension=tension, failure_N=failure, source=source)
    return found


def _forces(model: LaxityModel, prediction: Prediction) -> Iterator[Finding]:
    for ligament, found in strength_tensions(model, prediction).items():
        if np.nanmax(found.tension) <= BEYOND * found.failure_N:
            continue
        worst = int(np.nanargmax(found.tension))
        values = {
            "ligament": cause_label(ligament) if ligament in OTHER_NAMES else ligament,
            "force_N": found.tension[worst],
            "load": load_words(model.protocol, worst),
            "failure_N": found.failure_N,
            "source": found.source,
        }
        yield finding("implausible-force", ligament, values)


def _strains(model: LaxityModel, prediction: Prediction, tension: Array) -> Iterator[Finding]:
    strain = np.where(tension > 0.0, strains_of(model, prediction), np.nan)
    # Idle ligaments have a finding of their own.
    idle = {x for load in ligament_loads(model, prediction) if load.is_idle for x in load.members}
    for k, ligament in enumerate(model.knee.ligaments):
        own = strain[:, k]
        if not np.isfinite(own).any() or np.nanmax(own) <= FAILURE_PCT or ligament.name in idle:
            continue
        worst = int(np.nanargmax(own))
        values = {
            "ligament": ligament.name,
            "strain_pct": own[worst],
            "load": load_words(model.protocol, worst),
            "failure_pct": FAILURE_PCT,
            "source": BUTLER,
        }
        yield finding("implausible-strain", ligament.name, values)


def _contact(model: LaxityModel, prediction: Prediction) -> Iterator[Finding]:
    is_without_varus = prediction.is_converged & (dominant_loads(model.protocol).axis != VARUS)
    forces = compartment_forces(prediction)[is_without_varus]
    if not forces.size:
        return
    medial, lateral = np.median(forces, axis=0)
    if abs(medial - lateral) <= APART_N or min(medial, lateral) > LEAST_SHARE * (medial + lateral):
        return
    # Subtracting from zero avoids "-0".
    compression = 0.0 - float(np.median(model.protocol.loads[is_without_varus, DISTRACTION]))
    values = {
        "medial_N": medial,
        "lateral_N": lateral,
        "compression_N": compression,
        "n_trials": int(is_without_varus.sum()),
        "source": CONTACT_SOURCE,
    }
    yield finding("one-sided-contact", "contact", values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """A fit to be checked.

    Attributes
    ----------
    model
        The model of the data.
    laxity, table
        The data that were fitted, and the whole table including trials that were left out.
    start, prediction
        Parameters of the model where the search began, shape ``(p,)``, and the prediction of the
        model where it ended.
    held
        Names of fixed parameters and of nuisances.
    misfit
        Findings on the misfit and on active bounds.
    """

    model: LaxityModel
    laxity: Laxity
    table: Laxity
    start: Array
    prediction: Prediction
    held: Sequence[str]
    misfit: tuple[Finding, ...]


def check_fit(
    fitted: Fitted,
    others: Sequence[Finding] = (),
) -> tuple[Finding, ...]:
    """Findings about a fit, the most severe first.

    If a convention of the table is broken, trials that contradict each other are not listed,
    because the convention explains them.

    Parameters
    ----------
    fitted
        The fit.
    others
        Other findings, such as trials lost and starts that disagree.
    """
    model, laxity, theta = fitted.model, fitted.laxity, fitted.prediction.theta
    whole = fitted.table
    found = [
        *others,
        *fitted.misfit,
        *stability_findings(model),
        *rim_findings(model.protocol.trials, fitted.prediction),
        *(x for x in ligament_findings(model, fitted.prediction) if x.code == IDLE),
        *common_scale_findings(model, fitted.prediction.theta),
        *implausible_findings(model, fitted.prediction),
    ]
    table = table_findings(model, whole)
    if conventions := convention_findings(model, whole, fitted.start, theta):
        return without_repeats((*conventions, *table, *found))
    rows = row_findings(model, laxity, theta, fixed=fitted.held)
    # A fit that begins at measured poses may not show a wrong pose: the table itself is asked too.
    named = {x.where for x in rows}
    by_table = end_point_findings(whole) if model.poses is not None else ()
    by_table = tuple(x for x in by_table if x.where not in named)
    return without_repeats((*table, *by_table, *rows, *found))


def check_unfitted(
    model: LaxityModel, laxity: Laxity, others: Sequence[Finding]
) -> tuple[Finding, ...]:
    """Findings from the table alone, where no fit could begin, after `others`."""
    trials = end_point_findings(laxity)
    conventions = convention_findings(model, laxity, model.parameters.start)
    return without_repeats((*conventions, *table_findings(model, laxity), *trials, *others))


def table_findings(model: LaxityModel, laxity: Laxity) -> tuple[Finding, ...]:
    """Findings on the whole table; those on frames and signs only where fits begin at its poses."""
    if model.poses is None:
        return load_findings(laxity)
    return (*frame_findings(model), *load_sign_findings(laxity), *load_findings(laxity))
