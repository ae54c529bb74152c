"""Which trials to add, so that the data tell what they leave open: chosen, predicted, verified."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.problem import Problem
from identknee.calibrate.quantity import ParameterQuantity, Quantity
from identknee.identify.design.added_trials import Candidates, WithTrials
from identknee.identify.design.better_known import (
    Narrowing,
    errors_halved,
    mean_share,
    narrowing,
)
from identknee.identify.design.criteria import CRITERIA, Criterion, LocalLoss, Loss, WidthLoss
from identknee.identify.design.predictions import Excluded, paths_of, predict_candidates
from identknee.identify.design.search import choose
from identknee.identify.design.shared import SharedErrors, Telling, shared_errors
from identknee.identify.profile.profiles import ProfileSettings, profile_quantities
from identknee.identify.profile.result import Profile
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_QUANTITY, array, declared, derived, entry
from identknee.runs.executors import Executor, serial

NONE_ALLOWED = (
    "no candidate has a prediction at all parameter sets that the data allow; offer others"
)
ProfilesOf = Callable[[Problem, ArrayLike, Sequence[Quantity]], tuple[Profile, ...]]


@declared
class ChosenTrials:
    """Trials to add, with what was predicted of them and what they achieve."""

    criterion: Criterion = entry("What was made small")
    names: tuple[str, ...] = array("Names of the candidates", "candidate", is_in_arrays=False)
    targets: tuple[str, ...] = array(
        "Quantities whose intervals were to shrink", "target", is_in_arrays=False
    )
    chosen: tuple[int, ...] = entry(
        "Places of the trials to add among the candidates, the most helpful first; one that comes "
        "twice is to be made twice",
        unit="1",
    )
    excluded: tuple[Excluded, ...] = entry("Candidates that were not offered")
    losses: Array = array("Loss before and after each added trial", "step", key="loss")
    alone: Array = array(
        "Loss with each candidate alone added; NaN for those excluded",
        "candidate",
        key="loss_alone",
    )
    predicted: Array = array(
        "Predicted interval of each target before and after each added trial; NaN for an end that "
        "stays open",
        *("step", "target", "end"),
        unit=OF_QUANTITY,
    )
    sds: Array = array(
        "Standard deviation of each target by the linear model at the best fit",
        *("step", "target"),
        unit=OF_QUANTITY,
        key="sd",
    )
    before: Mapping[str, Profile] = entry(
        "Profile of each target on the data as they are", rows="target", group="profile_before"
    )
    after: Mapping[str, Profile] = entry(
        "Profile of each target with the added trials simulated at the best fit",
        rows="target",
        group="profile_after",
    )
    n_simulations: int = entry("Simulations made, profiles included", unit="1")
    narrowing: Narrowing = entry(
        "What one trial, or one stated error known better, tells by itself", is_inline=True
    )

    def __post_init__(self) -> None:
        if not self.before or any(tuple(x) != self.targets for x in (self.before, self.after)):
            raise ValueError("the profiles are not those of the targets")
        if not all(0 <= i < len(self.names) for i in self.chosen):
            raise ValueError("a trial that was chosen is none of the candidates")

    @property
    @derived(
        "Predicted ends of each target's interval with all trials added; null where it stays open",
        unit=OF_QUANTITY,
        key="predicted",
    )
    def predicted_ends(self) -> dict[str, tuple[float | None, float | None]]:
        """Ends of each target's interval as predicted with all trials added."""
        ends = [tuple(None if np.isnan(x) else float(x) for x in row) for row in self.predicted[-1]]
        return {name: (low, high) for name, (low, high) in zip(self.targets, ends, strict=True)}

    @property
    @derived(
        "Every candidate offered and every stated error, the most helpful first: what it is, its "
        "name, and the share by which it narrows the targets by itself: one more trial, or the "
        "error's standard deviation halved; the geometric mean over the targets, predicted"
    )
    def ranking(self) -> tuple[dict[str, Any], ...]:
        """Trials and errors known better, in the order in which they narrow the targets."""
        parts = (
            ("trial", self.names, self.narrowing.by_trial),
            ("error", self.narrowing.errors, self.narrowing.by_error),
        )
        rows: list[dict[str, Any]] = [
            {"kind": kind, "name": name, "narrowing": mean_share(shares)}
            for kind, names, table in parts
            for name, shares in zip(names, table, strict=True)
            if np.isfinite(shares).all()
        ]
        return tuple(sorted(rows, key=lambda row: -row["narrowing"]))

    @property
    @derived("Number of candidates", unit="1")
    def n_candidates(self) -> int:
        """Number of candidates."""
        return len(self.names)

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the trials to add, the most helpful first."""
        return tuple(self.names[i] for i in self.chosen)


def design(
    problem: Problem,
    optimum_theta: ArrayLike,
    candidates: Candidates,
    *,
    n_trials: int,
    targets: Sequence[Quantity] = (),
    criterion: Criterion = "width",
    executor: Executor = serial,
    **settings: Unpack[ProfileSettings],
) -> ChosenTrials:
    """The trials that, added to the data, close or shrink the intervals of the targets most.

    The targets are profiled on the data. Every candidate is predicted along these profiles; one
    that has no prediction at a parameter set that the data allow is excluded. The trials are chosen
    greedily and by exchange, simulated at the best fit, and the targets profiled again.

    Parameters
    ----------
    problem
        Residuals in units of their noise.
    optimum_theta
        The best fit, shape ``(n,)``.
    candidates
        Trials to choose from.
    n_trials
        How many to add.
    targets
        Quantities whose intervals are to shrink; the parameters of interest with an open interval
        if none is given, all of interest where no interval is open.
    criterion
        ``"width"`` for the predicted widths of the targets' profiles, ``"c"`` for their variances
        at the best fit, ``"D"``, ``"A"`` or ``"E"`` for the determinant, the trace or the largest
        eigenvalue of the covariance of the parameters of interest in typical steps.
    executor
        Anything with an ordered ``map``; the result is the same whichever it is.
    settings
        Those of `profile_quantities`: ``level, budget, starts, thresholds``.

    Raises
    ------
    ValueError
        If `n_trials` is less than 1, the criterion is unknown, all parameters are nuisances, the
        model has no prediction at the best fit, or every candidate is excluded.
    """
    _check(problem, n_trials, criterion)
    profiles_of = partial(profile_quantities, executor=executor, **settings)
    theta = np.asarray(optimum_theta, dtype=np.float64)
    shared = _shared(problem, theta, candidates, targets)
    if shared is not None:
        targets = [_of_interest(x, shared.problem.parameters) for x in targets]
        theta = theta[problem.parameters.is_of_interest]
        problem, candidates = shared.problem, shared.candidates
    quantities, before = _profiled(problem, theta, profiles_of, targets)
    points = predict_candidates(problem, before, candidates, executor)
    excluded = points.excluded(candidates.names)
    allowed = ~np.isin(candidates.names, [x.name for x in excluded])
    if not allowed.any():
        raise ValueError(NONE_ALLOWED)
    gradients = np.array([x.evaluate(points.thetas[0])[1] for x in quantities]) * points.scales
    width = WidthLoss(paths=paths_of(before, quantities, points.scales))
    local = LocalLoss(
        criterion=criterion,
        gradients=gradients,
        is_of_interest=problem.parameters.is_of_interest,
    )
    loss: Loss = width if criterion == "width" else local
    known = None if shared is None else shared.known(points)
    telling = Telling(loss=loss, points=points, allowed=allowed, shared=shared, known=known)
    chosen = choose(loss, telling.beside, allowed, n_trials)
    along = replace(telling, loss=width)
    halved = errors_halved(width, points, problem.parameters) if shared is None else along.halved()
    adding = partial(_with_trials, problem, candidates) if shared is None else shared.with_trials
    whole = adding(chosen, points.thetas[0])
    after = profiles_of(whole, points.thetas[0], quantities)
    return ChosenTrials(
        criterion=criterion,
        names=tuple(candidates.names),
        targets=tuple(x.name for x in before),
        chosen=chosen,
        excluded=excluded,
        losses=loss(_stages(telling, chosen)),
        alone=np.where(allowed, loss(np.add(*telling.beside(()))), np.nan),
        predicted=_intervals(width, _stages(along, chosen)),
        sds=np.sqrt(local.variances(_stages(replace(telling, loss=local), chosen))),
        narrowing=narrowing(width, along.beside(()), allowed, halved),
        before={x.name: x for x in before},
        after={x.name: x for x in after},
        n_simulations=points.n_simulations + sum(x.n_simulations for x in (*before, *after)),
    )


def _check(problem: Problem, n_trials: int, criterion: Criterion) -> None:
    if n_trials < 1:
        raise ValueError(f"the number of trials to add must be at least 1, got {n_trials}")
    if criterion not in CRITERIA:
        raise ValueError(f"there is no criterion {criterion!r}; there are {', '.join(CRITERIA)}")
    if not problem.parameters.is_of_interest.any():
        raise ValueError("all parameters of interest are fixed; leave at least one free")


def _shared(
    problem: Problem, theta: Array, candidates: Candidates, targets: Sequence[Quantity]
) -> SharedErrors | None:
    """The nuisances averaged over; None without any, or where a target is no parameter."""
    is_error = ~problem.parameters.is_of_interest
    if not (is_error.any() and all(isinstance(x, ParameterQuantity) for x in targets)):
        return None
    return shared_errors(problem, theta, candidates)


def _of_interest(target: Quantity, parameters: Parameters) -> Quantity:
    return ParameterQuantity(parameters=parameters, name=target.name)


def _profiled(
    problem: Problem, theta: Array, profiles_of: ProfilesOf, targets: Sequence[Quantity]
) -> tuple[tuple[Quantity, ...], tuple[Profile, ...]]:
    """The targets and their profiles; those that need it most where none is given."""
    if not targets:
        return _needy(problem, theta, profiles_of)
    return tuple(targets), profiles_of(problem, theta, targets)


def _needy(
    problem: Problem, theta: ArrayLike, profiles_of: ProfilesOf
) -> tuple[tuple[Quantity, ...], tuple[Profile, ...]]:
    """Those of interest with an open interval, all where none is, and their profiles."""
    parameters = problem.parameters
    every = [ParameterQuantity(parameters=parameters, name=x) for x in parameters.names_of_interest]
    profiles = profiles_of(problem, theta, every)
    is_open = [x.lower is None or x.upper is None for x in profiles]
    chosen = [i for i in range(len(every)) if is_open[i] or not any(is_open)]
    return tuple(every[i] for i in chosen), tuple(profiles[i] for i in chosen)


def _stages(telling: Telling, chosen: tuple[int, ...]) -> Array:
    """Features before and after each of the chosen trials, shape ``(n_trials + 1, f)``."""
    return np.array([telling.beside(chosen[:i])[0] for i in range(len(chosen) + 1)])


def _intervals(width: WidthLoss, features: Array) -> Array:
    """Predicted intervals, shape ``(n_trials + 1, t, 2)``; NaN for open ends."""
    found = [np.where(is_open, np.nan, ends) for ends, is_open in width.intervals(features)]
    return np.stack(found, axis=1)


def _with_trials(
    problem: Problem, candidates: Candidates, chosen: tuple[int, ...], theta: Array
) -> WithTrials:
    """The problem with the chosen trials as they would come out at theta, without errors."""
    measured, _ = candidates.predict(theta, chosen)
    return WithTrials(problem=problem, candidates=candidates, chosen=chosen, measured=measured)
