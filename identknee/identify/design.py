"""Which trials to add so that the data bound open intervals: chosen, predicted, verified.

Where searches for equilibria begin at measured poses, a small change of parameters may lead to
another equilibrium. Profiles depend on such jumps; slopes at the best fit do not (`linearised`).

Nuisance parameters are marginalised about the best fit (`identknee.runs.marginalise`). Trials share
them, so that the worth of a trial depends on the others: the posterior of the nuisances after
these is added to its noise.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from identknee.calibrate.problem import (
    ParameterQuantity,
    Problem,
    ProblemAround,
    Quantity,
    restricted,
    with_priors_of,
    without_priors,
)
from identknee.identify.design_criteria import (
    CRITERIA,
    CandidatePredictions,
    CandidateTrials,
    Criterion,
    Excluded,
    LocalLoss,
    Loss,
    OfferedTrials,
    Step,
    WidthLoss,
    WithTrials,
    paths_of,
    predict_candidates,
)
from identknee.identify.optimum import nuisance_places
from identknee.identify.profile.profile import ProfileSettings, profile_quantities
from identknee.identify.profile.result import Profile
from identknee.identify.trial_choice import choose
from identknee.model.parameters import Parameters
from identknee.runs.declare import OF_QUANTITY, Array, BoolArray, array, declared, derived, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.marginalise import NuisancePosterior, whitening, with_error_measured


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearisedProblem:
    """A problem linearised at theta: residuals ``(m,)`` and Jacobian ``(m, n)``."""

    parameters: Parameters
    theta: Array
    at_theta: Array
    slopes: Array

    def residuals(self, theta: Array) -> Array:
        """Residuals, shape ``(m,)``."""
        return np.asarray(self.at_theta + self.slopes @ (theta - self.theta))

    def jacobian(self, theta: Array) -> Array:  # noqa: ARG002 - they are the same everywhere
        """Their derivatives, shape ``(m, n)``."""
        return self.slopes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearisedCandidates:
    """Candidates linearised at theta: values ``(k, m)`` and Jacobians ``(k, m, n)``."""

    names: tuple[str, ...]
    theta: Array
    at_theta: Array
    slopes: Array

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """What the chosen trials would measure, and its derivatives, as the candidates do."""
        slopes = self.slopes[list(chosen)]
        return self.at_theta[list(chosen)] + slopes @ (theta - self.theta), slopes


def linearised(problem: Problem, theta: Array) -> Problem:
    """A problem linearised at theta, priors kept."""
    data = without_priors(problem)
    lines = LinearisedProblem(
        parameters=problem.parameters,
        theta=theta,
        at_theta=data.residuals(theta),
        slopes=data.jacobian(theta),
    )
    return with_priors_of(lines, problem)


def linearised_candidates(candidates: CandidateTrials, theta: Array) -> LinearisedCandidates:
    """Candidates linearised at theta."""
    values, slopes = candidates.predict(theta, range(len(candidates.names)))
    return LinearisedCandidates(
        names=tuple(candidates.names), theta=theta, at_theta=values, slopes=slopes
    )


@declared
class Narrowing:
    """Narrowing of each target by one more trial, or by halving one stated error.

    Widths are predicted along the profiles, as `WidthLoss` says.
    """

    errors: tuple[str, ...] = array(
        "Stated errors that may be known better, such as insertion.ACL_femur",
        "error",
        is_in_arrays=False,
    )
    now: Array = array(
        "Width of each target's interval now, an open end continued in proportion",
        "target",
        unit=OF_QUANTITY,
        key="width_now",
    )
    with_trial: Array = array(
        "Predicted width with one candidate added; NaN for those excluded",
        *("candidate", "target"),
        unit=OF_QUANTITY,
        key="width_with_trial",
    )
    with_error_halved: Array = array(
        "Predicted width with the stated standard deviation of one error halved",
        *("error", "target"),
        unit=OF_QUANTITY,
        key="width_with_error_halved",
    )
    with_step: Array | None = array(
        "Predicted width with one step of another kind; NaN for those without a prediction; "
        "missing where none was compared",
        *("step_of_another_kind", "target"),
        unit=OF_QUANTITY,
        key="width_with_step",
        default=None,
    )

    @property
    def by_trial(self) -> Array:
        """Relative narrowing of each target by each candidate, ``(k, t)``; NaN if excluded."""
        return np.asarray(1.0 - self.with_trial / self.now)

    @property
    def by_error(self) -> Array:
        """Relative narrowing of each target by halving each error, shape ``(e, t)``."""
        return np.asarray(1.0 - self.with_error_halved / self.now)

    @property
    def by_step(self) -> Array:
        """Relative narrowing of each target by each step of another kind; NaN if excluded."""
        widths = np.empty((0, self.now.size)) if self.with_step is None else self.with_step
        return np.asarray(1.0 - widths / self.now)


def narrowing(
    width: WidthLoss,
    features: tuple[Array, Array],
    allowed: BoolArray,
    halved: Mapping[str, Array],
    n_steps: int,
) -> Narrowing:
    """Narrowing of the targets by each trial, halved error and other step, one at a time.

    Parameters
    ----------
    width
        The profiles of the targets.
    features
        Of the trials made, shape ``(f,)``, and of the candidates, ``(k, f)``.
    allowed
        Which candidates are offered, shape ``(k,)``.
    halved
        Features of each error known twice as well, shape ``(1, f)``, by its name.
    n_steps
        How many of the candidates, the last ones, are steps of another kind.
    """
    made, trials = features
    n = len(trials) - n_steps
    with_trial = np.full((len(trials), len(width.paths)), np.nan)
    with_trial[allowed] = _widths(width, made + trials[allowed])
    return Narrowing(
        errors=tuple(halved),
        now=_widths(width, made[None])[0],
        with_trial=with_trial[:n],
        with_step=with_trial[n:] if n_steps else None,
        with_error_halved=_widths(
            width, made + np.vstack([np.empty((0, made.size)), *halved.values()])
        ),
    )


def halved_error_features(
    width: WidthLoss, points: CandidatePredictions, parameters: Parameters
) -> dict[str, Array]:
    """Features of nuisance parameters with their standard deviations halved, ``(1, f)`` each."""
    found = {}
    for name, places in nuisance_places(parameters).items():
        # A trial that measures them directly, values and derivatives in units of its noise.
        rows = with_error_measured(parameters.n, places, parameters.prior_sd[places])
        values, slopes = points.thetas[:, None] @ rows.T, rows * points.scales
        every = np.broadcast_to(slopes, (len(values), 1, *slopes.shape))
        found[name] = width.features_of_trials(values, every)
    return found


def mean_narrowing(shares: Array) -> float:
    """Narrowing by the geometric mean of the relative widths.

    Examples
    --------
    >>> round(mean_narrowing(np.array([0.5, 0.0])), 3)
    0.293
    """
    return float(1.0 - np.exp(np.mean(np.log1p(-shares))))


def _widths(width: WidthLoss, features: Array) -> Array:
    return np.stack([ends[:, 1] - ends[:, 0] for ends, _ in width.intervals(features)], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarginalProblem(ProblemAround):
    """A problem whose nuisances, linear in the residuals, are marginalised.

    Attributes
    ----------
    problem
        Residuals in units of their noise, nuisances at their best fit.
    slopes
        Change of each residual with one prior standard deviation of each error, shape ``(m, e)``.
    offset
        Middle of the priors less the best fit, in prior standard deviations, shape ``(e,)``.
    """

    slopes: Array
    offset: Array
    _whitening: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_whitening", whitening(self.slopes))

    @override
    def residuals(self, theta: Array) -> Array:
        """Residuals at the prior means of the nuisances, whitened, shape ``(m,)``."""
        residuals = self.problem.residuals(theta)
        if not np.isfinite(residuals).all():
            return residuals
        return self.whitened(residuals + self.slopes @ self.offset)

    @override
    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residuals by theta, shape ``(m, n)``."""
        return self.whitened(self.problem.jacobian(theta))

    def whitened(self, rows: Array) -> Array:
        """Residuals, or changes of them, in units of noise and errors together."""
        return np.asarray(self._whitening @ rows)


def marginal_problem(problem: Problem, theta: Array) -> MarginalProblem:
    """The problem of the parameters of interest alone."""
    parameters = problem.parameters
    is_error, data = ~parameters.is_of_interest, without_priors(problem)
    held = np.array(parameters.names)[is_error].tolist()
    sd = parameters.prior_sd[is_error]
    return MarginalProblem(
        problem=restricted(data, held, theta),
        slopes=data.jacobian(theta)[:, is_error] * sd,
        offset=(parameters.center - theta)[is_error] / sd,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidatesAtBestNuisances:
    """Candidates with the nuisance parameters at their best fit.

    Attributes
    ----------
    candidates
        Predicted for all parameters.
    theta
        The best fit of all, shape ``(n,)``.
    is_of_interest
        Which of them vary, shape ``(n,)``.
    """

    candidates: CandidateTrials
    theta: Array
    is_of_interest: BoolArray

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the trials."""
        return self.candidates.names

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """As the candidates do, for the parameters of interest."""
        whole = np.array(self.theta)
        whole[self.is_of_interest] = theta
        values, jacobians = self.candidates.predict(whole, chosen)
        return values, jacobians[:, :, self.is_of_interest]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedErrors:
    """A problem that shares its nuisance parameters with the candidates.

    Attributes
    ----------
    problem
        The parameters of interest alone, see `MarginalProblem`.
    candidates
        The trials that may be added.
    slopes
        Change of each value of a candidate with one prior standard deviation of each error, shape
        ``(k, m, e)``; NaN where the candidate has no prediction.
    groups
        Which errors belong together, by name.
    """

    problem: MarginalProblem
    candidates: CandidatesAtBestNuisances
    slopes: Array
    groups: dict[str, list[int]]

    def with_trials(self, chosen: tuple[int, ...], theta: Array) -> MarginalProblem:
        """The problem with the chosen trials as they would come out at theta, without errors."""
        measured, _ = self.candidates.predict(theta, chosen)
        whole = WithTrials(
            problem=self.problem.problem,
            candidates=self.candidates,
            chosen=chosen,
            measured=measured,
        )
        added = self.slopes[list(chosen)].reshape(measured.size, -1)
        return replace(self.problem, problem=whole, slopes=np.vstack([self.problem.slopes, added]))

    def known(self, points: CandidatePredictions) -> NuisancePosterior:
        """Posterior of the nuisances after the trials made, less their best fit, at the points."""
        inner = self.problem.problem
        residuals = np.array([inner.residuals(x) for x in points.thetas])
        jacobians = np.array([inner.jacobian(x) for x in points.thetas]) * points.scales
        return NuisancePosterior.after(residuals, jacobians, self.problem.slopes)


def shared_errors(problem: Problem, theta: Array, candidates: CandidateTrials) -> SharedErrors:
    """The nuisances of a problem as errors shared with its candidates, about the best fit."""
    parameters = problem.parameters
    is_asked = parameters.is_of_interest
    _, jacobians = candidates.predict(theta, range(len(candidates.names)))
    errors = np.flatnonzero(~is_asked)
    place = {int(x): i for i, x in enumerate(errors)}
    return SharedErrors(
        problem=marginal_problem(problem, theta),
        candidates=CandidatesAtBestNuisances(
            candidates=candidates, theta=theta, is_of_interest=is_asked
        ),
        slopes=jacobians[:, :, errors] * parameters.prior_sd[errors],
        groups={name: [place[i] for i in x] for name, x in nuisance_places(parameters).items()},
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialFeatures:
    """Features of the trials made with some added, and of each trial that may follow.

    Attributes
    ----------
    loss
        The criterion whose features these are.
    points
        Predictions of the candidates at the best fit and along the profiles.
    allowed
        Which candidates are offered, shape ``(k,)``.
    shared, known
        The nuisances that trials share and their posterior after the trials made; None without.
    """

    loss: Loss
    points: CandidatePredictions
    allowed: BoolArray
    shared: SharedErrors | None = None
    known: NuisancePosterior | None = None

    def beside(self, others: Sequence[int]) -> tuple[Array, Array]:
        """Features of the trials made and `others`, shape ``(f,)``, and of each next, ``(k, f)``.

        Zero for those not offered.
        """
        made, trials = self.points.features(self.loss, self.allowed)
        known = self.known
        if known is None:
            return made + trials[list(others)].sum(axis=0), trials
        for trial in others:
            own = self._of([trial])
            made = made + self.loss.features_of_trials(*known.whitened(*own))[0]
            known = known.updated(own[0][:, 0], own[1][:, 0], own[2][0])
        offered = np.flatnonzero(self.allowed)
        trials[offered] = self.loss.features_of_trials(*known.whitened(*self._of(offered.tolist())))
        return made, trials

    def halved(self) -> dict[str, Array]:
        """Features of errors whose standard deviation is halved, each ``(1, f)``, by name."""
        if self.shared is None or self.known is None:
            return {}
        n = self.shared.slopes.shape[2]
        q, _, _, p = self.points.jacobians.shape
        found = {}
        for name, places in self.shared.groups.items():
            m = len(places)
            measured = (
                np.zeros((q, 1, m)),
                np.zeros((q, 1, m, p)),
                with_error_measured(n, places)[None],
            )
            found[name] = self.loss.features_of_trials(*self.known.whitened(*measured))
        return found

    def _of(self, trials: list[int]) -> tuple[Array, Array, Array]:
        """Changes of trials from the best fit, with derivatives by parameters and nuisances."""
        if self.shared is None:  # pragma: no cover - asked for with shared errors only
            raise AssertionError
        values = self.points.values[:, trials]
        return values - values[0], self.points.jacobians[:, trials], self.shared.slopes[trials]


@declared
class UnboundedEnd:
    """An open end of a target's interval that no candidate closes."""

    target: str = entry("Name of the target")
    end: Literal["below", "above"] = entry("Which end of its interval")


NONE_ALLOWED = (
    "no candidate has a prediction at all parameter sets that the data allow; offer others"
)
ProfilesOf = Callable[[Problem, ArrayLike, Sequence[Quantity]], tuple[Profile, ...]]


@declared
class ChosenTrials:
    """Trials to add, with their predicted and achieved intervals."""

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
    unbounded: tuple[UnboundedEnd, ...] = entry(
        "Open ends that none of the candidates is predicted to close by itself, nor the chosen "
        "ones together when they were simulated",
        default=(),
    )
    steps: tuple[Step, ...] = entry(
        "Steps beside one more trial that were compared with it", default=()
    )
    costs: Mapping[str, float] = entry(
        "What a step of each kind costs, in units of one more trial", default_factory=dict
    )
    narrowing: Narrowing = entry(
        "What one trial, one stated error known better, or one other step tells by itself",
        is_inline=True,
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
        ends = [tuple(None if np.isnan(x) else float(x) for x in row) for row in self.predicted[-1]]
        return {name: (low, high) for name, (low, high) in zip(self.targets, ends, strict=True)}

    @property
    @derived(
        "Every candidate offered, every stated error and every other step, the most helpful first: "
        "what it is, its name, and the share by which it narrows the targets by itself: one more "
        "trial, the error's standard deviation halved, or the step; the geometric mean over the "
        "targets, predicted; where costs differ, also the same for the cost of one trial"
    )
    def ranking(self) -> tuple[dict[str, Any], ...]:
        parts = (
            *(("trial", *x) for x in zip(self.names, self.narrowing.by_trial, strict=True)),
            *(
                ("error", *x)
                for x in zip(self.narrowing.errors, self.narrowing.by_error, strict=True)
            ),
            *(
                (step.kind, step.name, shares)
                for step, shares in zip(self.steps, self.narrowing.by_step, strict=True)
            ),
        )
        rows: list[dict[str, Any]] = []
        for kind, name, shares in parts:
            if np.isfinite(shares).all():
                rows.append({"kind": kind, "name": name, "narrowing": mean_narrowing(shares)})
        if not self.has_costs:
            return tuple(sorted(rows, key=lambda row: -row["narrowing"]))
        for row in rows:
            cost = self.costs.get(row["kind"], 1.0)
            row["per_cost"] = float(1.0 - (1.0 - row["narrowing"]) ** (1.0 / cost))
        return tuple(sorted(rows, key=lambda row: -row["per_cost"]))

    @property
    def has_costs(self) -> bool:
        """Whether steps of some kinds cost more than of others."""
        return len({1.0, *self.costs.values()}) > 1

    @property
    @derived("Number of candidates", unit="1")
    def n_candidates(self) -> int:
        return len(self.names)

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the trials to add, the most helpful first."""
        return tuple(self.names[i] for i in self.chosen)


def design(
    problem: Problem,
    optimum_theta: ArrayLike,
    offered: CandidateTrials | OfferedTrials,
    *,
    n_trials: int,
    targets: Sequence[Quantity] = (),
    criterion: Criterion = "width",
    executor: Executor = serial,
    **settings: Unpack[ProfileSettings],
) -> ChosenTrials:
    """The trials that, added to the data, close or narrow the targets' intervals most.

    The targets are profiled on the data. Every candidate is predicted along these profiles; one
    that has no prediction at a parameter set that the data allow is excluded. The trials are chosen
    greedily and by exchange, simulated at the best fit, and the targets profiled again.

    Parameters
    ----------
    problem
        Residuals in units of their noise.
    optimum_theta
        The best fit, shape ``(n,)``.
    offered
        Trials to choose from, and other steps, which are compared with one more trial and not
        chosen.
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
    if n_trials < 1:
        raise ValueError(f"the number of trials to add must be at least 1, got {n_trials}")
    if criterion not in CRITERIA:
        raise ValueError(f"there is no criterion {criterion!r}; there are {', '.join(CRITERIA)}")
    if not problem.parameters.is_of_interest.any():
        raise ValueError("all parameters of interest are fixed; leave at least one free")
    if not isinstance(offered, OfferedTrials):
        offered = OfferedTrials(trials=offered)
    names, candidates = tuple(offered.trials.names), offered.all
    n = len(names)
    profiles_of = partial(profile_quantities, executor=executor, **settings)
    theta = np.asarray(optimum_theta, dtype=np.float64)
    # Nuisances are marginalised, unless a target is no parameter.
    shared: SharedErrors | None = None
    has_errors = not problem.parameters.is_of_interest.all()
    if has_errors and all(isinstance(x, ParameterQuantity) for x in targets):
        shared = shared_errors(problem, theta, candidates)
        asked = shared.problem.parameters
        targets = [ParameterQuantity(parameters=asked, name=x.name) for x in targets]
        theta = theta[problem.parameters.is_of_interest]
        problem, candidates = with_priors_of(shared.problem, problem), shared.candidates
    if targets:
        quantities, before = tuple(targets), profiles_of(problem, theta, targets)
    else:
        quantities, before = _default_targets(problem, theta, profiles_of)
    points = predict_candidates(problem, before, candidates, executor)
    excluded = points.excluded(candidates.names)
    allowed = ~np.isin(candidates.names, [x.name for x in excluded])
    is_trial = np.arange(len(allowed)) < n
    if not allowed[:n].any():
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
    features = TrialFeatures(loss=loss, points=points, allowed=allowed, shared=shared, known=known)
    chosen = choose(lambda x: loss(np.add(*features.beside(x))), allowed & is_trial, n_trials)
    along = replace(features, loss=width)
    halved = (
        halved_error_features(width, points, problem.parameters)
        if shared is None
        else along.halved()
    )
    best = points.thetas[0]
    whole: Problem
    if shared is None:
        measured, _ = candidates.predict(best, chosen)
        whole = WithTrials(problem=problem, candidates=candidates, chosen=chosen, measured=measured)
    else:
        whole = with_priors_of(shared.with_trials(chosen, best), problem)
    after = profiles_of(whole, best, quantities)
    made, next_steps = along.beside(())
    intervals = width.intervals(_stages(along, chosen))
    predicted = [np.where(is_open, np.nan, ends) for ends, is_open in intervals]
    return ChosenTrials(
        criterion=criterion,
        names=names,
        targets=tuple(x.name for x in before),
        chosen=chosen,
        excluded=tuple(x for x in excluded if x.name in names),
        losses=loss(_stages(features, chosen)),
        alone=np.where(allowed, loss(np.add(*features.beside(()))), np.nan)[:n],
        predicted=np.stack(predicted, axis=1),
        sds=np.sqrt(local.variances(_stages(replace(features, loss=local), chosen))),
        unbounded=_unbounded_ends(after, width.intervals(made + next_steps[allowed & is_trial])),
        steps=offered.steps,
        costs=offered.costs,
        narrowing=narrowing(width, (made, next_steps), allowed, halved, len(offered.steps)),
        before={x.name: x for x in before},
        after={x.name: x for x in after},
        n_simulations=points.n_simulations + sum(x.n_simulations for x in (*before, *after)),
    )


def _default_targets(
    problem: Problem, theta: ArrayLike, profiles_of: ProfilesOf
) -> tuple[tuple[Quantity, ...], tuple[Profile, ...]]:
    """Parameters with an unbounded interval, or else all of interest, with their profiles."""
    parameters = problem.parameters
    every = [ParameterQuantity(parameters=parameters, name=x) for x in parameters.names_of_interest]
    profiles = profiles_of(problem, theta, every)
    is_open = [x.lower is None or x.upper is None for x in profiles]
    chosen = [i for i in range(len(every)) if is_open[i] or not any(is_open)]
    return tuple(every[i] for i in chosen), tuple(profiles[i] for i in chosen)


def _unbounded_ends(
    after: Sequence[Profile], alone: Sequence[tuple[Array, BoolArray]]
) -> tuple[UnboundedEnd, ...]:
    """Ends that are open with the chosen trials and with each candidate alone."""
    found = []
    for profile, (_, is_open) in zip(after, alone, strict=True):
        if profile.lower is None and is_open[:, 0].all():
            found.append(UnboundedEnd(target=profile.name, end="below"))
        if profile.upper is None and is_open[:, 1].all():
            found.append(UnboundedEnd(target=profile.name, end="above"))
    return tuple(found)


def _stages(features: TrialFeatures, chosen: tuple[int, ...]) -> Array:
    """Features before and after each of the chosen trials, shape ``(n_trials + 1, f)``."""
    return np.array([features.beside(chosen[:i])[0] for i in range(len(chosen) + 1)])
