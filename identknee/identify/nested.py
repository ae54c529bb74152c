"""A second opinion on the posterior, by nested sampling, and the evidence of the model."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import beta

from identknee.calibrate.problem import Problem
from identknee.identify.chains import ONE_SD
from identknee.identify.evaluation import evaluate
from identknee.identify.posterior import LogPosterior, prior_quantiles
from identknee.identify.posterior_sample import QUANTILES, Posterior
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.record import Record, record

N_LIVE = 300
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
    log_evidence
        Logarithm of the mean likelihood over the prior within the bounds, the likelihood being
        ``exp(-deviance / 2)``: without the constant that depends on the noise alone.
    log_evidence_error
        Its standard error.
    n_simulations
        How many it took.
    seed
        Of all random numbers.
    record
        The call, its settings and the time.
    """

    parameters: Parameters
    samples: Array
    weights: Array
    log_evidence: float
    log_evidence_error: float
    n_simulations: int
    seed: int
    record: Record

    def __post_init__(self) -> None:
        samples = frozen(self.samples, None, self.parameters.n, name="samples")
        object.__setattr__(self, "samples", samples)
        object.__setattr__(self, "weights", frozen(self.weights, len(samples), name="weights"))

    @property
    def effective_draws(self) -> float:
        """How many equally weighted draws are worth as much (Kish)."""
        return float(1.0 / np.sum(self.weights**2))

    def quantiles(self, probabilities: ArrayLike = QUANTILES) -> Array:
        """Posterior quantiles of each parameter, shape ``(n, k)``."""
        return np.array([self._quantiles(x, np.asarray(probabilities)) for x in self.samples.T])

    def quantile_errors(self, probabilities: ArrayLike = QUANTILES) -> Array:
        """Monte Carlo standard errors of the quantiles, shape ``(n, k)``."""
        p = np.asarray(probabilities, dtype=np.float64)
        count = self.effective_draws
        shape = (count * p + 1.0, count * (1.0 - p) + 1.0)
        low, high = (beta.ppf(tail, *shape) for tail in (ONE_SD, 1.0 - ONE_SD))
        return np.array(
            [0.5 * (self._quantiles(x, high) - self._quantiles(x, low)) for x in self.samples.T]
        )

    def _quantiles(self, values: Array, probabilities: Array) -> Array:
        order = np.argsort(values, kind="stable")
        below = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
        return np.asarray(np.interp(probabilities, below, values[order]))


def nested_posterior(problem: Problem, *, n_live: int = N_LIVE, seed: int = 0) -> NestedPosterior:
    """The posterior and the evidence by nested sampling with dynesty.

    It shares the density with `identknee.identify.sample.sample` and nothing else: no starts, no
    derivatives, no chains. It is a check, slower and not resumable.

    Parameters
    ----------
    problem
        Its residuals in units of their noise.
    n_live
        Live points; errors shrink with their square root, time grows with them.
    seed
        Of all random numbers.

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
    found = sampler.results
    log_weights = np.asarray(found.logwt - found.logz[-1])
    weights = np.exp(log_weights - np.max(log_weights))
    return NestedPosterior(
        parameters=parameters,
        samples=np.asarray(found.samples),
        weights=weights / np.sum(weights),
        log_evidence=float(found.logz[-1]),
        log_evidence_error=float(found.logzerr[-1]),
        n_simulations=int(np.sum(found.ncall)),
        seed=seed,
        record=recording.finish(),
    )


def quantile_differences(posterior: Posterior, nested: NestedPosterior) -> Array:
    """Differences of the 2.5, 50 and 97.5 % quantiles in their joint standard error, ``(n, 3)``."""
    difference = posterior.quantiles() - nested.quantiles()
    error = np.hypot(posterior.quantile_errors(), nested.quantile_errors())
    return np.asarray(difference / error)


def _dynesty() -> Any:
    try:
        import dynesty
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            'nested sampling needs the package dynesty; install it with: pip install "identknee'
            '[nested]"'
        ) from error
    return dynesty
