"""A sample of the posterior with its convergence diagnostics."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from identknee.identify.posterior.convergence import ConvergenceCheck, SampleOutcome, quantile_error
from identknee.identify.posterior.density import InfeasiblePriorMass, log_prior, log_prior_working
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, IntArray, frozen
from identknee.runs.record import Record

QUANTILES = (0.025, 0.5, 0.975)
# Autocorrelation times between draws that count as independent: exp(-4) where it falls evenly.
APART = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Posterior:
    """A sample of the posterior with its convergence diagnostics.

    Attributes
    ----------
    parameters
        The parameters, in the order of theta.
    samples
        Theta of every step of every walker, burn-in included, shape
        ``(ensembles, walkers, steps, n)``.
    log_likelihood
        Minus half the deviance, shape ``(ensembles, walkers, steps)``.
    checks
        The numbers of every check, in their order; the last one decided.
    outcome
        How sampling ended.
    prior
        Draws of the prior within the bounds, shape ``(draws, n)``.
    excluded
        How much of the prior the posterior cannot reach.
    optima
        What the walkers started around, shape ``(k, n)``.
    n_simulations
        All simulations: fits, starts, steps, and the draws of the prior.
    n_walk_simulations
        Those of the steps alone.
    seed
        Seed of all random numbers.
    record
        The call, its settings and the time.
    """

    parameters: Parameters
    samples: Array
    log_likelihood: Array
    checks: tuple[ConvergenceCheck, ...]
    outcome: SampleOutcome
    prior: Array
    excluded: InfeasiblePriorMass
    optima: Array
    n_simulations: int
    n_walk_simulations: int
    seed: int
    record: Record

    def __post_init__(self) -> None:
        n = self.parameters.n
        samples = frozen(self.samples, None, None, None, n, name="samples")
        object.__setattr__(self, "samples", samples)
        likelihood = frozen(self.log_likelihood, *samples.shape[:3], name="log_likelihood")
        object.__setattr__(self, "log_likelihood", likelihood)
        object.__setattr__(self, "prior", frozen(self.prior, None, n, name="prior"))
        object.__setattr__(self, "optima", frozen(self.optima, None, n, name="optima"))

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

    def quantile_errors(self, probabilities: Sequence[float] = QUANTILES) -> Array:
        """Monte Carlo standard errors of the quantiles, shape ``(n, k)``."""
        each = [self.kept[..., i] for i in range(self.parameters.n)]
        return np.array([[quantile_error(x, p) for p in probabilities] for x in each])

    def independent(self, n_draws: int, *, or_fewer: bool = False) -> IntArray:
        """Indices (ensemble, walker, kept step) of nearly independent draws, ``(n_draws, 3)``.

        They are spread over all ensembles and walkers, and two of one walker lie at least two of
        the longest autocorrelation times apart.

        Parameters
        ----------
        n_draws
            How many.
        or_fewer
            Whether a sample too short to hold so many gives those it holds.

        Raises
        ------
        ValueError
            If the sample is too short and fewer will not do.
        """
        kept = self.kept
        n_ensembles, n_walkers, n_steps = kept.shape[:3]
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
        if len(places) < n_draws and or_fewer:
            return places
        if len(places) < n_draws:
            raise ValueError(
                f"the sample holds {len(places)} independent draws, fewer than the {n_draws} asked "
                "for; sample longer or ask for fewer"
            )
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PriorSensitivity:
    """Change of each marginal posterior when the prior, or the likelihood, is raised to a power.

    Attributes
    ----------
    names
        Parameters.
    prior, likelihood
        Cumulative Jensen-Shannon distance per doubling of the power, shape ``(n,)``; above 0.05
        the marginal depends on it.
    """

    names: tuple[str, ...]
    prior: Array
    likelihood: Array

    def __post_init__(self) -> None:
        for name in ("prior", "likelihood"):
            object.__setattr__(self, name, frozen(getattr(self, name), len(self.names), name=name))

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
    working = parameters.to_working(posterior.kept)
    draws = working.reshape(-1, parameters.n)
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
