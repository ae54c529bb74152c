"""How much the posterior leans on the prior and how much on the data, from the sample alone."""

import math
from dataclasses import dataclass

import numpy as np

from identknee.identify.posterior.density import log_prior_working
from identknee.identify.posterior.posterior import Posterior
from identknee.runs.arrays import Array, frozen

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
