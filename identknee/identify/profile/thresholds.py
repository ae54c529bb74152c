"""Thresholds on the rise of the deviance: by chi2, by F, by parametric bootstrap."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy
from numpy.typing import ArrayLike

from identknee.calibrate.bounded_least_squares import minimise, solve_constrained
from identknee.calibrate.evaluation import Evaluator
from identknee.calibrate.problem import Problem
from identknee.calibrate.quantity import Quantity
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.executors import Executor, serial, spawn_seeds
from identknee.runs.store import Store, resumable_map

NewData = Callable[[np.random.SeedSequence], Problem]

# Of the deviance: what a fit may leave; the statistic is then right to 1e-4 of its quantile.
TOLERANCE = 2e-4
LIMITS_LEVEL = 0.95


def chi2_threshold(level: float, n_quantities: int = 1) -> float:
    """Rise of the deviance that bounds a set of confidence `level` where the noise is known.

    Parameters
    ----------
    level
        Confidence level, between 0 and 1.
    n_quantities
        How many numbers are held at once: 2 for a pair of parameters.

    Raises
    ------
    ValueError
        If the level is not between 0 and 1.

    Examples
    --------
    >>> round(chi2_threshold(0.95), 6)
    3.841459
    """
    _check_level(level)
    return float(scipy.stats.chi2.ppf(level, n_quantities))


def threshold_below(threshold: float, level: float, wanted: float, n_quantities: int = 1) -> float:
    """The threshold for a level up to that of another, in the chi-squared law's proportion.

    Parameters
    ----------
    threshold, level
        A threshold of any origin, and the level it stands for.
    wanted
        The level wanted, above 0 and up to `level`.
    n_quantities
        How many numbers are held at once.

    Raises
    ------
    ValueError
        If the level wanted is not one of those.

    Examples
    --------
    >>> round(threshold_below(3.841459, 0.95, 0.68), 3)
    0.989
    """
    if not 0.0 < wanted <= level:
        raise ValueError(
            f"the level must be above 0 and at most the profile's {level:g}, got {wanted:g}"
        )
    law = scipy.stats.chi2(n_quantities)
    return threshold * float(law.ppf(wanted) / law.ppf(level))


def f_threshold(level: float, degrees_of_freedom: int, n_quantities: int = 1) -> float:
    """The same for noise estimated from the residuals of the fit.

    The rise of the deviance, in units of the estimated noise, divided by `n_quantities` has an F
    distribution for a linear model.

    Parameters
    ----------
    level
        Confidence level, between 0 and 1.
    degrees_of_freedom
        Degrees of freedom of the noise estimate: residuals minus the parameters they determine.
    n_quantities
        How many numbers are held at once.

    Raises
    ------
    ValueError
        If the level is not between 0 and 1, or there is no degree of freedom.

    References
    ----------
    D. M. Bates and D. G. Watts, Nonlinear Regression Analysis and Its Applications (1988),
    section 6.1.2, doi:10.1002/9780470316757.

    Examples
    --------
    >>> round(f_threshold(0.95, 10), 4)
    4.9646
    """
    _check_level(level)
    if degrees_of_freedom < 1:
        raise ValueError(
            f"the noise needs at least 1 degree of freedom, got {degrees_of_freedom}; "
            "measure more or hold parameters"
        )
    return n_quantities * float(scipy.stats.f.ppf(level, n_quantities, degrees_of_freedom))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BootstrapStatistics:
    """Parametric bootstrap of the likelihood ratio at one parameter set.

    Attributes
    ----------
    names
        Names of the quantities.
    statistics
        Rise of the deviance when a quantity is held at its true value, one row a data set, shape
        ``(n, q)``; infinite where the model has no fit there, NaN where the data have no fit.
    """

    names: tuple[str, ...]
    statistics: Array

    def __post_init__(self) -> None:
        q = len(self.names)
        object.__setattr__(self, "statistics", frozen(self.statistics, None, q, name="statistics"))

    @property
    def n_failed(self) -> int:
        """Data sets without a fit, left out of the quantiles."""
        return int(np.isnan(self.statistics).any(axis=1).sum())

    def thresholds(self, level: float) -> Array:
        """Rise of the deviance that bounds a set of this level, with its limits, shape ``(q, 3)``.

        The first column is the threshold, the others are its 95 % confidence limits from the order
        of the statistics.

        Raises
        ------
        ValueError
            If the data sets are too few for the level.
        """
        _check_level(level)
        complete = self.statistics[~np.isnan(self.statistics).any(axis=1)]
        if len(complete) * min(level, 1.0 - level) < 1.0:
            raise ValueError(
                f"{len(complete)} data sets do not determine a quantile at {level:g}; use "
                f"{math.ceil(1.0 / min(level, 1.0 - level))} or more"
            )
        return np.sort(complete, axis=0)[list(_ranks(len(complete), level))].T


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResimulatedProblem:
    """A problem with data simulated at one parameter set.

    Attributes
    ----------
    problem
        Residuals in units of their noise; they must depend on the data by subtraction alone.
    shift
        What is subtracted from its residuals, shape ``(m,)``.
    """

    problem: Problem
    shift: Array

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals against the new data, shape ``(m,)``."""
        return np.asarray(self.problem.residuals(theta) - self.shift)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        return self.problem.jacobian(theta)


def resimulated(problem: Problem, truth: Array, seed: np.random.SeedSequence) -> ResimulatedProblem:
    """The problem with data simulated at `truth`: its prediction there plus standard normal noise.

    With the first two arguments bound it is what `bootstrap_statistics` asks for.

    Raises
    ------
    ValueError
        If the model has no prediction at `truth`.
    """
    at_truth = np.asarray(problem.residuals(np.asarray(truth, dtype=np.float64)))
    if not np.isfinite(at_truth).all():
        raise ValueError("the model has no prediction at the parameter set to simulate data at")
    noise = np.random.default_rng(seed).standard_normal(at_truth.size)
    return ResimulatedProblem(problem=problem, shift=at_truth + noise)


def bootstrap_statistics(
    new_data: NewData,
    truth: ArrayLike,
    quantities: Sequence[Quantity],
    *,
    n: int = 1000,
    seed: int = 0,
    executor: Executor = serial,
    store: Store | None = None,
) -> BootstrapStatistics:
    """Likelihood ratios whose quantiles are thresholds for this model and these few data.

    The likelihood ratio of each quantity's true value is computed for data sets simulated at
    `truth`; its quantile takes the place of that of the chi-squared law, which it approaches as
    data grow. All quantities share the same data sets: one fit each, and one more a quantity.

    Parameters
    ----------
    new_data
        Function from a seed to the problem with new data simulated at `truth`, residuals in units
        of their noise; from the top of a module if `executor` runs processes.
    truth
        Theta of the simulated data, shape ``(p,)``: the best fit to the measured ones.
    quantities
        Each gets a column of its own.
    n
        How many data sets.
    seed
        Seed of the data sets.
    executor
        Anything with an ordered ``map``.
    store
        Where finished data sets are kept; from `identknee.runs.store.open_work`.

    References
    ----------
    C. Toensing, B. Steiert, J. Timmer and C. Kreutz, Likelihood-ratio test statistic for the
    finite-sample case in nonlinear ordinary differential equation models, PLoS Computational
    Biology 19 (2023) e1011417, doi:10.1371/journal.pcbi.1011417.
    """
    theta = np.asarray(truth, dtype=np.float64)
    rows = resumable_map(
        partial(_statistics, new_data, theta, tuple(quantities)),
        [_as_numbers(x) for x in spawn_seeds(seed, n)],
        executor=executor,
        store=store,
        name="bootstrap",
        description="simulating data anew",
    )
    return BootstrapStatistics(
        names=tuple(x.name for x in quantities),
        statistics=np.array(rows, dtype=np.float64).reshape(n, len(quantities)),
    )


def _statistics(
    new_data: NewData, truth: Array, quantities: Sequence[Quantity], seed: tuple[int, int]
) -> list[float]:
    entropy, key = seed
    problem = new_data(np.random.SeedSequence(entropy, spawn_key=(key,)))
    evaluator = Evaluator(problem)
    best = minimise(evaluator, truth, tolerance=TOLERANCE)
    lowest = best.evaluation.deviance
    held = [
        _held(evaluator, best.evaluation.theta if np.isfinite(lowest) else truth, quantity, truth)
        for quantity in quantities
    ]
    # A fit that is held may have found its way to where the free one did not.
    lowest = min([lowest, *held])
    return [x - lowest if np.isfinite(lowest) else np.nan for x in held]


def _held(evaluator: Evaluator, start: Array, quantity: Quantity, truth: Array) -> float:
    """Lowest deviance with the quantity at its true value; infinite where no fit got there."""
    solved = solve_constrained(
        evaluator,
        start,
        quantity=quantity,
        target=quantity.evaluate(truth)[0],
        tolerance=TOLERANCE,
    )
    return solved.evaluation.deviance if solved.is_on_target else np.inf


def _as_numbers(seed: np.random.SeedSequence) -> tuple[int, int]:
    entropy = seed.entropy
    if not isinstance(entropy, int):  # pragma: no cover - spawned from a whole number
        raise TypeError
    return entropy, int(seed.spawn_key[-1])


def _ranks(n: int, level: float) -> tuple[int, int, int]:
    """Places among n sorted values of a quantile, and of its lower and upper limit."""
    tail = 0.5 * (1.0 - LIMITS_LEVEL)
    law = scipy.stats.binom(n, level)
    places = (np.ceil(n * level) - 1, law.ppf(tail) - 1, law.ppf(1.0 - tail))
    middle, low, high = (int(np.clip(x, 0, n - 1)) for x in places)
    return middle, low, high


def _check_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise ValueError(f"the level must be between 0 and 1, got {level:g}")
