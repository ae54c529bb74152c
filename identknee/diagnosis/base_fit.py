"""The fit of a knee to data, from which causes of what it leaves are looked for."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from identknee.calibrate.fit import Fit, fit, fit_many
from identknee.calibrate.problem import Problem, with_all_priors
from identknee.checks.data_noise import DataNoise, noise_of
from identknee.checks.fit_checks import ligament_loads
from identknee.checks.usable_trials import defined_everywhere, starts_elsewhere
from identknee.diagnosis.fitting import (
    BaseFit,
    FittedModel,
    base_model,
    best_fit_from,
    fit_low_loads,
    fitted_with_nuisances,
    without_causes,
)
from identknee.diagnosis.noise_model import build_noise_model
from identknee.identify.optimum import (
    A_GAIN,
    MOST_IDLE,
    N_HOPS,
    NEARLY_GONE,
    REACH_OF_HOPS,
    best_fits,
    nearly_gone,
    sobol_around,
    with_hops,
)
from identknee.laxity.table import Laxity
from identknee.model.effects.library import values_of
from identknee.model.parameters import STIFFNESS, STRAIN, Parameters
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array, declared, entry
from identknee.runs.progress import finished, progress, stage
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee, StatedPrior

N_STARTS = 3
# Prior standard deviations within which the other starts lie.
REACH = 1.0
# A prior that was not asked for is so many times as wide, and one of a ligament that carries
# nothing: ten times as wide, the prior of its stiffness still held a torn one at 4e-4 kN, where it
# moved the knee by 1.4 sd of the noise.
WIDER, WIDER_IF_IDLE = 10.0, 1000.0
# How often a search without the prior of an idle ligament continues after its last step.
MOST_ROUNDS = 3
# A fit less probable than REJECTED that is not at a minimum is searched for again: BRIEF is the
# simulations of a search, N_POLISHED the number of its lowest ends that are polished.
REJECTED, BRIEF, N_POLISHED = 1e-3, 60, 4
# From measured poses N_ELSEWHERE more searches are made, and all are polished: on the measured knee
# with bundles those that end lowest are among the highest after FIRST_STEPS simulations.
N_ELSEWHERE, FIRST_STEPS = 16, 10
LOOKING_LOWER = "looking for a lower fit"
# A torn ligament explains a misfit that noise alone then makes in one of twenty tables or more.
EXPLAINED = 0.05
# By how much a prior that was not widened may seem wider.
ROUNDING = 1e-9


def with_wider_priors(
    knee: Knee, parameters: Parameters, names: Iterable[str], wider: float = WIDER
) -> Knee:
    """The knee with the priors of the parameters named so wide that they say next to nothing."""
    priors = dict(knee.priors)
    for i in map(parameters.index, names):
        what = "log_sd" if parameters.is_log[i] else "sd"
        spread, center = wider * float(parameters.prior_sd[i]), float(parameters.center[i])
        priors[parameters.names[i]] = StatedPrior(**{what: spread, "center": center})
    return replace(knee, priors=priors)


def priors_set_aside(now: Parameters, before: Parameters) -> tuple[str, ...]:
    """Parameters whose priors a fit has widened, as the data contradict them."""
    return tuple(
        x
        for x in before.names_of_interest
        if now.prior_sd[now.index(x)] > before.prior_sd[before.index(x)] * (1.0 + ROUNDING)
    )


def fit_base(knee: Knee, laxity: Laxity, *, starts: Sequence[Array], seed: int) -> BaseFit | None:
    """The base model's fit, its noise found on the way; None where the noise cannot be known.

    The base model is the subject's knee with the contact law as a nuisance: how stiff cartilage is
    and how its pressure grows is never known well, and must not pass for another cause.

    Parameters
    ----------
    knee, laxity
        The subject and the data.
    starts
        Ligament parameters to begin at besides those at which the knee was fitted, the subject's
        own, and Sobol points around the first, each shape ``(2m,)``.
    seed
        Seed of those points.
    """
    model = base_model(knee, laxity.protocol).with_tests(laxity)
    n = model.n_ligament_parameters
    first, own = model.parameters.start, model.parameters.center[:n]
    stored = model.parameters.vector(values_of(knee))[n:]
    # Points within a prior standard deviation of where the search begins.
    ligaments = model.parameters.select(model.parameters.names[:n])
    around = sobol_around(ligaments, first[:n], N_STARTS, reach=REACH, seed=seed)
    begin = [first, *(np.r_[x, stored] for x in (own, *starts, *around))]
    stated = noise_of(laxity, laxity.coordinates)
    if stated is None:
        return None
    plain = build_noise_model(stated.sd, laxity.is_measured, correlation=stated.correlation)
    begin.append(fit_low_loads(model, laxity, plain, begin[0]))
    fitted = best_fit_from(model, laxity, plain, begin)
    if fitted.outcome is not Outcome.MINIMUM:
        # From the subject's own stiffness no search finds its way across cliffs to a torn ligament.
        torn = best_fit_from(model, laxity, plain, [*nearly_gone(model.parameters, begin[0])])
        fitted = min(fitted, torn, key=lambda x: x.evaluation.deviance)
    if not fitted.evaluation.is_finite:
        return BaseFit(fitted=fitted, noise=stated)
    return _with_its_noise(fitted, stated)


def _with_its_noise(fitted: FittedModel, known: DataNoise) -> BaseFit:
    """A fit repeated with the noise that its own residuals show; `known` if they show none.

    The residuals of a worse fit are rough where trials jump, which would count as noise.
    """
    noise = noise_of(fitted.laxity, fitted.compared.differences(fitted.theta)) or known
    return BaseFit(fitted=fitted_with_nuisances(fitted, noise.sd, noise.correlation), noise=noise)


@declared
class FurtherSearch:
    """How the fit of the base model is searched for beyond its first minimum."""

    from_poses: bool = entry("Whether fits from measured poses also begin where `fit` begins")
    doubted: tuple[str, ...] = entry("Parameters whose priors count only if the data allow them")


FURTHER = FurtherSearch(from_poses=True, doubted=())


def lowest_fit(base: BaseFit, seed: int, search: FurtherSearch = FURTHER) -> BaseFit:
    """The fit from which causes are looked for, searched for further where it left much misfit.

    Parameters
    ----------
    base
        The fit of the base model.
    seed
        Seed of the points where further searches begin.
    search
        How it is searched for.
    """
    found = base
    if search.from_poses and base.fitted.model.poses is not None:
        found = _lowest_from_poses(base, seed)
    elif without_causes(base).misfit_p_value < REJECTED:
        problem = _problem_past_lost_trials(base)
        if problem is not None:
            ends = best_fits(problem, start=base.fitted.theta, seed=seed, budget=BRIEF, hops=False)
            found = _polished(base, ends)
            # What a torn ligament explains by itself needs no further search.
            freed = without_idle_priors(found)
            if freed is not found and _is_explained(freed):
                return past_lost_trials(freed, seed)
            found = _polished(base, with_hops(problem, ends, seed=seed, budget=BRIEF))
    freed = _without_doubted_priors(found, search.doubted, seed)
    if freed is not found:
        return freed
    freed = without_idle_priors(found)
    return found if freed is found else past_lost_trials(freed, seed)


def _is_explained(base: BaseFit) -> bool:
    return without_causes(base).misfit_p_value > EXPLAINED


def _without_doubted_priors(base: BaseFit, doubted: Sequence[str], seed: int) -> BaseFit:
    """The fit with wider priors of the parameters doubted, where only these explain the misfit."""
    is_refuted = base.fitted.is_refuted.any()
    if not doubted or not is_refuted or without_causes(base).misfit_p_value >= REJECTED:
        return base
    begun = base.fitted.model.parameters.start
    freed = _lowest_from_poses(_with_wider_priors(base, doubted, WIDER, [begun]), seed)
    return freed if _is_explained(freed) else base


def without_idle_priors(base: BaseFit) -> BaseFit:
    """A fit in which the prior of a ligament that carries nothing pulls at it no longer.

    What its prior says of it is not true of this knee: a torn ligament has no stiffness, and how
    long a slack one is, no data show. Where its prior still pulled, it would carry a little that
    another effect could take away, and every effect that gives it a load would gain evidence.
    """
    fitted = base.fitted
    refuted = set(np.array(fitted.model.tied.names)[fitted.is_refuted].tolist())
    if idle := refuted & _idle(fitted):
        return _without_priors(base, sorted(idle))
    if not refuted or without_causes(base).misfit_p_value >= REJECTED:
        return base
    # A prior can hold what is torn at a load that the data reject: without it, it may carry none.
    found = _without_priors(base, sorted(refuted))
    idle = refuted & _idle(found.fitted)
    if not idle:
        return base
    if idle < refuted:
        found = _without_priors(base, sorted(idle))
    # Only where that explains the misfit: another cause may look like a torn ligament.
    is_explained = without_causes(found).misfit_p_value > EXPLAINED
    return found if is_explained and idle <= _idle(found.fitted) else base


def _idle(fitted: FittedModel) -> set[str]:
    """Names of the ligaments that carry nothing in a fit."""
    model = fitted.model
    return {x.name for x in ligament_loads(model, model.predict_once(fitted.theta)) if x.is_idle}


def _without_priors(base: BaseFit, idle: Sequence[str]) -> BaseFit:
    """The fit without the priors of some ligaments, begun also where they are absent."""
    fitted, model = base.fitted, base.fitted.model
    p, gone, absent = model.parameters, np.array(fitted.theta), np.array(fitted.theta)
    for owner in idle:
        stiffness, strain = (p.index(f"{owner}.{x}") for x in (STIFFNESS, STRAIN))
        gone[stiffness], gone[strain] = NEARLY_GONE * p.center[stiffness], p.center[strain]
        absent[stiffness] *= NEARLY_GONE
    names = [f"{owner}.{x}" for owner in idle for x in (STIFFNESS, STRAIN)]
    return _with_wider_priors(base, names, WIDER_IF_IDLE, [fitted.theta, gone, absent])


def _with_wider_priors(
    base: BaseFit, names: Sequence[str], wider: float, starts: Sequence[Array]
) -> BaseFit:
    """The fit with wider priors of some parameters, begun at some points."""
    fitted, model = base.fitted, base.fitted.model
    knee = with_wider_priors(model.knee, model.parameters, names, wider)
    free = base_model(knee, fitted.laxity.protocol)
    measured = free.with_tests(fitted.laxity)
    found = best_fit_from(measured, fitted.laxity, fitted.noise, starts)
    # A knee without a ligament is so compliant that steps along the valley are short.
    for _ in range(MOST_ROUNDS):
        if found.outcome is not Outcome.VALLEY:
            break
        found = best_fit_from(measured, fitted.laxity, fitted.noise, [found.theta])
    return _with_its_noise(found, base.noise) if found.evaluation.is_finite else base


def past_lost_trials(base: BaseFit, seed: int) -> BaseFit:
    """A fit, or a lower one that lies beyond parameters with which trials have no equilibrium.

    A knee without a ligament bears few of the loads that it was measured under unless all other
    parameters are nearly right, and no search that needs every trial finds its way there. That of
    `fit` does: a lost trial is held near its measured pose.

    Parameters
    ----------
    base
        The fit. One that ended at its minimum is returned.
    seed
        Seed of the points where searches begin.
    """
    problem = _problem_past_lost_trials(base)
    if problem is None:
        return base
    start = base.fitted.theta
    if _is_explained(base):
        # Where noise explains what is left, the minimum is near.
        found = _polished(base, [fit(problem, start, seed=seed)])
        if found.fitted.outcome is Outcome.MINIMUM:
            return found
    return _polished(base, best_fits(problem, start=start, seed=seed, budget=BRIEF))


def _lowest_from_poses(base: BaseFit, seed: int) -> BaseFit:
    """The fit, or a lower one from where those of `fit` begin and from around it.

    Where equilibria are looked for from measured poses, many minima lie close together.
    """
    problem = _problem_everywhere(base)
    if problem is None:
        return base
    points = starts_elsewhere(base.fitted.model, base.fitted.theta, N_ELSEWHERE, seed=seed)
    with stage(LOOKING_LOWER):
        found, idle = _lower_from(base, problem, points, seed), 0
    for k, reach in enumerate(progress(REACH_OF_HOPS, description=LOOKING_LOWER)):
        lowest = found.fitted
        near = sobol_around(problem.parameters, lowest.theta, N_HOPS, reach=reach, seed=seed + k)
        found = _lower_from(found, problem, near, seed)
        idle = 0 if found.fitted.deviance < lowest.deviance - A_GAIN else idle + 1
        if idle == MOST_IDLE:
            break
    finished(LOOKING_LOWER)
    return found


def _lower_from(base: BaseFit, problem: Problem, points: Array, seed: int) -> BaseFit:
    """The fit, or a lower one where brief searches from some points lead."""
    inside = np.clip(points, problem.parameters.lower, problem.parameters.upper)
    ends = fit_many(problem, inside, seed=seed, budget=FIRST_STEPS)
    return _polished(base, sorted(ends, key=lambda x: x.objective), most=len(ends))


def _problem_past_lost_trials(base: BaseFit) -> Problem | None:
    """The problem of a fit, defined also where trials are lost; None for a fit at its minimum."""
    return None if base.fitted.outcome is Outcome.MINIMUM else _problem_everywhere(base)


def _problem_everywhere(base: BaseFit) -> Problem | None:
    """The problem of a fit, defined also where trials are lost; None where angles are relative."""
    fitted = base.fitted
    if fitted.laxity.zero != "absolute":
        return None
    known = replace(
        fitted.laxity, sd=base.noise.sd, within_trial_correlation=base.noise.correlation
    )
    compared = LaxityResiduals(model=fitted.model, laxity=known, weighting="noise")
    return with_all_priors(defined_everywhere(compared))


def _polished(base: BaseFit, ends: Sequence[Fit], most: int = N_POLISHED) -> BaseFit:
    """The lowest of the first ends, without lost trials, where it is lower than the fit."""
    fitted, starts = base.fitted, [x.theta for x in ends[:most]]
    found = best_fit_from(fitted.model, fitted.laxity, fitted.noise, starts)
    return _with_its_noise(found, base.noise) if found.deviance < fitted.deviance else base
