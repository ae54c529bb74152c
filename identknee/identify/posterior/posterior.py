"""A sample of the posterior with its convergence diagnostics.

Every function takes the values of one quantity as (ensemble, walker, step), never flattened: draws
of one walker depend on one another, and only the order of its steps shows how much.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import unique

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri
from typing_extensions import override

from identknee.calibrate.problem import (
    BoundedProblem,
    Evaluation,
    Problem,
    evaluate,
    without_priors,
)
from identknee.identify.binomial_interval import share
from identknee.model.parameters import Parameters
from identknee.runs.declare import OF_PARAMETER, Array, BoolArray, IntArray, array, declared, entry
from identknee.runs.record import Record, WithSentence

# Standard deviation, in distances of the bounds, of a normal prior that is uniform to 0.1 %.
FLAT = 10.0


@declared
class LogPosterior:
    """Natural logarithm of the posterior density of a problem's parameters.

    It is the log likelihood (minus half the deviance, without the constant that depends on the
    noise alone) plus the log prior density: lognormal or normal for each parameter, cut off at the
    bounds and scaled so that its integral within them is 1. The likelihood is 0 where the model
    has no prediction.

    Attributes
    ----------
    problem
        Its residuals in units of their noise; rows of priors are left out, since the density has
        those of all parameters.
    """

    problem: Problem

    def __post_init__(self) -> None:
        object.__setattr__(self, "problem", without_priors(self.problem))
        parameters = self.problem.parameters
        is_log = parameters.is_log
        if np.any(parameters.prior_sd <= 0) or np.any(parameters.center[is_log] <= 0):
            raise ValueError(
                "a prior needs a standard deviation above 0, and a lognormal one a centre above 0; "
                f"got {parameters.prior_sd.tolist()} around {parameters.center.tolist()}"
            )
        if mass_within_bounds(parameters) == 0:
            raise ValueError(
                "the prior has no mass within the bounds; widen the bounds or move the prior"
            )

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self.problem.parameters

    def __call__(self, theta: Array) -> float:
        """Log density at `theta`, shape ``(n,)``; -inf beyond the bounds or without prediction."""
        prior = float(log_prior(theta, self.parameters))
        if not np.isfinite(prior):
            return -np.inf
        return prior - 0.5 * evaluate(self.problem, theta).deviance


def with_uniform_priors(problem: Problem) -> Problem:
    """The problem with all values of a parameter of interest within its bounds as likely.

    Such a prior is a normal one of ten times their distance, which falls by 0.1 % to the bounds.
    Nuisances keep theirs.
    """
    p = problem.parameters
    asked = p.is_of_interest
    parameters = replace(
        p,
        center=np.where(asked, 0.5 * (p.lower + p.upper), p.center),
        prior_sd=np.where(asked, FLAT * (p.upper - p.lower), p.prior_sd),
        is_log=p.is_log & ~asked,
        own=p.start,
    )
    return BoundedProblem(problem=without_priors(problem), parameters=parameters)


def log_prior(theta: Array, parameters: Parameters) -> Array:
    """Log prior density of thetas, shape ``(..., n)``; -inf beyond the bounds.

    Its integral within the bounds is 1.
    """
    theta = np.asarray(theta, dtype=np.float64)
    is_inside = inside(theta, parameters)
    working = parameters.to_working(np.where(is_inside[..., None], theta, parameters.center))
    log_density = (
        log_prior_working(working, parameters)
        - np.sum(working[..., parameters.is_log], axis=-1)
        - np.sum(_log_masses(parameters))
    )
    return np.where(is_inside, log_density, -np.inf)


def mass_within_bounds(parameters: Parameters) -> float:
    """Prior mass within the bounds, before truncation."""
    return float(np.exp(np.sum(_log_masses(parameters))))


def inside(theta: Array, parameters: Parameters) -> BoolArray:
    """Whether thetas, shape ``(..., n)``, are within the bounds and lognormal ones above 0."""
    within = (theta >= parameters.lower) & (theta <= parameters.upper)
    return np.asarray(np.all(within & ((theta > 0) | ~parameters.is_log), axis=-1))


def log_prior_working(working: Array, parameters: Parameters) -> Array:
    """Log prior density of working coordinates, shape ``(..., n)``, without regard to bounds."""
    sd = parameters.prior_sd
    z = (working - working_center(parameters)) / sd
    return np.asarray(np.sum(-0.5 * z**2 - np.log(sd) - 0.5 * np.log(2.0 * np.pi), axis=-1))


def working_center(parameters: Parameters) -> Array:
    """Centre of the normal priors in working coordinates, shape ``(n,)``."""
    return parameters.to_working(parameters.center)


def prior_quantiles(parameters: Parameters, probabilities: Array) -> Array:
    """Theta at so much of each prior within its bounds, shape ``(..., n)`` as `probabilities`."""
    low, high = _working_bounds(parameters)
    center, sd = working_center(parameters), parameters.prior_sd
    first, last = ndtr((low - center) / sd), ndtr((high - center) / sd)
    theta = parameters.from_working(center + sd * ndtri(first + probabilities * (last - first)))
    return np.asarray(np.clip(theta, parameters.lower, parameters.upper))


def prior_draws(parameters: Parameters, n: int, generator: np.random.Generator) -> Array:
    """Draws of theta from the priors within the bounds, shape ``(n, p)``."""
    return prior_quantiles(parameters, generator.uniform(size=(n, parameters.n)))


@declared
class InfeasiblePriorMass:
    """Prior mass without a prediction or beyond the bounds."""

    beyond_bounds: float = entry("Part of the priors that the bounds cut off, exact", unit="1")
    without_prediction: float = entry(
        "Part of the prior within the bounds where the model has no prediction, estimated; null "
        "without draws",
        unit="1",
    )
    low: float = entry("Lower 95 % confidence limit of that estimate", unit="1")
    high: float = entry("Upper 95 % confidence limit of that estimate", unit="1")
    n_draws: int = entry("Draws of the prior simulated for it", unit="1")

    @override
    def __str__(self) -> str:
        """Both parts as a sentence."""
        return (
            f"The bounds exclude {100 * self.beyond_bounds:.2g} % of the prior. Another "
            f"{100 * self.without_prediction:.2g} % of what is left has no prediction "
            f"(95 % confidence interval {100 * self.low:.2g} to {100 * self.high:.2g} %, from "
            f"{self.n_draws} draws)."
        )


def infeasible_prior_mass(parameters: Parameters, is_predicted: BoolArray) -> InfeasiblePriorMass:
    """The excluded prior mass; `is_predicted` is that of draws of the prior, shape ``(n,)``."""
    failed = share(int(np.sum(~is_predicted)), len(is_predicted))
    return InfeasiblePriorMass(
        beyond_bounds=max(0.0, 1.0 - mass_within_bounds(parameters)),
        without_prediction=failed.value,
        low=failed.lower,
        high=failed.upper,
        n_draws=failed.n,
    )


@declared
class NewtonKernel:
    """The density at a point, and the Gaussian proposal of its Gauss-Newton step."""

    log_density: float = entry(
        "Log density of the posterior in working coordinates, without a constant; -inf where "
        "there is none"
    )
    center: Array = array("End of the Gauss-Newton step", "parameter")
    factor: Array = array(
        "Lower Cholesky factor of the precision there", "parameter", "other parameter"
    )


def newton_kernel(evaluation: Evaluation, parameters: Parameters) -> NewtonKernel:
    """The kernel of a point from its simulation; one with zeros if it has no prediction.

    The precision is that of the linearised residuals and the priors, so that the kernel is the
    posterior itself where the residuals are linear in the working coordinates.
    """
    n = parameters.n
    if not evaluation.is_finite:
        return NewtonKernel(log_density=-np.inf, center=np.zeros(n), factor=np.zeros((n, n)))
    working = parameters.to_working(evaluation.theta)
    jacobian = evaluation.jacobian * np.where(parameters.is_log, evaluation.theta, 1.0)
    precision = 1.0 / parameters.prior_sd**2
    gradient = jacobian.T @ evaluation.residuals + precision * (
        working - working_center(parameters)
    )
    information = jacobian.T @ jacobian + np.diag(precision)
    factor = np.asarray(np.linalg.cholesky(information), dtype=np.float64)
    log_density = -0.5 * evaluation.deviance + float(log_prior_working(working, parameters))
    center = working - np.linalg.solve(information, gradient)
    return NewtonKernel(log_density=log_density, center=center, factor=factor)


def _working_bounds(parameters: Parameters) -> tuple[Array, Array]:
    is_log = parameters.is_log
    bounds = (parameters.lower, parameters.upper)
    with np.errstate(divide="ignore"):
        low, high = (np.where(is_log, np.log(np.maximum(x, 0.0)), x) for x in bounds)
    return low, high


def _log_masses(parameters: Parameters) -> Array:
    """Log mass of each prior within its bounds, shape ``(n,)``."""
    low, high = _working_bounds(parameters)
    center, sd = working_center(parameters), parameters.prior_sd
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(ndtr((high - center) / sd) - ndtr((low - center) / sd)))


# The sum over lags ends at the first lag beyond so many autocorrelation times (Sokal).
WINDOW = 5.0
TAIL = 0.05
ONE_SD = 0.15865525393145707


def autocorrelation(values: Array) -> Array:
    """Autocorrelation at every lag, averaged over walkers, shape ``(steps,)``.

    Values are counted from the mean of their ensemble, so that walkers that keep to different
    places count as correlated.

    Parameters
    ----------
    values
        Shape ``(ensembles, walkers, steps)``.
    """
    steps = values.shape[2]
    centred = values - values.mean(axis=(1, 2), keepdims=True)
    spectrum = np.abs(np.fft.rfft(centred, 2 * steps, axis=2)) ** 2
    products = np.fft.irfft(spectrum.sum(axis=(0, 1)), 2 * steps)[:steps]
    covariance = products / np.arange(steps, 0, -1)
    if covariance[0] <= 0:
        return np.ones(steps)
    return np.asarray(covariance / covariance[0])


def autocorrelation_time(values: Array) -> float:
    """The integrated autocorrelation time in steps.

    At least 1, so that there are never more effective draws than draws; infinite where nothing
    moves.

    References
    ----------
    A. Sokal, Monte Carlo methods in statistical mechanics: foundations and new algorithms, in
    Functional Integration (1997) 131-192, doi:10.1007/978-1-4899-0319-8_6, for the window.
    """
    if np.ptp(values) == 0:
        return np.inf
    sums = 2.0 * np.cumsum(autocorrelation(values)) - 1.0
    is_enough = np.arange(len(sums)) >= WINDOW * sums
    last = int(np.argmax(is_enough)) if is_enough.any() else len(sums) - 1
    return max(1.0, float(sums[last]))


def effective_draws(values: Array) -> float:
    """Effective sample size for the mean: all draws over the autocorrelation time."""
    return float(values.size / autocorrelation_time(values))


def normal_scores(values: Array) -> Array:
    """Normal quantiles of the ranks among all values, same shape."""
    ranks = scipy.stats.rankdata(values, method="average").reshape(values.shape)
    return np.asarray(scipy.stats.norm.ppf((ranks - 0.375) / (values.size + 0.25)))


def bulk_ess(values: Array) -> Array:
    """Effective sample size of the bulk (ranks) by ensemble, ``(ensembles,)``; they add up.

    References
    ----------
    A. Vehtari et al., Rank-normalization, folding, and localization: an improved R-hat, Bayesian
    Anal. 16 (2021) 667-718, doi:10.1214/20-BA1221, section 4, with tau in place of chains.
    """
    return _by_ensemble(normal_scores(values))


def tail_ess(values: Array) -> Array:
    """Effective sample size of the tails (5 and 95 % quantile), the smaller, by ensemble."""
    low, high = np.quantile(values, [TAIL, 1.0 - TAIL])
    return np.minimum(
        _by_ensemble((values <= low).astype(float)), _by_ensemble((values >= high).astype(float))
    )


def split_rhat(values: Array) -> float:
    """Rank-normalised split R-hat of the ensembles, of location or of scale, the larger.

    A chain is one half of one ensemble, all its walkers together: walkers of an ensemble are not
    independent, ensembles are.

    References
    ----------
    Vehtari et al. (2021), section 3, doi:10.1214/20-BA1221.
    """
    folded = np.abs(values - np.median(values))
    return max(_rhat(normal_scores(values)), _rhat(normal_scores(folded)))


def mean_error(values: Array) -> float:
    """Monte Carlo standard error of the mean over the standard deviation."""
    return float(1.0 / np.sqrt(effective_draws(values)))


def quantile_error(values: Array, probability: float) -> float:
    """Monte Carlo standard error of a quantile, in the unit of the values.

    References
    ----------
    Vehtari et al. (2021), section 4.4, doi:10.1214/20-BA1221.
    """
    quantile = np.quantile(values, probability)
    draws = effective_draws((values <= quantile).astype(float))
    if not np.isfinite(draws) or draws <= 0:
        return np.inf
    shape = (draws * probability + 1.0, draws * (1.0 - probability) + 1.0)
    between = scipy.stats.beta.ppf([ONE_SD, 1.0 - ONE_SD], *shape)
    low, high = np.quantile(values, between)
    return float(0.5 * (high - low))


def _by_ensemble(values: Array) -> Array:
    return np.array([effective_draws(ensemble[None]) for ensemble in values])


def _rhat(values: Array) -> float:
    half = values.shape[2] // 2
    if half < 1:
        return np.inf
    halves = np.concatenate([values[:, :, :half], values[:, :, -half:]])
    n = halves.shape[1] * half
    within = float(np.mean(halves.var(axis=(1, 2), ddof=1)))
    between = float(np.var(halves.mean(axis=(1, 2)), ddof=1))
    if within <= 0:
        return np.inf if between > 0 else 1.0
    return float(np.sqrt((n - 1) / n + between / within))


ACCEPTANCE_HINT = (0.15, 0.5)
STUCK_ACCEPTANCE = 0.05
# A walker that has not moved for fewer steps than this may be unlucky.
STUCK_STEPS = 200
BURN_IN = 0.2


@unique
class SampleOutcome(WithSentence):
    """How sampling ended; the value is the word written to files."""

    CONVERGED = ("converged", "Every condition of convergence is met.")
    BUDGET = ("budget", "The budget of simulations was exhausted before the sample converged.")
    STUCK = ("stuck", "A walker is stuck, so the sample is not reliable.")
    START_FAILED = ("start_failed", "The model has no prediction around the places to start from.")


@declared
class StopRule:
    """Convergence criteria, all to be met before sampling stops, and its budget."""

    autocorrelation_times: float = entry(
        "Steps after burn-in, in the largest autocorrelation time", unit="1", default=50.0
    )
    drift: float = entry(
        "Largest relative change of an autocorrelation time since the check before; the checks are "
        "one autocorrelation time apart or more",
        unit="1",
        default=0.01,
    )
    rhat: float = entry("Largest R-hat between the halves of the ensembles", unit="1", default=1.01)
    effective_draws: float = entry(
        "Fewest effective draws, of the bulk and of the tails, over all ensembles",
        unit="1",
        default=400.0,
    )
    effective_draws_each: float = entry(
        "Fewest effective draws of one ensemble", unit="1", default=100.0
    )
    mean_error: float = entry(
        "Largest Monte Carlo standard error of a mean, relative to the standard deviation",
        unit="1",
        default=0.05,
    )
    budget: int = entry(
        "Simulations after which sampling stops in any case, at the end of a block of steps",
        unit="1",
        default=400_000,
    )

    def __post_init__(self) -> None:
        if self.budget < 1:
            raise ValueError(f"the budget must be at least 1 simulation, got {self.budget}")


@declared
class ConvergenceCheck:
    """Convergence diagnostics after some steps."""

    rule: StopRule = entry("The stop rule")
    steps: int = entry("Steps of every walker so far, those of burn-in included")
    burn_in: int = entry("How many of them, at the beginning, are left out of everything")
    tau: Array = array("Autocorrelation time of each parameter", "parameter", unit="steps")
    drift: float = entry(
        "Largest relative change of an autocorrelation time since the check at least one such time "
        "before; infinite at the first",
        unit="1",
    )
    rhat: Array = array("R-hat of each parameter", "parameter")
    bulk: Array = array("Effective draws of the bulk", "parameter", "ensemble")
    tail: Array = array("Effective draws of the tails", "parameter", "ensemble")
    mean_error: Array = array(
        "Monte Carlo standard error of each mean over the standard deviation", "parameter"
    )
    acceptance: Array = array("Share of the steps in which a walker moved", "ensemble", "walker")

    @property
    def kept(self) -> int:
        """Steps after burn-in."""
        return self.steps - self.burn_in

    @property
    def conditions(self) -> dict[str, tuple[float, float, bool]]:
        """By name of the condition: the number, its bar, and whether it is met."""
        rule = self.rule
        longest = float(np.max(self.tau))
        fewest = float(min(self.bulk.sum(axis=1).min(), self.tail.sum(axis=1).min()))
        fewest_each = float(min(self.bulk.min(), self.tail.min()))
        at_least = {
            "steps_per_tau": (self.kept / longest, rule.autocorrelation_times),
            "effective_draws": (fewest, rule.effective_draws),
            "effective_draws_each": (fewest_each, rule.effective_draws_each),
        }
        at_most = {
            "tau_drift": (self.drift, rule.drift),
            "rhat": (float(np.max(self.rhat)), rule.rhat),
            "mean_error": (float(np.max(self.mean_error)), rule.mean_error),
        }
        return {name: (value, bar, value >= bar) for name, (value, bar) in at_least.items()} | {
            name: (value, bar, value <= bar) for name, (value, bar) in at_most.items()
        }

    @property
    def is_passed(self) -> bool:
        """Whether all conditions are met."""
        return all(met for _, _, met in self.conditions.values())

    @property
    def stuck(self) -> BoolArray:
        """Which walkers moved in fewer than one step in twenty, of 200 or more."""
        return np.asarray((self.acceptance < STUCK_ACCEPTANCE) & (self.kept >= STUCK_STEPS))

    @override
    def __str__(self) -> str:
        """Every condition with its number."""
        lines = [f"{self.steps} steps of every walker, the first {self.burn_in} left out."]
        for name, (value, bar, met) in self.conditions.items():
            sign = ">=" if name in _AT_LEAST else "<="
            mark = "met" if met else "not met"
            lines.append(f"{_WORDS[name]}: {value:.4g}, wanted {sign} {bar:g}: {mark}.")
        mean = float(self.acceptance.mean())
        low, high = ACCEPTANCE_HINT
        lines.append(
            f"Acceptance {mean:.2f}, lowest of a walker {self.acceptance.min():.2f} (differential "
            f"evolution usually has {low:g} to {high:g}, Newton proposals more)."
        )
        return "\n".join(lines)


_AT_LEAST = {"steps_per_tau", "effective_draws", "effective_draws_each"}
_WORDS = {
    "steps_per_tau": "Steps in the longest autocorrelation time",
    "tau_drift": "Change of an autocorrelation time between checks",
    "rhat": "Largest R-hat between half ensembles",
    "effective_draws": "Fewest effective draws of bulk or tail",
    "effective_draws_each": "Fewest of one ensemble",
    "mean_error": "Largest Monte Carlo error of a mean, in standard deviations",
}


def check_convergence(
    samples: Array, moved: BoolArray, rule: StopRule, before: Sequence[ConvergenceCheck]
) -> ConvergenceCheck:
    """The convergence check of the steps so far; the first fifth counts as burn-in.

    Parameters
    ----------
    samples
        In any coordinates, shape ``(ensembles, walkers, steps, n)``.
    moved
        Whether a walker moved in a step, shape ``(ensembles, walkers, steps)``.
    rule
        The stop rule.
    before
        The checks before, oldest first, for the drift of the autocorrelation times.
    """
    steps = samples.shape[2]
    burn_in = int(BURN_IN * steps)
    kept = [samples[:, :, burn_in:, i] for i in range(samples.shape[3])]
    tau = _each(autocorrelation_time, kept)
    # Change since the latest check that is one autocorrelation time back or more.
    earlier = [x for x in before if steps - x.steps >= float(np.max(tau))]
    return ConvergenceCheck(
        rule=rule,
        steps=steps,
        burn_in=burn_in,
        tau=tau,
        drift=float(np.max(np.abs(tau / earlier[-1].tau - 1.0))) if earlier else np.inf,
        rhat=_each(split_rhat, kept),
        bulk=_each(bulk_ess, kept),
        tail=_each(tail_ess, kept),
        mean_error=_each(mean_error, kept),
        acceptance=moved[:, :, burn_in:].mean(axis=2),
    )


def _each(function: Callable[[Array], Array | float], values: Sequence[Array]) -> Array:
    return np.array([function(one) for one in values])


# Of checks to come, before one of them is said never to pass.
MOST_CHECKS = 1000
# A drift times the steps: its typical size beside that of the largest of so many independent
# normal errors, and the spread of its logarithm. From 7 samples of two knees with 8 parameters.
DRIFT_SIZE, DRIFT_SPREAD = 1.27, 0.5
# Checks that this counts for beside those made; the first have too few steps to be judged by.
PRIOR_CHECKS, FIRST_CHECKS = 10, 2


def expected_steps(checks: Sequence[ConvergenceCheck]) -> float:
    """Steps of every walker at which all conditions are expected to be met; infinite if unknown.

    Effective draws grow with the steps, errors of means fall with their root, and R-hat comes down
    to 1 as their inverse. The drift of the autocorrelation time is its own noise: it falls as the
    inverse of the steps on average, and sampling ends when it happens to be small enough, as
    likely earlier as later than said here.
    """
    latest = checks[-1]
    if latest.is_passed:
        return float(latest.steps)
    found = {name: (value, bar) for name, (value, bar, _) in latest.conditions.items()}
    at_least = ("steps_per_tau", "effective_draws", "effective_draws_each")
    needed = [found[x][1] / found[x][0] if found[x][0] > 0.0 else np.inf for x in at_least]
    value, bar = found["mean_error"]
    needed.append((value / bar) ** 2)
    value, bar = found["rhat"]
    needed.append((value - 1.0) / (bar - 1.0))
    return max(latest.steps * max(1.0, *needed), _drift_steps(checks))


def expected_end(checks: Sequence[ConvergenceCheck], spent: float) -> tuple[float, str]:
    """Steps at which sampling is expected to end, and the state of its convergence in words."""
    latest = checks[-1]
    found = latest.conditions
    length, wanted, _ = found["steps_per_tau"]
    words = (
        f"R-hat {found['rhat'][0]:.3f} of {found['rhat'][1]:g}, "
        f"{length:.0f} of {wanted:g} autocorrelation times, {spent:.0%} of the budget"
    )
    return min(expected_steps(checks), latest.steps / max(spent, 1e-9)), words


def _drift_steps(checks: Sequence[ConvergenceCheck]) -> float:
    """Median number of steps until the drift criterion is met."""
    if len(checks) < 2:
        return 0.0
    latest, seen = checks[-1], checks[FIRST_CHECKS:]
    block = latest.steps - checks[-2].steps
    scaled = [x.drift * x.steps for x in seen if np.isfinite(x.drift) and x.drift > 0.0]
    weight = PRIOR_CHECKS / (PRIOR_CHECKS + len(scaled))
    # Drift expected from the noise of autocorrelation times. The error of one, estimated over a
    # window of 5 of them, is that of Sokal; it changes with the steps since the check that it is
    # compared with.
    tau = float(np.max(latest.tau))
    since = block * np.ceil(tau / block)
    error = np.sqrt(2.0 * (10.0 * tau + 1.0) / latest.acceptance.size * since)
    largest = ndtri((1.0 + 0.5 ** (1.0 / len(latest.tau))) / 2.0)
    typical = weight * np.log(float(DRIFT_SIZE * largest * error))
    typical += (1.0 - weight) * np.mean(np.log(scaled or [1.0]))
    steps = latest.steps + block * np.arange(1, MOST_CHECKS + 1)
    small = ndtr((np.log(latest.rule.drift * steps) - typical) / DRIFT_SPREAD)
    passed = np.cumprod(1.0 - small) < 0.5
    return float(steps[np.argmax(passed)]) if passed.any() else np.inf


QUANTILES = (0.025, 0.5, 0.975)
# Autocorrelation times between draws that count as independent: exp(-4) where it falls evenly.
APART = 2.0


@declared
class Posterior:
    """A sample of the posterior with its convergence diagnostics."""

    parameters: Parameters = entry("The parameters, in the order of theta")
    samples: Array = array(
        "Theta of every step of every walker, burn-in included",
        *("ensemble", "walker", "step", "parameter"),
        unit=OF_PARAMETER,
    )
    log_likelihood: Array = array("Minus half the deviance", "ensemble", "walker", "step")
    checks: tuple[ConvergenceCheck, ...] = entry(
        "The numbers of every check, in their order; the last one decided"
    )
    outcome: SampleOutcome = entry("How sampling ended")
    prior: Array = array(
        "Draws of the prior within the bounds", "draw", "parameter", unit=OF_PARAMETER
    )
    excluded: InfeasiblePriorMass = entry("How much of the prior the posterior cannot reach")
    optima: Array = array(
        "What the walkers started around", "optimum", "parameter", unit=OF_PARAMETER
    )
    n_simulations: int = entry(
        "All simulations: fits, starts, steps, and the draws of the prior", unit="1"
    )
    n_walk_simulations: int = entry("Those of the steps alone", unit="1")
    seed: int = entry("Seed of all random numbers")
    record: Record = entry("The call, its settings and the time")

    @property
    def last_check(self) -> ConvergenceCheck:
        """The last check.

        Raises
        ------
        ValueError
            If sampling never began.
        """
        if not self.checks:
            raise ValueError(f"there is no sample: {self.outcome.sentence}")
        return self.checks[-1]

    @property
    def kept(self) -> Array:
        """Samples after burn-in, shape ``(ensembles, walkers, steps, n)``."""
        return self.samples[:, :, self.last_check.burn_in :]

    @property
    def kept_log_likelihood(self) -> Array:
        """Minus half the deviance after burn-in, shape ``(ensembles, walkers, steps)``."""
        return self.log_likelihood[:, :, self.last_check.burn_in :]

    @property
    def kept_log_prior(self) -> Array:
        """Log prior density of theta after burn-in, shape ``(ensembles, walkers, steps)``."""
        return log_prior(self.kept, self.parameters)

    @property
    def mean(self) -> Array:
        """Posterior mean of each parameter, shape ``(n,)``."""
        return np.asarray(self.kept.mean(axis=(0, 1, 2)))

    @property
    def sd(self) -> Array:
        """Posterior standard deviation of each parameter, shape ``(n,)``."""
        return np.asarray(self.kept.std(axis=(0, 1, 2), ddof=1))

    def quantiles(self, probabilities: ArrayLike = QUANTILES) -> Array:
        """Posterior quantiles of each parameter, shape ``(n, k)``."""
        return np.asarray(np.quantile(self.kept, np.asarray(probabilities), axis=(0, 1, 2)).T)

    def quantile_errors(self) -> Array:
        """Monte Carlo standard errors of the quantiles, shape ``(n, k)``."""
        each = [self.kept[..., i] for i in range(self.parameters.n)]
        return np.array([[quantile_error(x, p) for p in QUANTILES] for x in each])

    def independent(self, n_draws: int) -> IntArray:
        """Indices (ensemble, walker, kept step) of nearly independent draws, ``(n, 3)``.

        They are spread over all ensembles and walkers, and two of one walker lie at least two of
        the longest autocorrelation times apart.

        Parameters
        ----------
        n_draws
            How many; a sample too short to hold so many gives those it holds.
        """
        n_ensembles, n_walkers, n_steps = self.kept.shape[:3]
        apart = math.ceil(min(APART * float(np.max(self.last_check.tau)), n_steps))
        steps = np.arange(n_steps - 1, -1, -apart)
        places = np.array(
            [
                (ensemble, walker, step)
                for step in steps
                for walker in range(n_walkers)
                for ensemble in range(n_ensembles)
            ]
        )
        if len(places) < n_draws:
            return places
        return np.asarray(places[np.linspace(0, len(places) - 1, n_draws).round().astype(int)])

    @override
    def __str__(self) -> str:
        """A table of the parameters, how sampling ended, and the last convergence check."""
        if not self.checks:
            return self.outcome.sentence
        width = max(len(name) for name in self.parameters.names)
        lines = [f"{'':{width}}  {'mean':>9}  {'sd':>8}  {'2.5 %':>9}  {'97.5 %':>9}"]
        quantiles = self.quantiles((0.025, 0.975))
        for i, name in enumerate(self.parameters.names):
            numbers = f"{self.mean[i]:9.4f}  {self.sd[i]:8.4f}  {quantiles[i, 0]:9.4f}"
            lines.append(f"{name:{width}}  {numbers}  {quantiles[i, 1]:9.4f}")
        return "\n".join(
            [
                *lines,
                self.outcome.sentence,
                str(self.last_check),
                str(self.excluded),
                f"{self.n_simulations} simulations.",
            ]
        )


DELTA = 0.01
THRESHOLD = 0.05


@declared
class PriorSensitivity:
    """Change of each marginal posterior when the prior, or the likelihood, is raised to a power.

    Cumulative Jensen-Shannon distances per doubling of the power; where one is above 0.05 the
    marginal depends on it.
    """

    names: tuple[str, ...] = array("Parameters", "parameter", is_in_arrays=False)
    prior: Array = array("Distance by the power of the prior", "parameter")
    likelihood: Array = array("Distance by that of the likelihood", "parameter")

    @property
    def verdicts(self) -> tuple[str, ...]:
        """For each parameter: ``"data"``, ``"prior"``, ``"both"`` (they disagree) or ``"neither"``.

        Where both matter, prior and data pull to different places or are equally strong.
        """
        words = {(False, True): "data", (True, False): "prior", (True, True): "both"}
        pairs = zip(self.prior > THRESHOLD, self.likelihood > THRESHOLD, strict=True)
        return tuple(words.get((bool(p), bool(x)), "neither") for p, x in pairs)


def prior_sensitivity(posterior: Posterior) -> PriorSensitivity:
    """How the marginals change with the strength of prior and likelihood, by power scaling.

    The prior is scaled in the coordinates in which it is normal, so that a power of 4 halves its
    standard deviation and leaves its centre. Draws are weighted anew; nothing is simulated.

    References
    ----------
    N. Kallioinen et al., Detecting and diagnosing prior and likelihood sensitivity with
    power-scaling, Stat. Comput. 34 (2024) 57, doi:10.1007/s11222-023-10366-5.
    """
    parameters = posterior.parameters
    draws = parameters.to_working(posterior.kept).reshape(-1, parameters.n)
    likelihood = posterior.kept_log_likelihood.ravel()
    prior = log_prior_working(draws, parameters)
    return PriorSensitivity(
        names=parameters.names,
        prior=_sensitivities(draws, prior),
        likelihood=_sensitivities(draws, likelihood),
    )


def _sensitivities(draws: Array, component: Array) -> Array:
    """By column of `draws`, shape ``(k, n)``, for a log density, shape ``(k,)``."""
    powers = (1.0 / (1.0 + DELTA), 1.0 + DELTA)
    weights = [_normalised((power - 1.0) * component) for power in powers]
    doublings = 2.0 * np.log2(1.0 + DELTA)
    return np.array([sum(_distance(x, w) for w in weights) / doublings for x in draws.T])


def _normalised(log_weights: Array) -> Array:
    weights = np.exp(log_weights - np.max(log_weights))
    return np.asarray(weights / np.sum(weights))


def _distance(values: Array, weights: Array) -> float:
    """Cumulative Jensen-Shannon distance of the weighted values from the same unweighted.

    The larger of that between the distribution functions and that between their complements.
    """
    order = np.argsort(values, kind="stable")
    widths = np.diff(values[order])
    plain = np.arange(1, len(values)) / len(values)
    weighted = np.cumsum(weights[order])[:-1]
    return max(_between(plain, weighted, widths), _between(1 - plain, 1 - weighted, widths))


def _between(one: Array, other: Array, widths: Array) -> float:
    """Square root of the symmetric cumulative divergence, relative to its largest value."""
    low = np.finfo(float).tiny
    one, other = np.clip(one, low, None), np.clip(other, low, None)
    middle = 0.5 * (one + other)
    # The terms that make each half non-negative cancel in their sum.
    divergence = float(widths @ (one * np.log2(one / middle) + other * np.log2(other / middle)))
    largest = float(widths @ (one + other))
    return math.sqrt(max(0.0, divergence) / largest) if largest > 0 else 0.0
