"""What a named cause gains: misfit, prediction of held-out folds, evidence, parameters, forces."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import unique

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import Evaluation, Evaluator, Problem, ProblemWithPriors, evaluate
from identknee.diagnosis.fitting import FittedModel, posterior_of, whitened_problem
from identknee.diagnosis.misfit import ResidualTest, base_projector, omnibus_check
from identknee.diagnosis.noise_model import NoiseModel
from identknee.identify.laplace import Interval, Laplace, laplace, log_evidence
from identknee.laxity.protocol import (
    ABSOLUTE,
    DIRECTIONS,
    SAME_ANGLE_DEG,
    Protocol,
    nominal_flexion,
    nominal_loads,
)
from identknee.laxity.table import COORDINATES, ROTATIONS, Laxity, root_mean
from identknee.model.discrepancy import SmoothKernel
from identknee.model.line_loads import tensions_of
from identknee.model.parameters import Parameters
from identknee.runs.declare import OF_PARAMETER, Array, BoolArray, IntArray, array, declared, entry
from identknee.runs.record import WithSentence

FLEXION = "flexion"
DIRECTION = "load direction"
EXTREMES = "extreme loads"
FAMILIES = (FLEXION, DIRECTION, EXTREMES)
# Share of the largest load of its kind beyond which a load is extreme.
EXTREME_SHARE = 0.8
ROUNDING = 1e-9


@declared
class Fold:
    """Trials that are held out of a fit together.

    Raises
    ------
    ValueError
        If all trials are held out, or none.
    """

    family: str = entry("One of `FAMILIES`")
    name: str = entry('Which trials, such as ``"30 deg"`` or ``"varus moment"``')
    held: BoolArray = array(
        "Whether a trial is held out; some are and some are not", "trial", dtype=bool
    )

    def __post_init__(self) -> None:
        if self.held.all() or not self.held.any():
            raise ValueError(
                f"the fold {self.name!r} must hold out some trials and keep some; "
                f"it holds out {int(self.held.sum())} of {self.held.size}"
            )


def held_out_folds(protocol: Protocol) -> tuple[Fold, ...]:
    """Folds of three families: a flexion angle, a direction of load, and the largest loads.

    A fold that would hold out every trial is none: a protocol of one flexion angle has no fold of
    that family. A load of one size only has no extremes, since nothing smaller of it is left to
    learn from. In a robot's table a flexion angle is the one that was meant, and loads are those
    that a trial is about: stray ones have no direction.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> [fold.name for fold in held_out_folds(load_protocol("seed63"))][:5]
    ['0 deg', '30 deg', '60 deg', 'internal moment', 'external moment']
    """
    # Angles of a rig that differ by its scatter are one.
    flexion_deg = nominal_flexion(protocol)
    angles = np.unique(flexion_deg)
    starts = np.flatnonzero(np.diff(angles, prepend=-np.inf) > SAME_ANGLE_DEG)
    group = np.searchsorted(angles[starts], flexion_deg, side="right") - 1
    found = [
        (FLEXION, f"{np.median(flexion_deg[group == i]):g} deg", np.asarray(group == i))
        for i in range(len(starts))
    ]
    for names, load in zip(DIRECTIONS, _acting(protocol).T, strict=True):
        found += [
            (DIRECTION, name, np.asarray(sign * load > 0))
            for name, sign in zip(names, (1.0, -1.0), strict=True)
        ]
    found.append((EXTREMES, "largest loads", extreme_trials(protocol)))
    return tuple(
        Fold(family=family, name=name, held=held)
        for family, name, held in found
        if held.any() and not held.all()
    )


def extreme_trials(protocol: Protocol) -> BoolArray:
    """Whether a trial bears a load of at least 80 % of the largest of its kind, shape ``(n,)``."""
    sizes = np.abs(_acting(protocol))
    largest = sizes.max(axis=0, initial=0.0)
    beyond = (sizes >= (EXTREME_SHARE - ROUNDING) * largest) & (sizes > 0)
    varies = ((sizes > 0) & ~beyond).any(axis=0)
    return np.asarray((beyond & varies).any(axis=1))


def _acting(protocol: Protocol) -> Array:
    """The loads, shape ``(n, 5)``; of a robot's trials, which read all of them, the main ones."""
    is_nominal = np.array_equal(nominal_flexion(protocol), protocol.flexion_deg)
    return protocol.loads if is_nominal else nominal_loads(protocol)


@declared
class Rmse:
    """Root-mean-square errors; NaN, in a file null, where there is nothing to compare."""

    mm: float = entry("Error of the translations", unit="mm")
    deg: float = entry("Error of the rotations", unit="deg")
    noise: float = entry(
        "Error of all values in units of their noise: 1 where nothing but noise is left", unit="1"
    )


@declared
class Observations:
    """What is known of the m measured values besides their size."""

    trial: IntArray = array("The trial of each", "value", dtype=int)
    coordinate: IntArray = array(
        "Its place in `identknee.laxity.table.COORDINATES`", "value", dtype=int
    )
    sd: Array = array("Standard deviation of its noise alone, in its unit, > 0", "value")
    noise: NoiseModel = entry("Covariance of all errors, nuisances included")
    n_trials: int = entry("Trials of the protocol, those that measured nothing included")

    @property
    def is_angle(self) -> BoolArray:
        """Whether a value is a rotation, shape ``(m,)``."""
        return np.asarray(self.coordinate >= ROTATIONS.start)

    def rmse(self, errors: Array) -> Rmse:
        """Root-mean-square of errors in mm and deg, shape ``(..., m)``; NaN is left out."""
        squares = errors**2
        return Rmse(
            mm=root_mean(squares[..., ~self.is_angle]),
            deg=root_mean(squares[..., self.is_angle]),
            noise=root_mean(squares / self.sd**2),
        )


def observations_of(laxity: Laxity, sd: Array, noise: NoiseModel) -> Observations:
    """The measured values of `laxity`."""
    trial, coordinate = np.nonzero(laxity.is_measured)
    return Observations(
        trial=trial,
        coordinate=coordinate,
        sd=sd[laxity.is_measured],
        noise=noise,
        n_trials=laxity.n,
    )


# Bounds of a coordinate's standard deviation of discrepancy, in units of its noise.
LEAST_SPREAD, MOST_SPREAD = 1e-2, 1e2
START_SPREAD = 1.0
# Most values that are held out and that a process is fitted to: three hundred trials.
MOST_VALUES = 1_500


@declared
class Process:
    """A Gaussian process in each coordinate, fitted to the residuals of the model."""

    absorbed: float = entry("Share of the misfit that it takes up", unit="1")
    degrees_of_freedom: float = entry("Degrees of freedom that it uses", unit="1")
    flexion_length: float = entry("Correlation length over the range of flexion", unit="1")
    load_length: float = entry("Correlation length over the largest load", unit="1")


@declared
class Discrepancy:
    """A fitted process and the residuals without it."""

    process: Process = entry("The process")
    spread: Array = entry(
        "Its standard deviation in each measured coordinate, in units of the noise"
    )
    errors: Array = entry(
        "What it leaves in the data it was fitted to, measured less predicted [mm or deg]"
    )
    observations: Observations = entry(
        "The measured values with it among their errors, for a prediction of held trials"
    )


def fit_discrepancy(
    problem: Problem, observations: Observations, theta: Array, protocol: Protocol
) -> Discrepancy:
    """The Gaussian process of highest marginal likelihood for the residuals of a fitted model.

    A process in each coordinate, smooth in flexion and loads, from which everything is taken out
    that a change of the fitted parameters could do, so that it leaves the fit as it is. Its
    spreads and lengths are those of highest marginal likelihood.
    """
    at, noise = evaluate(problem, theta), observations.noise
    projector = base_projector(noise.whiten(at.jacobian))
    # Whitens and projects at once.
    reduce = projector.project(noise.whiten(np.eye(len(observations.trial))))
    kernel = SmoothKernel(
        protocol, observations.trial, observations.coordinate, observations.sd, reduce
    )
    target = projector.project(noise.whiten(-at.residuals))
    found = kernel.fitted(target, start=START_SPREAD, spreads=(LEAST_SPREAD, MOST_SPREAD))
    own = kernel.projected(kernel.covariance(found.logs))
    # What the process absorbs of each value, by kriging.
    absorbing = cho_solve(cho_factor(np.eye(len(own)) + own), own)
    left = target - absorbing.T @ target
    process = Process(
        absorbed=float(1.0 - left @ left / (target @ target)) if target.any() else 0.0,
        degrees_of_freedom=float(np.trace(absorbing)),
        flexion_length=found.flexion_length,
        load_length=found.load_length,
    )
    return Discrepancy(
        process=process,
        spread=found.spread,
        errors=-at.residuals - noise.factor @ (absorbing.T @ target),
        observations=replace(observations, noise=noise.with_added_covariance(noise.factor, own)),
    )


# Tolerance on the deviance: a tenth of a standard deviation of a parameter at most.
TOLERANCE = 1e-2
MOST_STEPS = 12
# Share of the largest singular value below which a direction is not seen at all.
LEAST_SINGULAR_VALUE = 1e-6


@unique
class FoldStatus(WithSentence):
    """Outcome of a fold."""

    SCORED = ("scored", "The held-out trials were predicted from the others.")
    NOT_MEASURED = (
        "not_measured",
        "No values were measured in the held-out trials or outside them.",
    )
    NOT_IDENTIFIED = (
        "not_identified",
        "Only the held-out trials determine a parameter they depend on.",
    )
    FAILED = ("failed", "The model has no prediction where the fit to the other trials began.")


@declared
class FoldScore:
    """How well one fold was predicted."""

    fold: Fold = entry("The trials")
    status: FoldStatus = entry("Whether they were scored, and why not")
    theta: Array = array("Fitted to the trials kept; NaN where the fold is not scored", "parameter")
    errors: Array = array(
        "Measured less predicted values; NaN where not held out", "value", unit="mm or deg"
    )
    predicted: Array = array(
        "Their predictions' standard deviations, noise included", "value", unit="mm or deg"
    )
    log_density: Array = array(
        "Log predictive density of each held trial's values together; NaN for trials kept", "trial"
    )

    @property
    def is_scored(self) -> bool:
        """Whether the held trials were predicted."""
        return self.status is FoldStatus.SCORED


@declared
class CrossValidation:
    """Cross-validation of a model over all folds."""

    observations: Observations = entry("The measured values")
    scores: tuple[FoldScore, ...] = entry("One for each fold")
    n_simulations: int = entry("Simulations made")

    @property
    def families(self) -> tuple[str, ...]:
        """Families of folds, scored or not, in their order."""
        return tuple(dict.fromkeys(x.fold.family for x in self.scores))

    def rmse(self, family: str | None = None, *, folds: Sequence[Fold] | None = None) -> Rmse:
        """Error of the held values, of one family or all, in the scored folds among `folds`."""
        return self._pooled([x.errors for x in self._chosen(family, folds)])

    def expected_rmse(
        self, family: str | None = None, *, folds: Sequence[Fold] | None = None
    ) -> Rmse:
        """The error that the predictions themselves expect: noise, and what is not known.

        It is more than the noise where the trials kept leave a parameter open that the held ones
        depend on, be the model as right as it may.
        """
        return self._pooled([x.predicted for x in self._chosen(family, folds)])

    def _chosen(self, family: str | None, folds: Sequence[Fold] | None) -> list[FoldScore]:
        return [
            x
            for x in self.scores
            if x.is_scored
            and family in (None, x.fold.family)
            and (folds is None or any(x.fold is fold for fold in folds))
        ]

    def _pooled(self, values: list[Array]) -> Rmse:
        m = len(self.observations.trial)
        return self.observations.rmse(np.array(values).reshape(-1, m))


def held_out(
    problem: Problem, observations: Observations, theta: Array, folds: Sequence[Fold]
) -> CrossValidation:
    """The prediction of each fold by the model fitted to the other trials, and how it fares.

    Every fold is refitted from `theta`, priors included. The prediction of a held trial is Gaussian
    by the model's linearisation there: it holds the noise, what the parameters may still be, and
    what errors shared between trials (nuisances, or a discrepancy) predict from the trials kept. A
    trial whose pose turns sharply with a parameter, such as an unloaded one between two lax poses,
    may stray further than that says.

    Parameters
    ----------
    problem
        Predicted less measured values in mm and deg; parameters with their priors.
    observations
        The measured values, in the order of the residuals.
    theta
        Where the refits start: the fit to all trials, shape ``(p,)``.
    folds
        What to hold out.
    """
    whole = evaluate(problem, theta)
    memory = _MemoisedProblem(problem, whole)
    scores = []
    for fold in folds:
        rows = fold.held[observations.trial]
        held, kept = np.flatnonzero(rows), np.flatnonzero(~rows)
        if not (held.size and kept.size):
            scores.append(_unscored(fold, observations, theta.size, FoldStatus.NOT_MEASURED))
        elif not whole.is_finite:
            scores.append(_unscored(fold, observations, theta.size, FoldStatus.FAILED))
        elif _depends_on_prior(whole, (held, kept), observations, problem.parameters):
            scores.append(_unscored(fold, observations, theta.size, FoldStatus.NOT_IDENTIFIED))
        else:
            scores.append(_score(memory, observations, fold, theta, (held, kept)))
    return CrossValidation(
        observations=observations, scores=tuple(scores), n_simulations=memory.n_simulations
    )


# Evaluations that are looked up: a search may end a few before its last.
REMEMBERED = 6


class _MemoisedProblem:
    """A problem that caches its first and last few evaluations."""

    def __init__(self, problem: Problem, first: Evaluation) -> None:
        self._problem = problem
        self._first, self._last = first, list[Evaluation]()
        self.n_simulations = 1

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self._problem.parameters

    def __call__(self, theta: Array) -> Evaluation:
        for known in (self._first, *self._last):
            if np.array_equal(known.theta, theta):
                return known
        self.n_simulations += 1
        self._last = [evaluate(self._problem, theta), *self._last[: REMEMBERED - 1]]
        return self._last[0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Kept:
    """Whitened residuals of the trials that are not held out."""

    memory: _MemoisedProblem
    rows: IntArray
    noise: NoiseModel

    @property
    def parameters(self) -> Parameters:
        """Those of the whole problem."""
        return self.memory.parameters

    def residuals(self, theta: Array) -> Array:
        """Whitened, shape ``(m_kept,)``."""
        residuals = self.memory(theta).residuals[self.rows]
        if not np.isfinite(residuals).all():
            return residuals
        return self.noise.whiten(residuals)

    def jacobian(self, theta: Array) -> Array:
        """Change of the residuals with theta, shape ``(m_kept, p)``."""
        return self.noise.whiten(self.memory(theta).jacobian[self.rows])


def _score(
    memory: _MemoisedProblem,
    observations: Observations,
    fold: Fold,
    theta: Array,
    rows: tuple[IntArray, IntArray],
) -> FoldScore:
    held, kept = rows
    noise = observations.noise
    among = noise.of(np.isin(np.arange(noise.n), kept))
    problem = ProblemWithPriors(problem=_Kept(memory=memory, rows=kept, noise=among))
    found = minimise(Evaluator(problem), theta, tolerance=TOLERANCE, most_steps=MOST_STEPS)
    if not found.evaluation.is_finite:
        return _unscored(fold, observations, theta.size, FoldStatus.FAILED)
    at = memory(found.evaluation.theta)
    # What errors of the trials kept imply for those of the trials held out.
    weights = among.whiten(noise.between(kept, held)).T
    left = -(at.residuals[held] - weights @ among.whiten(at.residuals[kept]))
    slope = at.jacobian[held] - weights @ among.whiten(at.jacobian[kept])
    spread = noise.between(held, held) - weights @ weights.T
    # The parameters vary too, but for those that a bound holds.
    jacobian, free = found.evaluation.jacobian, np.flatnonzero(~found.is_held)
    own_covariance = np.zeros((jacobian.shape[1],) * 2)
    information = jacobian[:, free].T @ jacobian[:, free]
    own_covariance[np.ix_(free, free)] = cho_solve(cho_factor(information), np.eye(free.size))
    spread += slope @ own_covariance @ slope.T
    errors, predicted = (np.full(noise.n, np.nan) for _ in range(2))
    errors[held], predicted[held] = left, np.sqrt(np.diag(spread))
    # Log density of each trial's values together, shape ``(n,)``; NaN where it has none.
    trial = observations.trial[held]
    densities = np.full(observations.n_trials, np.nan)
    for number in np.unique(trial):
        own = np.flatnonzero(trial == number)
        root = np.linalg.cholesky(spread[np.ix_(own, own)])
        whitened = solve_triangular(root, left[own], lower=True)
        densities[number] = -0.5 * (whitened @ whitened + own.size * np.log(2.0 * np.pi))
        densities[number] -= np.log(np.diag(root)).sum()
    return FoldScore(
        fold=fold,
        status=FoldStatus.SCORED,
        theta=found.evaluation.theta,
        errors=errors,
        predicted=predicted,
        log_density=densities,
    )


def _depends_on_prior(
    whole: Evaluation, rows: tuple[IntArray, IntArray], observations: Observations, p: Parameters
) -> bool:
    """Whether held values depend, by more than noise, on directions that kept trials leave open.

    Few trials leave some directions of many parameters to the prior; only those that the prediction
    depends on count.
    """
    steps = p.prior_sd * np.where(p.is_log, whole.theta, 1.0)
    scaled = whole.jacobian / observations.sd[:, None] * steps
    held, kept = (scaled[x] for x in rows)
    _, sizes, directions = np.linalg.svd(np.linalg.qr(kept, mode="r"))
    least = LEAST_SINGULAR_VALUE * max(sizes[0], np.finfo(float).tiny)
    unseen = held @ directions[np.count_nonzero(sizes > least) :].T
    return bool(np.any(np.linalg.norm(unseen, axis=1) > 1.0))


def _unscored(fold: Fold, observations: Observations, p: int, status: FoldStatus) -> FoldScore:
    m = len(observations.trial)
    return FoldScore(
        fold=fold,
        status=status,
        theta=np.full(p, np.nan),
        errors=np.full(m, np.nan),
        predicted=np.full(m, np.nan),
        log_density=np.full(observations.n_trials, np.nan),
    )


# Squared distance of two predictions in units of the noise below which they are the same.
LEAST_SIGNATURE = 1.0


@declared
class FamilyDifference:
    """The difference in log predictive density over one family of folds."""

    family: str = entry("Family of the folds")
    difference: float = entry(
        "Sum over the held trials of the second model's log density less the first's; 0 where no "
        "fold counts"
    )
    se: float = entry("Its standard error over trials; NaN where no fold counts")
    folds: tuple[Fold, ...] = entry("Folds that count")
    without_signature: tuple[Fold, ...] = entry(
        "Folds in which both models predict the same, so that they say nothing of their difference"
    )
    not_scored: tuple[tuple[Fold, str], ...] = entry(
        "Folds that one of both models could not predict, with the reason"
    )


@declared
class ElpdDifference:
    """The difference in log predictive density of held trials: after less before."""

    difference: float = entry(
        "Difference over all trials, each averaged over the folds that hold it out; 0 where no "
        "fold counts"
    )
    se: float = entry("Its standard error; NaN where no fold counts")
    families: tuple[FamilyDifference, ...] = entry("Difference for each family of folds")

    @property
    def folds(self) -> tuple[Fold, ...]:
        """All folds that count."""
        return tuple(fold for x in self.families for fold in x.folds)


def elpd_difference(before: CrossValidation, after: CrossValidation) -> ElpdDifference:
    """How much better `after` predicts held trials than `before`.

    Standard errors take trials as independent, not the values of a trial. A fold counts where both
    models predict its trials, and not the same.

    Raises
    ------
    ValueError
        If the two were not scored on the same folds.

    References
    ----------
    A. Vehtari, A. Gelman and J. Gabry, Practical Bayesian model evaluation using leave-one-out
    cross-validation and WAIC, Stat. Comput. 27 (2017) 1413-1432, doi:10.1007/s11222-016-9696-4,
    section 5.
    """
    if [x.fold for x in before.scores] != [x.fold for x in after.scores]:
        raise ValueError("the two models were scored on different folds; use the same ones")
    pairs = list(zip(before.scores, after.scores, strict=True))
    families = []
    for family in before.families:
        own = [x for x in pairs if x[0].fold.family == family]
        families.append(_family(family, own, before.observations))
    counted = {id(fold) for x in families for fold in x.folds}
    used = [x for x in pairs if id(x[0].fold) in counted]
    difference, se = _summed(used, before.observations.n_trials)
    return ElpdDifference(difference=difference, se=se, families=tuple(families))


def _family(
    family: str, pairs: list[tuple[FoldScore, FoldScore]], observations: Observations
) -> FamilyDifference:
    counted, same, missing = [], [], []
    for before, after in pairs:
        fold = before.fold
        if not (before.is_scored and after.is_scored):
            worse = after if before.is_scored else before
            missing.append((fold, worse.status.sentence))
        elif _signature(before, after, observations) < LEAST_SIGNATURE:
            same.append(fold)
        else:
            counted.append((before, after))
    difference, se = _summed(counted, observations.n_trials)
    return FamilyDifference(
        family=family,
        difference=difference,
        se=se,
        folds=tuple(x.fold for x, _ in counted),
        without_signature=tuple(same),
        not_scored=tuple(missing),
    )


def _signature(before: FoldScore, after: FoldScore, observations: Observations) -> float:
    """Squared distance of the two predictions of a fold, in units of the noise."""
    held = np.flatnonzero(before.fold.held[observations.trial])
    apart = before.errors[held] - after.errors[held]
    covariance = observations.noise.between(held, held)
    return float(apart @ np.linalg.solve(covariance, apart))


def _summed(pairs: list[tuple[FoldScore, FoldScore]], n_trials: int) -> tuple[float, float]:
    """Sum over trials of the mean difference over folds, and its standard error."""
    gains = np.array([y.log_density - x.log_density for x, y in pairs]).reshape(-1, n_trials)
    is_held = ~np.isnan(gains)
    times = is_held.sum(axis=0)
    seen = times > 0
    by_trial: Array = np.where(is_held, gains, 0.0).sum(axis=0)[seen] / times[seen]
    n = by_trial.size
    se = float(np.sqrt(n * np.var(by_trial, ddof=1))) if n > 1 else float("nan")
    return float(by_trial.sum()), se


@declared
class Assessment:
    """Misfit, evidence and held-out prediction of one model."""

    check: ResidualTest = entry(
        "Chi-square of the data and of the priors of nuisances and causes, its degrees of freedom "
        "and its probability"
    )
    errors: Array = array("Measured less predicted values", "value", unit="mm or deg")
    in_sample: Rmse = entry("Their root mean squares")
    held_out: CrossValidation = entry("Prediction of trials it was not fitted to")
    posterior: Laplace = entry("Intervals of its parameters")
    log_evidence: float = entry("Log evidence by which causes are ranked, up to a constant")


@declared
class ParameterChange:
    """A parameter of both models, before and after."""

    name: str = entry("Name of the parameter")
    before: float = entry("Its value without the cause", unit=OF_PARAMETER)
    after: float = entry("Its value with the cause", unit=OF_PARAMETER)
    interval_before: Interval = entry(
        "95 % interval without; an open end is null", unit=OF_PARAMETER, key="ci95_before"
    )
    interval_after: Interval = entry("95 % interval with", unit=OF_PARAMETER, key="ci95_after")
    shift: float = entry(
        "How far it moved, in standard errors of before", unit="1", key="shift_in_se"
    )
    interval_ratio: float = entry(
        "Length of the interval after over before, the price of one more cause; null where one of "
        "them is open",
        unit="1",
    )


@declared
class ForceChange:
    """Ligament forces under the largest loads, before and after."""

    trials: tuple[str, ...] = array("Names of the trials", "trial", is_in_arrays=False)
    ligaments: tuple[str, ...] = array("Names of the ligaments", "ligament", is_in_arrays=False)
    before: Array = array(
        "Forces without the cause; NaN where a trial has no equilibrium",
        "trial",
        "ligament",
        unit="N",
    )
    after: Array = array("Forces with the cause, likewise", "trial", "ligament", unit="N")


@declared
class Gain:
    """What the cause gains over the base model, and what a Gaussian process does in its place."""

    before: Assessment = entry("The base model")
    after: Assessment = entry("The model with the cause")
    absorbed: Assessment = entry(
        "The base model with a Gaussian process for what it leaves: it names nothing. Its spreads "
        "and lengths are those of all trials also where some are held out, to its favour"
    )
    discrepancy: Discrepancy = entry("That process")
    elpd: ElpdDifference = entry(
        "Log predictive density of held trials, with the cause less without it"
    )
    elpd_absorbed: ElpdDifference = entry(
        "Log predictive density of held trials, of the process less the base model"
    )
    explained: dict[str, float] = entry(
        "Share of the mean square of each measured coordinate that the cause removes; negative "
        "where it adds"
    )
    parameters: tuple[ParameterChange, ...] = entry("Those of both models")
    forces: ForceChange = entry("Ligament forces under the largest loads")

    @property
    def log_evidence_difference(self) -> float:
        """Logarithm of the Bayes factor of the cause."""
        return self.after.log_evidence - self.before.log_evidence

    @property
    def shared_folds(self) -> tuple[Fold, ...]:
        """Folds that both models predict."""
        pairs = zip(self.before.held_out.scores, self.after.held_out.scores, strict=True)
        return tuple(x.fold for x, y in pairs if x.is_scored and y.is_scored)

    def rmse_held_out(self, of: Assessment, family: str | None = None) -> Rmse:
        """Error of held values over the folds that both models predict."""
        return of.held_out.rmse(family, folds=self.shared_folds)

    def expected_rmse(self, of: Assessment, family: str | None = None) -> Rmse:
        """The error that `of` itself expects there, see `CrossValidation.expected_rmse`."""
        return of.held_out.expected_rmse(family, folds=self.shared_folds)


def measure_gain(
    before: FittedModel, after: FittedModel, sd: Array, *, noise_degrees: float = np.inf
) -> Gain:
    """What the model `after` gains over `before`, fitted to the same data.

    Trials are held out, and a process is fitted, among 1,500 values at most, of trials drawn at
    random: both take the cube of their number.

    Parameters
    ----------
    before, after
        The fits without and with the cause; noise and nuisances are those of `before`.
    sd
        Standard deviation of the noise alone of each value, shape ``(n, 5)``.
    noise_degrees
        Degrees of freedom of the noise where it is an estimate.
    """
    observations = observations_of(before.laxity, sd, before.noise)
    is_used = _sampled_trials(before.laxity)
    parts = before, after
    if not is_used.all():
        parts = _part(before, is_used), _part(after, is_used)
        sd = sd if parts[0].laxity.n == len(sd) else sd[is_used]
    base, protocol = parts[0], parts[0].laxity.protocol
    sampled, folds = observations_of(base.laxity, sd, base.noise), held_out_folds(protocol)
    assessed = [
        _assess(x, observations, held_out(y.compared, sampled, y.theta, folds), noise_degrees)
        for x, y in zip((before, after), parts, strict=True)
    ]
    discrepancy = fit_discrepancy(base.compared, sampled, base.theta, protocol)
    # The same fit under the process as noise.
    noisier = discrepancy.observations
    absorbed = _assess(
        base, noisier, held_out(base.compared, noisier, base.theta, folds), noise_degrees
    )
    absorbed = replace(
        absorbed, errors=discrepancy.errors, in_sample=sampled.rmse(discrepancy.errors)
    )
    explained = {}
    for k in np.unique(observations.coordinate):
        own = observations.coordinate == k
        whole, left = (np.sum((x.errors[own] / observations.sd[own]) ** 2) for x in assessed)
        explained[COORDINATES[k]] = float(1.0 - left / whole) if whole > 0 else 0.0
    extreme = np.flatnonzero(extreme_trials(before.laxity.protocol))
    forces = []
    for fitted in (before, after):
        model = fitted.compared.model
        forces.append(tensions_of(model, model.predict_once(fitted.theta))[extreme])
    return Gain(
        before=assessed[0],
        after=assessed[1],
        absorbed=absorbed,
        discrepancy=discrepancy,
        elpd=elpd_difference(assessed[0].held_out, assessed[1].held_out),
        elpd_absorbed=elpd_difference(assessed[0].held_out, absorbed.held_out),
        explained=explained,
        parameters=_parameter_changes(before, after, assessed[0].posterior, assessed[1].posterior),
        forces=ForceChange(
            trials=tuple(before.laxity.protocol.trials[i] for i in extreme),
            ligaments=tuple(x.name for x in before.model.knee.ligaments),
            before=forces[0],
            after=forces[1],
        ),
    )


def _sampled_trials(laxity: Laxity) -> BoolArray:
    """The trials of which some are held out: all, or as many at random as have so many values."""
    order = np.random.default_rng(0).permutation(laxity.n)
    n_values = np.cumsum(laxity.is_measured.sum(axis=1)[order])
    is_used = np.zeros(laxity.n, bool)
    is_used[order[(n_values <= MOST_VALUES) | (n_values[-1] <= MOST_VALUES)]] = True
    return is_used


def _part(fitted: FittedModel, is_used: BoolArray) -> FittedModel:
    """A fit to all trials as it is for some of them."""
    laxity = fitted.laxity
    # Changes of coordinates may count from any of the others.
    is_absolute = laxity.zero == ABSOLUTE
    laxity = laxity.select(is_used) if is_absolute else laxity.without(~is_used)
    rows = np.broadcast_to(is_used[:, None], fitted.laxity.is_measured.shape)
    noise = fitted.noise.of(rows[fitted.laxity.is_measured])
    model = fitted.model.with_tests(laxity)
    at = evaluate(whitened_problem(model, laxity, noise), fitted.theta)
    return FittedModel(
        model=model,
        laxity=laxity,
        noise=noise,
        constrained=replace(fitted.constrained, evaluation=at),
    )


def _assess(
    fitted: FittedModel, observations: Observations, held: CrossValidation, noise_degrees: float
) -> Assessment:
    if observations.noise is fitted.noise:
        at, posterior = fitted.evaluation, posterior_of(fitted)
    else:
        problem = whitened_problem(fitted.model, fitted.laxity, observations.noise)
        at = evaluate(problem, fitted.theta)
        posterior = laplace(at, fitted.model.parameters, observations.noise.scale)
    errors, counts = -fitted.compared.residuals(fitted.theta), fitted.counts_as_misfit
    return Assessment(
        check=omnibus_check(
            -at.residuals[counts], base_projector(at.jacobian[counts]), noise_degrees=noise_degrees
        ),
        errors=errors,
        in_sample=observations.rmse(errors),
        held_out=held,
        posterior=posterior,
        log_evidence=log_evidence(at, fitted.model.parameters, fitted.constrained.is_held),
    )


def _parameter_changes(
    before: FittedModel, after: FittedModel, old: Laplace, new: Laplace
) -> tuple[ParameterChange, ...]:
    changes = []
    for i, name in enumerate(before.model.parameters.names):
        j = after.model.parameters.index(name)
        intervals = old.interval(i), new.interval(j)
        was, now = (
            float("nan") if None in x else float(np.ptp(np.array(x, dtype=np.float64)))
            for x in intervals
        )
        changes.append(
            ParameterChange(
                name=name,
                before=float(old.theta[i]),
                after=float(new.theta[j]),
                interval_before=intervals[0],
                interval_after=intervals[1],
                shift=float((new.theta[j] - old.theta[i]) / old.sd[i]),
                interval_ratio=float(now / was) if was > 0 else float("nan"),
            )
        )
    return tuple(changes)
