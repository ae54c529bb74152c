"""The best fit from which identifiability is analysed."""

import numpy as np
import scipy

from identknee.calibrate.fit import Fit, fit, fit_many
from identknee.calibrate.problem import Problem
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.executors import Executor, serial
from identknee.runs.record import Outcome

N_STARTS = 16
# How many prior standard deviations around the subject's values the other starts lie in.
REACH = 2.0


def best_fit(
    problem: Problem, *, start: Array | None = None, seed: int = 0, executor: Executor = serial
) -> Fit:
    """The lowest of seventeen least-squares fits: one from `start`, sixteen from around it.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise.
    start
        Where the first fit begins and what the others lie around (Sobol points within two prior
        standard deviations), shape ``(n,)``; the subject's own values if None.
    seed
        Seed of the Sobol points' scrambling and of the fits.
    executor
        Anything with an ordered ``map``.

    Raises
    ------
    ValueError
        If the start lies outside the bounds, or no fit found a point with a prediction.
    """
    return best_fits(problem, start=start, seed=seed, executor=executor)[0]


def best_fits(
    problem: Problem,
    *,
    start: Array | None = None,
    seed: int = 0,
    executor: Executor = serial,
    budget: int | None = None,
) -> tuple[Fit, ...]:
    """The seventeen fits that `best_fit` is the lowest of, from low to high; as there.

    With a budget each has so many simulations, and only the lowest goes on to its end.
    """
    parameters = problem.parameters
    first = parameters.start if start is None else np.asarray(start, dtype=np.float64)
    check_within_bounds(first, parameters)
    points = sobol_around(parameters, first, N_STARTS, reach=REACH, seed=seed)
    around = fit_many(problem, points, seed=seed, executor=executor, budget=budget)
    begun = [fit(problem, first, seed=seed, budget=budget), *around]
    fits = sorted(begun, key=lambda one: one.objective)
    if not np.isfinite(fits[0].objective):
        raise ValueError(
            f"the model has no prediction at any of {N_STARTS + 1} starts; "
            "see: identknee subject check"
        )
    if budget is not None and fits[0].outcome is Outcome.BUDGET:
        fits[0] = fit(problem, fits[0].theta, seed=seed)
    return tuple(fits)


def check_within_bounds(theta: Array, parameters: Parameters) -> None:
    """Raise for a theta outside the bounds.

    Raises
    ------
    ValueError
        Naming the first parameter that is outside.
    """
    for name, value, low, high in zip(
        parameters.names, theta, parameters.lower, parameters.upper, strict=True
    ):
        if not low <= value <= high:
            raise ValueError(
                f"the start of {name} is {value:g}, outside its bounds {low:g} to {high:g}; "
                "start inside them or widen them with --bounds"
            )


def sobol_around(
    parameters: Parameters, center: Array, n: int, *, reach: float, seed: int
) -> Array:
    """Sobol points around a center, within the bounds, shape ``(n, p)``; nuisances stay there.

    Parameters
    ----------
    parameters
        For the bounds and the priors.
    center
        Shape ``(p,)``.
    n
        Number of points.
    reach
        How far they lie at most, in prior standard deviations.
    seed
        Seed of the scrambling.
    """
    # Sobol points are balanced in powers of two only; the rest of such a set is left out.
    drawn = scipy.stats.qmc.Sobol(parameters.n, seed=seed).random_base2(int(np.ceil(np.log2(n))))[
        :n
    ]
    steps = reach * parameters.prior_sd * (2.0 * drawn - 1.0) * parameters.is_of_interest
    points = np.where(parameters.is_log, center * np.exp(steps), center + steps)
    return np.asarray(np.clip(points, parameters.lower, parameters.upper))
