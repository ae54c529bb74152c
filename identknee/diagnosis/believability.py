"""Which causes make the fitted knee plausible, and what the data say of them then.

With limits L of plausibility beside the data D, the evidence of a model M is

    ``p(D, L | M) = p(L | M) p(D | L, M)``.

The first factor asks whether a knee drawn from the priors of the model is plausible: a cause that
raises it makes the knee believable. Only the second is evidence of the data.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import logsumexp
from scipy.stats import qmc, truncnorm

from identknee.calibrate.bounded_least_squares import ConstrainedFit, bounded_step
from identknee.calibrate.problem import (
    PLAUSIBILITY_TERM,
    TABLE_TERM,
    Evaluation,
    ProblemWithPriors,
    SumOfTerms,
    conditional_sds,
    evaluate,
    limit_rows,
    sum_of_squares,
    with_all_priors,
)
from identknee.checks.limit_price import limits_of
from identknee.checks.usable_trials import defined_everywhere
from identknee.diagnosis.base_fit import BRIEF
from identknee.diagnosis.candidates import Variant, secant_amplitudes
from identknee.diagnosis.fitting import FittedModel, descended, whitened_problem
from identknee.diagnosis.investigation import Investigation
from identknee.identify.laplace import log_evidence
from identknee.identify.optimum import REACH, best_fits, sobol_around
from identknee.model.effects.effect import Effect
from identknee.model.laxity_model import LaxityModel
from identknee.model.limit_residuals import LimitAtFit, LimitResiduals
from identknee.model.parameters import Parameters
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array, declared, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.progress import progress
from identknee.runs.record import Outcome
from identknee.subject.knee import StatedPrior
from identknee.subject.plausibility import Limits

# Further starts of the fit without causes, around the fit without limits, as in `fit`; and how
# many of the lowest ends are polished.
N_STARTS, N_FINISHED = 8, 2
MOST_STEPS = 100
# Causes fitted, and the longest step of the linear prediction, in conditional standard deviations.
# A fit begins at the part of that step with the lowest deviance.
MOST_CAUSES, LONGEST = 6, 3.0
PARTS = (1.0, 0.5, 0.25, 0.125, 0.0)
# Knees drawn from the priors: a power of two.
LOG_DRAWS = 9

# Causes, and starts of their fits.
Tried = tuple[tuple[Effect, ...], list[Array]]


@declared
class CauseUnderLimits:
    """A model with limits of plausibility beside the data: the one without causes, or with some."""

    names: tuple[str, ...] = entry("Names of its causes; none of the model without")
    price: float | None = entry(
        "How much the limits raise its least deviance; null where no fit has an equilibrium in "
        "every trial",
        unit="1",
    )
    of_limits: float | None = entry(
        "The part of that which its fit still has beyond the limits", unit="1"
    )
    log_limits_difference: float | None = entry(
        "How much it makes the knee believable: log p(limits | model) less that without causes; "
        "null where no knee drawn is plausible",
        unit="1",
    )
    log_limits_se: float | None = entry("Standard error of that, of the knees drawn", unit="1")
    log_data_difference: float | None = entry(
        "Evidence of the data: log p(data | limits, model) less that without causes", unit="1"
    )
    outcome: Outcome = entry("How its fit with limits ended")
    limits: tuple[LimitAtFit, ...] = entry("The limits at that fit")


def causes_under_limits(
    found: Investigation,
    limits: Limits,
    priors: Mapping[str, StatedPrior],
    *,
    seed: int,
    executor: Executor = serial,
) -> tuple[CauseUnderLimits, ...]:
    """The model without causes where limits count, then causes, the highest evidence first.

    Causes are those of the explanation, and those by which the linear model predicts the largest
    fall of the deviance with limits.

    Parameters
    ----------
    found
        The diagnosis without limits.
    limits
        The limits.
    priors
        Priors of the ligaments' parameters as the subject states them: those of a diagnosis may be
        wider, and say nothing of what is believable.
    seed
        Seed of starts and draws.
    executor
        Who fits causes.
    """
    fitted = found.base.fitted
    model = replace(fitted.model, knee=replace(fitted.model.knee, priors=dict(priors)))
    weighing = _Weighing(fitted=fitted, model=model, sd=found.noise.sd, limits=limits, seed=seed)
    base = weighing.without_causes()
    if not base.fitted.evaluation.is_finite:
        return (_row(base, base),)
    tried = _tried(weighing, base, found)
    rows = executor.map(partial(_weighed_row, weighing, base), tried)
    made = list(progress(rows, total=len(tried), description="fitting causes with limits"))
    made.sort(key=lambda x: -x[0])
    return (_row(base, base), *(row for _, row in made))


@declared
class _Weighed:
    """A model under limits: its fits with and without them, and its evidence."""

    causes: tuple[Effect, ...] = entry("Its causes")
    problem: ProblemWithPriors = entry("Data, limits and priors")
    limits: LimitResiduals = entry("The limits")
    fitted: ConstrainedFit = entry("The fit with limits")
    without: Evaluation = entry("The best fit without limits")
    log_limits: float = entry("log p(limits | model); -inf where no knee drawn is plausible")
    log_limits_se: float = entry("Its standard error")

    @property
    def price(self) -> float:
        """Rise of the least deviance by the limits."""
        return self.fitted.evaluation.deviance - self.without.deviance

    @property
    def log_both(self) -> float:
        """Log p(data, limits | model), up to a constant of the data."""
        at, parameters = self.fitted.evaluation, self.problem.parameters
        return log_evidence(at, parameters, self.fitted.is_held) if at.is_finite else -np.inf


def _weighed_row(
    weighing: "_Weighing", base: _Weighed, tried: Tried
) -> tuple[float, CauseUnderLimits]:
    """Log evidence of data and limits together, and the row of a model with causes."""
    one = weighing.weighed(*tried, base)
    return one.log_both, _row(one, base)


def _row(one: _Weighed, base: _Weighed) -> CauseUnderLimits:
    at = one.fitted.evaluation
    beyond = at.residuals[limit_rows(one.problem)]
    logs = one.log_limits, base.log_limits, one.log_both, base.log_both
    is_known, is_fitted = bool(np.isfinite(logs).all()), at.is_finite
    se = 0.0 if one is base else float(np.hypot(one.log_limits_se, base.log_limits_se))
    return CauseUnderLimits(
        names=tuple(x.name for x in one.causes),
        price=one.price if is_fitted else None,
        of_limits=float(beyond @ beyond) if is_fitted else None,
        log_limits_difference=one.log_limits - base.log_limits if is_known else None,
        log_limits_se=se if is_known else None,
        log_data_difference=(one.log_both - base.log_both) - (one.log_limits - base.log_limits)
        if is_known
        else None,
        outcome=one.fitted.outcome,
        limits=one.limits.at_fit(at.theta) if is_fitted else (),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Weighing:
    """What all models that are compared under limits share.

    Attributes
    ----------
    fitted
        The fit without causes and without limits.
    model
        Its model with the priors that the subject states.
    sd
        Noise of the coordinates [mm, deg], shape ``(n, 5)``.
    limits, seed
        As for `causes_under_limits`.
    """

    fitted: FittedModel
    model: LaxityModel
    sd: Array
    limits: Limits
    seed: int

    def problem(self, causes: Sequence[Effect]) -> ProblemWithPriors:
        """Data, limits and priors of the model with causes."""
        model, laxity = self.model.with_effects([*self.model.effects, *causes]), self.fitted.laxity
        data = whitened_problem(model, laxity, self.fitted.noise).problem
        limits = LimitResiduals(model=model.with_tests(laxity), limits=self.limits)
        terms = {TABLE_TERM: data, PLAUSIBILITY_TERM: limits}
        whole = SumOfTerms(terms=terms, sizes=(self.fitted.n_data, limits.n))
        return ProblemWithPriors(problem=whole)

    def without_causes(self) -> _Weighed:
        """The model itself, fitted from several starts; lost trials are held on the way."""
        start = self.fitted.theta
        knee = replace(self.model.knee, plausibility=self.limits)
        compared = LaxityResiduals(
            model=replace(self.model, knee=knee),
            laxity=replace(self.fitted.laxity, sd=self.sd),
            weighting="noise",
        )
        everywhere = with_all_priors(defined_everywhere(compared))
        around = sobol_around(self.model.parameters, start, N_STARTS, reach=REACH, seed=self.seed)
        ends = best_fits(everywhere, start=start, points=around, seed=self.seed, budget=BRIEF)
        return self._finished((), self.problem(()), [x.theta for x in ends[:N_FINISHED]], [start])

    def weighed(
        self, causes: Sequence[Effect], starts: Sequence[Array], base: _Weighed
    ) -> _Weighed:
        """The model with causes, fitted from `starts`, each shape ``(p + a,)``."""
        n = self.model.parameters.n
        plain = [np.concatenate([base.without.theta, x[n:]]) for x in starts]
        return self._finished(causes, self.problem(causes), starts, plain)

    def _finished(
        self,
        causes: Sequence[Effect],
        problem: ProblemWithPriors,
        starts: Sequence[Array],
        plain: Sequence[Array],
    ) -> _Weighed:
        ends = [descended(problem, x, (), MOST_STEPS) for x in starts]
        fitted = min(ends, key=lambda x: x.evaluation.deviance)
        limits, laxity, noise = limits_of(problem), self.fitted.laxity, self.fitted.noise
        if limits is None:  # pragma: no cover - they are a term of it
            raise AssertionError
        lowest = [
            descended(whitened_problem(limits.model, laxity, noise), x, (), MOST_STEPS).evaluation
            for x in (*plain, fitted.evaluation.theta)
        ]
        log_share, se = _log_share(limits, self.model.parameters.n, self.seed)
        return _Weighed(
            causes=tuple(causes),
            problem=problem,
            limits=limits,
            fitted=fitted,
            without=min(lowest, key=lambda x: x.deviance),
            log_limits=log_share,
            log_limits_se=se,
        )


def _tried(weighing: _Weighing, base: _Weighed, found: Investigation) -> list[Tried]:
    """Sets of causes to fit, and the starts of each."""
    falls: dict[str, tuple[float, Effect, list[Array]]] = {}
    steps = found.attribution.steps[0]
    highest = {(x.name, x.variant) for x in steps.scores.candidates}
    for variant in steps.variants:
        name = variant.effect.name
        if (name, variant.signature.variant) in highest or variant is steps.typical(name):
            fall, ways = _expected(weighing, base, variant)
            if fall > falls.get(name, (0.0,))[0]:
                falls[name] = fall, variant.effect, ways
    tried: list[Tried] = []
    for _, effect, ways in sorted(falls.values(), key=lambda x: -x[0])[:MOST_CAUSES]:
        problem = weighing.problem([effect])
        deviances = [sum_of_squares(problem.residuals(x)) for x in ways]
        tried.append(((effect,), [ways[int(np.argmin(deviances))]]))
    explanation = found.explanation
    if explanation.causes:
        own = [x for x in tried if tuple(y.name for y in x[0]) == explanation.names]
        tried = [x for x in tried if x not in own]
        # Where the explanation has another variant of the effect, amplitudes differ.
        starts = [x for causes, theta in own if causes == explanation.causes for x in theta]
        tried.insert(0, (explanation.causes, [explanation.fitted.theta, *starts]))
    return tried


def _expected(weighing: _Weighing, base: _Weighed, variant: Variant) -> tuple[float, list[Array]]:
    """Fall of the deviance with limits by the linear model with a cause, and starts on the way."""
    problem = weighing.problem([variant.effect])
    values = variant.values
    if variant.is_secant:
        values = secant_amplitudes(variant.effect, values)
    theta = np.concatenate([base.fitted.evaluation.theta, values])
    parameters = problem.parameters
    theta = np.clip(theta, parameters.lower, parameters.upper)
    at = evaluate(problem, theta)
    if not at.is_finite:
        return -np.inf, [theta]
    scales = conditional_sds(at.jacobian, parameters)
    low, high = (parameters.lower - theta) / scales, (parameters.upper - theta) / scales
    box = np.maximum(low, -LONGEST), np.minimum(high, LONGEST)
    matrix = at.jacobian * scales
    step = bounded_step(matrix, at.residuals, box, None).step
    left = matrix @ step + at.residuals
    fall = base.fitted.evaluation.deviance - float(left @ left)
    ways = [np.clip(theta + x * scales * step, parameters.lower, parameters.upper) for x in PARTS]
    return fall, ways


def _log_share(limits: LimitResiduals, n_common: int, seed: int) -> tuple[float, float]:
    """Log p(limits | model), and its standard error, of knees drawn from the priors.

    The first `n_common` parameters have the same draws in all models. Limits apply to the trials in
    which a drawn knee has an equilibrium: that every trial has one is evidence of the data.
    """
    limits = replace(limits, is_everywhere=True)
    own = limits.parameters
    parts = [qmc.Sobol(n_common, seed=seed).random_base2(LOG_DRAWS)]
    if own.n > n_common:
        parts.append(qmc.Sobol(own.n - n_common, seed=seed + 1).random_base2(LOG_DRAWS))
    drawn = _drawn(own, np.hstack(parts))
    logs = np.array([-0.5 * sum_of_squares(limits.residuals(x)) for x in drawn])
    share = float(logsumexp(logs) - np.log(logs.size))
    if not np.isfinite(share):
        return share, np.inf
    weights = np.exp(logs - share)
    return share, float(weights.std(ddof=1) / np.sqrt(logs.size))


def _drawn(own: Parameters, uniforms: Array) -> Array:
    """Draws from the priors within their bounds, shape ``(k, p)``."""
    with np.errstate(divide="ignore"):
        low, high, center = (
            np.where(own.is_log, np.log(np.maximum(x, 0.0)), x)
            for x in (own.lower, own.upper, own.center)
        )
    sd = own.prior_sd
    drawn = truncnorm.ppf(uniforms, (low - center) / sd, (high - center) / sd, center, sd)
    return np.asarray(np.where(own.is_log, np.exp(drawn), drawn))
