"""Profiles of several quantities, resumable and on any executor."""

from collections.abc import Sequence
from functools import partial
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.fit import fit_many
from identknee.calibrate.problem import Problem
from identknee.calibrate.quantity import ParameterQuantity, Quantity
from identknee.identify.profile.march import JUMP
from identknee.identify.profile.profile import BUDGET, LEVEL, Settled, profile, settled
from identknee.identify.profile.result import Profile
from identknee.identify.profile.thresholds import chi2_threshold
from identknee.identify.sweep.starts_design import sobol_starts
from identknee.runs.arrays import Array
from identknee.runs.executors import Executor, serial
from identknee.runs.plain_records import from_plain, to_plain
from identknee.runs.resume import resumable_map
from identknee.runs.store import Store

MOST_ROUNDS = 3
N_STARTS = 16
# Of a fit that looks for another optimum.
FIT_BUDGET = 200


class ProfileSettings(TypedDict, total=False):
    """What is passed on to each `profile`, by the same names."""

    level: float
    thresholds: ArrayLike | None
    budget: int
    starts: ArrayLike | None


def profile_parameters(
    problem: Problem,
    optimum_theta: ArrayLike,
    names: Sequence[str] | None = None,
    *,
    executor: Executor = serial,
    store: Store | None = None,
    **settings: Unpack[ProfileSettings],
) -> tuple[Profile, ...]:
    """One profile for each parameter, in their order: `profile_quantities` of parameters.

    Parameters
    ----------
    problem
        Residuals in units of their noise; picklable if `executor` runs processes.
    optimum_theta
        The best fit known, shape ``(n,)``.
    names
        Which parameters; all if None.
    executor
        Anything with an ordered ``map``.
    store
        Where finished profiles are kept; from `identknee.runs.resume.open_work`.
    settings
        As for `profile_quantities`.

    Raises
    ------
    ValueError
        If a name is not a parameter's, or as `profile` does.
    """
    parameters = problem.parameters
    chosen = parameters.names if names is None else names
    quantities = [ParameterQuantity(parameters=parameters, name=name) for name in chosen]
    return profile_quantities(
        problem, optimum_theta, quantities, executor=executor, store=store, **settings
    )


def profile_quantities(
    problem: Problem,
    optimum_theta: ArrayLike,
    quantities: Sequence[Quantity],
    *,
    executor: Executor = serial,
    store: Store | None = None,
    **settings: Unpack[ProfileSettings],
) -> tuple[Profile, ...]:
    """One profile for each quantity, in their order, all from the same optimum.

    Other likely optima are looked for once, by `other_optima`, and their paths count in every
    profile; pass ``starts`` if they are known, or an empty tuple to do without. Where one of the
    profiles meets a better fit, all are walked again from the best that was met, at most three
    times.

    Parameters
    ----------
    problem
        Residuals in units of their noise; picklable, as the quantities, if `executor` runs
        processes.
    optimum_theta
        The best fit known, shape ``(n,)``.
    quantities
        What to profile, over the same parameters.
    executor
        Anything with an ordered ``map``.
    store
        Where finished profiles are kept; from `identknee.runs.resume.open_work`.
    settings
        Those of `profile`: ``level, budget, starts``, and ``thresholds``: one for all, or one each.
        The simulations that polish the optimum and look for other optima are no profile's, and
        not among theirs.

    Raises
    ------
    ValueError
        As `profile` does.
    """
    if not quantities:
        return ()
    theta = np.asarray(optimum_theta, dtype=np.float64)
    thresholds, starts = settings.pop("thresholds", None), settings.pop("starts", None)
    if thresholds is None:
        thresholds = chi2_threshold(settings.get("level", LEVEL))
    each = np.broadcast_to(np.asarray(thresholds, float), len(quantities)).tolist()
    if starts is None:
        starts = other_optima(problem, theta, threshold=max(each), executor=executor)
    # Sent together, problem and quantities keep the one model that they share simulations by.
    asked = list(zip(quantities, each, strict=True))
    found: tuple[Profile, ...] = ()
    for round_ in range(MOST_ROUNDS):
        (polished,) = resumable_map(
            partial(_settled, problem, theta, max(each)),
            [settings.get("budget", BUDGET)],
            executor=serial,
            store=store,
            name=f"optimum round {round_}",
            description="polishing",
        )
        theta = np.array(polished)
        kept = resumable_map(
            partial(_profiled, problem, theta, asked, {**settings, "starts": starts}),
            range(len(asked)),
            executor=executor,
            store=store,
            name=f"profile round {round_}",
            description="profiling",
        )
        found = tuple(from_plain(Profile, x) for x in kept)
        better = _better_of_all(found)
        if better is None:
            break
        theta = better
    return found


def other_optima(
    problem: Problem,
    optimum_theta: ArrayLike,
    *,
    threshold: float,
    seed: int = 0,
    executor: Executor = serial,
) -> Array:
    """Other likely optima, shape ``(k, n)``, where sixteen fits from all over the box end.

    They are the `starts` of profiles: paths of solutions in which parameters exchange their roles,
    or of a second valley, are found through them. None are looked for in a box without ends.

    Parameters
    ----------
    problem
        Residuals in units of their noise; picklable if `executor` runs processes.
    optimum_theta
        The best fit known, shape ``(n,)``.
    threshold
        Rise of the deviance up to which an optimum is likely.
    seed
        Seed of the Sobol points that the fits start from.
    executor
        Anything with an ordered ``map``.
    """
    parameters = problem.parameters
    if not np.isfinite(parameters.upper - parameters.lower).all():
        return np.empty((0, parameters.n))
    at = evaluate(problem, np.asarray(optimum_theta, dtype=np.float64))
    starts = sobol_starts(parameters, N_STARTS, seed=seed)
    fits = fit_many(problem, starts, seed=seed, executor=executor, budget=FIT_BUDGET)
    found = [at]
    for fit in sorted(fits, key=lambda x: x.objective):
        if not 2.0 * fit.objective < at.deviance + threshold:
            break
        here = evaluate(problem, fit.theta)
        apart = [here.jacobian @ (here.theta - other.theta) for other in found]
        if min(float(x @ x) for x in apart) > JUMP * threshold:
            found.append(here)
    return np.reshape([x.theta for x in found[1:]], (-1, parameters.n))


def _settled(problem: Problem, theta: Array, threshold: float, budget: int) -> list[float]:
    optimum = settled(problem, theta, threshold=threshold, budget=budget)
    return [float(x) for x in optimum.theta]


def _profiled(
    problem: Problem,
    theta: Array,
    asked: Sequence[tuple[Quantity, float]],
    settings: dict[str, Any],
    which: int,
) -> dict[str, Any]:
    quantity, threshold = asked[which]
    optimum = Settled(theta=theta)
    return to_plain(profile(problem, optimum, quantity, threshold=threshold, **settings))


def _better_of_all(found: Sequence[Profile]) -> Array | None:
    """The lowest of the better optima met; None if none was or all profiles stand on it."""
    lowest = min(found, key=lambda x: x.deviance)
    if lowest.better_optimum is None:
        return None
    # A hundredth of what would start one profile over.
    if all(x.deviance <= lowest.deviance + 1e-6 * lowest.threshold for x in found):
        return None
    return np.array(lowest.better_optimum)
