"""The posterior by nested sampling, for comparison, and the evidence of the model."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.problem import Problem
from identknee.identify.posterior.density import LogPosterior, prior_quantiles
from identknee.identify.posterior.posterior import QUANTILES, Posterior
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.record import Record, record

N_LIVE = 300
N_RESAMPLED = 100
# What dynesty takes for impossible; it cannot count with minus infinity.
IMPOSSIBLE = -1e300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NestedPosterior:
    """Weighted draws of the posterior by nested sampling, and the evidence.

    Attributes
    ----------
    parameters
        The parameters, in the order of theta.
    samples
        Theta, shape ``(k, n)``.
    weights
        Their posterior weights, sum 1, shape ``(k,)``.
    quantile_errors
        Standard errors of the 2.5, 50 and 97.5 % quantiles, shape ``(n, 3)``, from runs resampled
        from the live points of this one.
    log_evidence
        Logarithm of the mean likelihood over the prior within the bounds, the likelihood being
        ``exp(-deviance / 2)``: without the constant that depends on the noise alone.
    log_evidence_error
        Its standard error.
    n_simulations
        How many it took.
    seed
        Seed of all random numbers.
    record
        The call, its settings and the time.
    """

    parameters: Parameters
    samples: Array
    weights: Array
    quantile_errors: Array
    log_evidence: float
    log_evidence_error: float
    n_simulations: int
    seed: int
    record: Record

    def __post_init__(self) -> None:
        samples = frozen(self.samples, None, self.parameters.n, name="samples")
        object.__setattr__(self, "samples", samples)
        object.__setattr__(self, "weights", frozen(self.weights, len(samples), name="weights"))
        errors = frozen(self.quantile_errors, self.parameters.n, None, name="quantile_errors")
        object.__setattr__(self, "quantile_errors", errors)

    @property
    def effective_draws(self) -> float:
        """Effective sample size of weighted draws (Kish)."""
        return float(1.0 / np.sum(self.weights**2))

    def quantiles(self, probabilities: ArrayLike = QUANTILES) -> Array:
        """Posterior quantiles of each parameter, shape ``(n, k)``."""
        return np.array(
            [weighted_quantiles(x, self.weights, probabilities) for x in self.samples.T]
        )


def weighted_quantiles(values: Array, weights: Array, probabilities: ArrayLike) -> Array:
    """Quantiles of weighted values, both of shape ``(k,)``, between them linear.

    Examples
    --------
    >>> weighted_quantiles(np.array([3.0, 1.0, 2.0]), np.array([0.2, 0.4, 0.4]), [0.5])
    array([1.75])
    """
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    return np.asarray(np.interp(np.asarray(probabilities), below, values[order]))


def nested_posterior(problem: Problem, *, n_live: int = N_LIVE, seed: int = 0) -> NestedPosterior:
    """The posterior and the evidence by nested sampling with dynesty.

    It shares the density with `identknee.identify.posterior.sample.sample` and nothing else: no
    starts, no derivatives, no chains. It is a check, slower and not resumable.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise.
    n_live
        Live points; errors shrink with their square root, time grows with them.
    seed
        Seed of all random numbers.

    Raises
    ------
    ModuleNotFoundError
        If dynesty is not installed.
    ValueError
        If there are fewer than two live points a parameter.

    References
    ----------
    J. S. Speagle, dynesty: a dynamic nested sampling package for estimating Bayesian posteriors
    and evidences, MNRAS 493 (2020) 3132-3158, doi:10.1093/mnras/staa278.
    """
    density = LogPosterior(problem=problem)
    parameters = density.parameters
    if n_live < 2 * parameters.n:
        raise ValueError(
            f"nested sampling of {parameters.n} parameters needs at least {2 * parameters.n} live "
            f"points, got {n_live}"
        )
    dynesty = _dynesty()
    recording = record("nested", {"n_live": n_live}, {}, seed)

    def log_likelihood(theta: Array) -> float:
        evaluation = evaluate(problem, theta)
        return -0.5 * evaluation.deviance if evaluation.is_finite else IMPOSSIBLE

    sampler = dynesty.NestedSampler(
        log_likelihood,
        lambda unit: prior_quantiles(parameters, np.asarray(unit)),
        parameters.n,
        nlive=n_live,
        # Uniform draws within ellipsoids waste most of their simulations on a curved ridge.
        sample="rwalk",
        rstate=np.random.default_rng(seed),
    )
    sampler.run_nested(print_progress=False)
    results = sampler.results
    return NestedPosterior(
        parameters=parameters,
        samples=np.asarray(results.samples),
        weights=_weights(results),
        quantile_errors=_quantile_errors(results, seed),
        log_evidence=float(results.logz[-1]),
        log_evidence_error=float(results.logzerr[-1]),
        n_simulations=int(np.sum(results.ncall)),
        seed=seed,
        record=recording.finish(),
    )


def quantile_differences(posterior: Posterior, nested: NestedPosterior) -> Array:
    """Differences of the 2.5, 50 and 97.5 % quantiles in their joint standard error, ``(n, 3)``."""
    difference = posterior.quantiles() - nested.quantiles()
    error = np.hypot(posterior.quantile_errors(), nested.quantile_errors)
    return np.asarray(difference / error)


def _weights(results: Any) -> Array:
    weights = np.exp(results.logwt - np.max(results.logwt))
    return np.asarray(weights / np.sum(weights), dtype=np.float64)


def _quantile_errors(results: Any, seed: int) -> Array:
    """Spread of the quantiles over runs with other live points and other prior volumes.

    The number of effective draws would not do: live points share ancestors, and how much of the
    prior each one stands for is itself an estimate.
    """
    from dynesty.utils import jitter_run, resample_run

    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    rows = []
    for _ in range(N_RESAMPLED):
        run = jitter_run(resample_run(results, rstate=generator), rstate=generator)
        columns = np.asarray(run.samples).T
        rows.append([weighted_quantiles(x, _weights(run), QUANTILES) for x in columns])
    return np.asarray(np.std(rows, axis=0, ddof=1))


def _dynesty() -> Any:
    try:
        import dynesty
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            'nested sampling needs the package dynesty; install it with: pip install "identknee'
            '[nested]"'
        ) from error
    return dynesty
