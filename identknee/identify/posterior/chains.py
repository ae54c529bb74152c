"""What a sample of an ensemble of walkers is worth: autocorrelation, R-hat, effective draws.

Every function takes the values of one quantity as (ensemble, walker, step), never flattened: draws
of one walker depend on one another, and only the order of its steps shows how much.
"""

import numpy as np
from scipy.stats import beta, norm, rankdata

from identknee.runs.arrays import Array

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
    """Steps after which draws are as good as independent: the integrated autocorrelation time.

    At least 1, so that there are never more effective draws than draws; infinite where nothing
    moves.

    Parameters
    ----------
    values
        Shape ``(ensembles, walkers, steps)``.

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
    """Number of independent draws worth as much for the mean: all draws over tau.

    Parameters
    ----------
    values
        Shape ``(ensembles, walkers, steps)``.
    """
    return float(values.size / autocorrelation_time(values))


def normal_scores(values: Array) -> Array:
    """Normal quantiles of the ranks among all values, same shape."""
    ranks = rankdata(values, method="average").reshape(values.shape)
    return np.asarray(norm.ppf((ranks - 0.375) / (values.size + 0.25)))


def bulk_draws(values: Array) -> Array:
    """Effective draws of the ranks, by ensemble, shape ``(ensembles,)``; their sum is the total.

    References
    ----------
    A. Vehtari et al., Rank-normalization, folding, and localization: an improved R-hat, Bayesian
    Anal. 16 (2021) 667-718, doi:10.1214/20-BA1221, section 4, with tau in place of chains.
    """
    return _by_ensemble(normal_scores(values))


def tail_draws(values: Array) -> Array:
    """Effective draws of being below the 5 or above the 95 % quantile, the fewer, by ensemble."""
    low, high = np.quantile(values, [TAIL, 1.0 - TAIL])
    return np.minimum(
        _by_ensemble((values <= low).astype(float)), _by_ensemble((values >= high).astype(float))
    )


def split_rhat(values: Array) -> float:
    """Rank-normalised R-hat over the halves of the ensembles, of place or of spread, the larger.

    A chain is one half of one ensemble, all its walkers together: walkers of an ensemble are not
    independent, ensembles are.

    Parameters
    ----------
    values
        Shape ``(ensembles, walkers, steps)``.

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
    between = beta.ppf([ONE_SD, 1.0 - ONE_SD], *shape)
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
