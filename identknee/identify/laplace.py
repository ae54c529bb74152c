"""Laplace approximation truncated at the bounds: intervals and evidence."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
import scipy
from scipy.linalg import cho_factor, cho_solve
from scipy.special import log_ndtr, logsumexp, ndtr, ndtri_exp

from identknee.calibrate.problem import Evaluation
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, BoolArray, IntArray, frozen

# Share of a component below which what bounds cut off is ignored: for the component itself and
# for the intervals of the others.
LEAST_CUT, LEAST_SHARED = 1e-6, 1e-4
# Points at which the share of a Gaussian within bounds is averaged, and the seed of their order.
N_POINTS, POINTS_SEED = 1024, 0
# Tail of a 95 % interval on either side; where one end is a bound the other tail is twice this.
TAIL = 0.025
# Points whose log weight lies so far below the largest do not count.
NEGLIGIBLE = 40.0
# Standard deviations: a lower bound so far off cuts off nothing.
FAR = -9.0
# Halvings of a bracket around a quantile.
N_HALVINGS = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Draws:
    """Weighted draws of some components within their bounds, in units of their Cholesky factor."""

    components: IntArray
    factor: Array
    points: Array
    log_weights: Array


def log_box_probability(mean: Array, covariance: Array, lower: Array, upper: Array) -> float:
    """Log probability that a Gaussian vector lies between `lower` and `upper`.

    Averaged over points of a Sobol sequence; exact where one component is cut off at most.

    Parameters
    ----------
    mean, covariance
        Mean and covariance of the vector, shapes ``(p,)`` and ``(p, p)``.
    lower, upper
        Bounds, perhaps infinite, shape ``(p,)``.

    References
    ----------
    A. Genz, Numerical computation of multivariate normal probabilities, J. Comput. Graph. Stat. 1
    (1992) 141-149, doi:10.1080/10618600.1992.10477010.
    """
    inside, cut = _cut(mean, covariance, (lower, upper), LEAST_CUT)
    if cut.size <= 1:
        return float(inside[cut].sum())
    drawn = _draws(mean, covariance, lower, upper, cut)
    return float(logsumexp(drawn.log_weights) - np.log(N_POINTS))


class BoxMarginals:
    """95 % intervals of single components of a Gaussian vector, the others within their bounds.

    A bound that cuts off a tail of more than 2.5 % is the end of the interval. Exact where one
    component is cut off at most, else averaged over points of a Sobol sequence.

    Parameters
    ----------
    mean, covariance
        Of the vector, shapes ``(p,)`` and ``(p, p)``.
    lower, upper
        Bounds, perhaps infinite, shape ``(p,)``.
    """

    def __init__(self, mean: Array, covariance: Array, lower: Array, upper: Array) -> None:
        self._mean, self._covariance, self._lower, self._upper = mean, covariance, lower, upper
        _, self._cut = _cut(mean, covariance, (lower, upper), LEAST_SHARED)
        self._shared = _draws(mean, covariance, lower, upper, self._cut)

    def interval(self, i: int) -> tuple[float, float, bool, bool]:
        """Ends of the interval of one component, and which of them are bounds."""
        mean, covariance, lower, upper = self._mean, self._covariance, self._lower, self._upper
        others = self._shared
        if i in self._cut:
            others = _draws(mean, covariance, lower, upper, self._cut[self._cut != i])
        slope = np.linalg.solve(others.factor, covariance[others.components, i])
        sd = float(np.sqrt(covariance[i, i] - slope @ slope))
        middles = mean[i] + others.points @ slope
        below, above = ((x - middles) / sd for x in (lower[i], upper[i]))
        weights = np.exp(others.log_weights - others.log_weights.max())
        weights /= weights.sum()
        from_low = bool(weights @ np.exp(log_ndtr(below)) > TAIL)
        to_high = bool(weights @ np.exp(log_ndtr(-above)) > TAIL)
        mixture = others.log_weights, middles, sd, below, above
        start = _quantile((2.0 if to_high else 1.0) * TAIL, *mixture)
        end = _quantile(1.0 - (2.0 if from_low else 1.0) * TAIL, *mixture)
        low, high = float(lower[i]) if from_low else start, float(upper[i]) if to_high else end
        return low, high, from_low, to_high


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Truncated:
    """Standard normal variables between two ends each, in their lower tails.

    There small probabilities keep their digits: those in upper tails are mirrored.
    """

    is_mirrored: BoolArray
    log_top: Array  # log probability below the upper end
    share_cut: Array  # share of that below the lower end

    @property
    def log_mass(self) -> Array:
        """Log probability between the ends."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.log_top + np.log1p(-self.share_cut))

    def quantile(self, share: Array) -> Array:
        """Quantile `share` of the variable truncated between the ends."""
        share = np.where(self.is_mirrored, 1.0 - share, share)
        found = ndtri_exp(self.log_top + np.log(share + (1.0 - share) * self.share_cut))
        return np.asarray(np.where(self.is_mirrored, -found, found))


def _truncated(low: Array, high: Array) -> _Truncated:
    """Standard normal variables between `low` and `high`."""
    mirrored = np.asarray(low > -high)
    low, high = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    top = log_ndtr(high)
    cut = np.exp(log_ndtr(low) - top)
    return _Truncated(is_mirrored=mirrored, log_top=top, share_cut=cut)


def log_interval_mass(low: Array, high: Array) -> Array:
    """Log probability that a standard normal variable lies between `low` and `high`."""
    return _truncated(low, high).log_mass


def _cut(
    mean: Array, covariance: Array, bounds: tuple[Array, Array], least: float
) -> tuple[Array, IntArray]:
    """Log probability of each component within its bounds; which are truncated, the most first."""
    sd = np.sqrt(np.diag(covariance))
    low, high = ((x - mean) / sd for x in bounds)
    inside = log_interval_mass(low, high)
    # The components cut off most come first: what follows then varies least.
    return inside, np.argsort(inside)[: np.count_nonzero(inside < -least)]


def _draws(mean: Array, covariance: Array, lower: Array, upper: Array, cut: IntArray) -> _Draws:
    """Points of these components within their bounds, each with its weight."""
    n = N_POINTS if cut.size else 1
    factor = np.asarray(np.linalg.cholesky(covariance[np.ix_(cut, cut)]), dtype=np.float64)
    drawn, weights = np.zeros((n, cut.size)), np.zeros(n)
    points = _sobol_points(max(cut.size, 1))
    for i in range(cut.size):
        known = mean[cut[i]] + drawn[:, :i] @ factor[i, :i]
        low, high = ((x[cut[i]] - known) / factor[i, i] for x in (lower, upper))
        between = _truncated(low, high)
        weights += between.log_mass
        drawn[:, i] = between.quantile(points[:, i])
    return _Draws(components=cut, factor=factor, points=drawn, log_weights=weights)


@lru_cache(maxsize=16)
def _sobol_points(n: int) -> Array:
    points = np.asarray(scipy.stats.qmc.Sobol(n, seed=POINTS_SEED).random(N_POINTS))
    points.flags.writeable = False
    return points


def _quantile(
    share: float, log_weights: Array, middles: Array, sd: float, low: Array, high: Array
) -> float:
    whole = log_weights + log_interval_mass(low, high)
    # A middle far beyond the bounds has no share within them.
    used = whole > whole.max() - NEGLIGIBLE
    offset, log_weights = whole.max(), log_weights[used]
    middles, low, high = middles[used], low[used], high[used]
    ends = middles + sd * _truncated(low, high).quantile(np.full(low.size, share))
    left, right = float(ends.min()), float(ends.max())
    wanted = share * float(np.exp(whole[used] - offset).sum())
    is_free = bool(np.all(low < FAR) and np.all(high > 0.5 * FAR))
    weights = np.exp(log_weights - offset) if is_free else log_weights
    for _ in range(N_HALVINGS if right > left else 0):
        middle = 0.5 * (left + right)
        reached = np.clip((middle - middles) / sd, low, high)
        if is_free:
            below = float(weights @ ndtr(reached))
        else:
            mass = log_interval_mass(low, reached)
            below = float(np.exp(log_weights + mass - offset).sum())
        left, right = (middle, right) if below < wanted else (left, middle)
    return 0.5 * (left + right)


# Share of the rise of the deviance: an interval of which priors make more is made by priors.
MOST = 0.5
# Share of a standard deviation that rounding may move an end by.
ROUNDING = 1e-9

Interval = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalGaussian:
    """Likelihood times prior near a point: a Gaussian within bounds, in units of the priors' sd.

    Attributes
    ----------
    middle, covariance
        Of the Gaussian, shapes ``(p,)`` and ``(p, p)``.
    lower, upper
        The bounds, shape ``(p,)``.
    log_evidence
        Logarithm of its integral within them.
    """

    middle: Array
    covariance: Array
    lower: Array
    upper: Array
    log_evidence: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Laplace:
    """The posterior near a fit: Gaussian in the coordinates in which the priors are.

    These are the logarithms of parameters with lognormal priors and the others as they are. An
    interval is computed when it is first asked for: of many nuisances few are.

    Attributes
    ----------
    theta
        The fit, shape ``(p,)``.
    sd
        Posterior standard deviation of each parameter in its own unit, shape ``(p,)``.
    log_evidence
        Logarithm of the integral of likelihood times prior within the bounds.
    """

    theta: Array
    sd: Array
    log_evidence: float
    _parameters: Parameters = field(repr=False)
    _near: LocalGaussian = field(repr=False)

    def __post_init__(self) -> None:
        for name in ("theta", "sd"):
            object.__setattr__(self, name, frozen(getattr(self, name), None, name=name))

    def interval(self, i: int) -> Interval:
        """Ends of the 95 % interval of one parameter; None for an end that the data do not set.

        Such an end is a bound, or the linear interval does not contain the estimate.
        """
        if i not in self._intervals:
            self._intervals[i] = self._computed(i)
        return self._intervals[i]

    def made_by_priors(self) -> BoolArray:
        """Whose interval owes more to priors than to the data, shape ``(p,)``, to first order.

        They make more than half of the rise of the deviance on the way to its ends, the others
        refitted. Priors of nuisances are stated errors of the data, and count as these do.
        """
        covariance, is_belief = self._near.covariance, self._parameters.is_of_interest
        share = (covariance[is_belief] ** 2).sum(axis=0) / np.diag(covariance)
        return np.asarray(share > MOST)

    @cached_property
    def _intervals(self) -> dict[int, Interval]:
        return {}

    @cached_property
    def _marginals(self) -> BoxMarginals:
        x = self._near
        return BoxMarginals(x.middle, x.covariance, x.lower, x.upper)

    def _computed(self, i: int) -> Interval:
        low, high, is_lower_bound, is_upper_bound = self._marginals.interval(i)
        is_log, at = bool(self._parameters.is_log[i]), float(self.theta[i])
        prior_sd = float(self._parameters.prior_sd[i])
        point, scale = (np.log(at), at) if is_log else (at, 1.0)
        low, high = low * prior_sd, high * prior_sd
        # A fit stopped before its minimum is not where the linear model puts the parameters, and
        # neither end of such an interval is known.
        slack = ROUNDING * float(self.sd[i]) / scale
        if low > point + slack or high < point - slack:
            return None, None
        if is_log:
            low, high = float(np.exp(low)), float(np.exp(high))
        return None if is_lower_bound else min(low, at), None if is_upper_bound else max(high, at)


def _gaussian(at: Evaluation, parameters: Parameters, is_active: BoolArray | None) -> LocalGaussian:
    """The Gaussian whose logarithm has the slope and curvature of the deviance at a point."""
    is_log, sd = np.array(parameters.is_log), parameters.prior_sd
    point, center, lower, upper = (
        _log_where_lognormal(x, is_log) / sd
        for x in (at.theta, parameters.center, parameters.lower, parameters.upper)
    )
    jacobian = at.jacobian * np.where(is_log, at.theta, 1.0) * sd
    information = cho_factor(jacobian.T @ jacobian, lower=True)
    covariance = cho_solve(information, np.eye(point.size))
    gradient = jacobian.T @ at.residuals
    if is_active is not None:
        gradient = np.where(is_active, gradient, 0.0)
    middle = point - covariance @ gradient
    log_evidence = (
        -0.5 * (at.deviance - gradient @ covariance @ gradient)
        - log_interval_mass(lower - center, upper - center).sum()
        - np.log(np.diag(information[0])).sum()
        + log_box_probability(middle, covariance, lower, upper)
    )
    return LocalGaussian(
        middle=middle,
        covariance=covariance,
        lower=lower,
        upper=upper,
        log_evidence=float(log_evidence),
    )


def log_evidence(at: Evaluation, parameters: Parameters, is_active: BoolArray) -> float:
    """Log evidence of a fit, up to a constant of the data: what models of the same data compare.

    With slope ``g`` and curvature ``H = J'J`` of half the deviance ``D`` in units of the priors'
    standard deviations, and the middle ``m = x - H^-1 g`` of the Gaussian that they make,

        ``log Z = -(D - g' H^-1 g) / 2 - log|H| / 2 + log P(lower < N(m, H^-1) < upper)
        - log P(lower < N(center, 1) < upper)``.

    The last term norms priors that are cut off at bounds, such as half-normal ones. Exact for a
    model that is linear in these coordinates, also where a bound is active.

    Parameters
    ----------
    at
        Whitened residuals of the data, those of the priors after them, and their derivatives.
    parameters
        With bounds and priors.
    is_active
        Which bounds are active, shape ``(p,)``. The other parameters are taken to be where their
        slope is zero: what a fit that was stopped might still gain does not count.

    References
    ----------
    R. E. Kass and A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995) 773-795,
    doi:10.1080/01621459.1995.10476572, equation 5.
    """
    return _gaussian(at, parameters, is_active).log_evidence


def laplace(at: Evaluation, parameters: Parameters, noise_scale: Array) -> Laplace:
    """The Laplace approximation around a fit, priors truncated at the bounds.

    The evidence is that of `log_evidence` with the constant of the data, slopes of all parameters
    counted. Exact for a model that is linear in these coordinates, also where a bound is active.

    Parameters
    ----------
    at
        Whitened residuals of the m data, those of the priors after them, and their derivatives.
    parameters
        With bounds and priors.
    noise_scale
        Diagonal of the Cholesky factor of the covariance of the data, shape ``(m,)``.
    """
    near = _gaussian(at, parameters, None)
    constant = -0.5 * len(noise_scale) * np.log(2.0 * np.pi) - np.log(noise_scale).sum()
    sd = np.sqrt(np.diag(near.covariance)) * parameters.prior_sd
    return Laplace(
        theta=at.theta,
        sd=np.where(parameters.is_log, at.theta, 1.0) * sd,
        log_evidence=near.log_evidence + float(constant),
        _parameters=parameters,
        _near=near,
    )


def _log_where_lognormal(values: Array, is_log: BoolArray) -> Array:
    with np.errstate(divide="ignore"):
        return np.where(is_log, np.log(np.where(is_log, values, 1.0)), values)
