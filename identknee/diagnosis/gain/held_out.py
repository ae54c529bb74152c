"""How well a model predicts trials that it was not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, unique

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from identknee.calibrate.constrained import Constrained, minimise
from identknee.calibrate.evaluation import Evaluation, Evaluator, evaluate
from identknee.calibrate.problem import Problem, WithPriors
from identknee.diagnosis.gain.folds import Fold, Observations, Rmse
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry

# Tolerance on the deviance: a tenth of a standard deviation of a parameter at most.
TOLERANCE = 1e-2
MOST_STEPS = 12
# Share of the largest singular value below which a direction is not seen at all.
LEAST_SINGULAR_VALUE = 1e-6


@unique
class FoldStatus(Enum):
    """What became of a fold."""

    SCORED = "scored"
    NOT_MEASURED = "not_measured"
    NOT_IDENTIFIED = "not_identified"
    FAILED = "failed"

    @property
    def sentence(self) -> str:
        """The same for a person."""
        return _SENTENCES[self]


_SENTENCES = {
    FoldStatus.SCORED: "The held trials were predicted from the others.",
    FoldStatus.NOT_MEASURED: "Nothing was measured in the held trials, or in no others.",
    FoldStatus.NOT_IDENTIFIED: "The held trials depend on something that only they show.",
    FoldStatus.FAILED: "The model has no prediction where the fit to the other trials began.",
}


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
class HeldOut:
    """How well a model predicts the held trials of all folds."""

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
) -> HeldOut:
    """The prediction of each fold by the model fitted to the other trials, and how it fares.

    Every fold is refitted from `theta`, priors included. The prediction of a held trial is Gaussian
    by the model's linearisation there: it holds the noise, what the parameters may still be, and
    what errors shared between trials (nuisances, or a discrepancy) tell from the trials kept. A
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
    memory = _Memory(problem, whole)
    scores = []
    for fold in folds:
        rows = fold.held[observations.trial]
        held, kept = np.flatnonzero(rows), np.flatnonzero(~rows)
        if not (held.size and kept.size):
            scores.append(_unscored(fold, observations, theta.size, FoldStatus.NOT_MEASURED))
        elif not whole.is_finite:
            scores.append(_unscored(fold, observations, theta.size, FoldStatus.FAILED))
        elif _hangs_on_the_prior(whole, (held, kept), observations, problem.parameters):
            scores.append(_unscored(fold, observations, theta.size, FoldStatus.NOT_IDENTIFIED))
        else:
            scores.append(_score(memory, observations, fold, theta, (held, kept)))
    return HeldOut(
        observations=observations, scores=tuple(scores), n_simulations=memory.n_simulations
    )


class _Memory:
    """A problem of which the first and the last evaluation are remembered."""

    def __init__(self, problem: Problem, first: Evaluation) -> None:
        self._problem = problem
        self._known = [first, first]
        self.n_simulations = 1

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self._problem.parameters

    def __call__(self, theta: Array) -> Evaluation:
        for known in self._known:
            if np.array_equal(known.theta, theta):
                return known
        self.n_simulations += 1
        self._known[1] = evaluate(self._problem, theta)
        return self._known[1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Kept:
    """The residuals of the trials kept, in units in which their errors are independent."""

    memory: _Memory
    rows: IntArray
    factor: Array

    @property
    def parameters(self) -> Parameters:
        """Those of the whole problem."""
        return self.memory.parameters

    def residuals(self, theta: Array) -> Array:
        """Whitened, shape ``(m_kept,)``."""
        residuals = self.memory(theta).residuals[self.rows]
        if not np.isfinite(residuals).all():
            return residuals
        return np.asarray(solve_triangular(self.factor, residuals, lower=True))

    def jacobian(self, theta: Array) -> Array:
        """Change of the residuals with theta, shape ``(m_kept, p)``."""
        jacobian = self.memory(theta).jacobian[self.rows]
        return np.asarray(solve_triangular(self.factor, jacobian, lower=True))


def _score(
    memory: _Memory,
    observations: Observations,
    fold: Fold,
    theta: Array,
    rows: tuple[IntArray, IntArray],
) -> FoldScore:
    held, kept = rows
    covariance = observations.noise.covariance
    factor = np.asarray(np.linalg.cholesky(covariance[np.ix_(kept, kept)]))
    problem = WithPriors(problem=_Kept(memory=memory, rows=kept, factor=factor))
    found = minimise(Evaluator(problem), theta, tolerance=TOLERANCE, most_steps=MOST_STEPS)
    if not found.evaluation.is_finite:
        return _unscored(fold, observations, theta.size, FoldStatus.FAILED)
    at = memory(found.evaluation.theta)
    # What errors of the trials kept tell about those of the trials held.
    shared = covariance[np.ix_(held, kept)]
    weights = cho_solve((factor, True), shared.T).T
    left = -(at.residuals[held] - weights @ at.residuals[kept])
    slope = at.jacobian[held] - weights @ at.jacobian[kept]
    spread = covariance[np.ix_(held, held)] - weights @ shared.T
    spread += slope @ _posterior_covariance(found) @ slope.T
    errors, predicted = (np.full(len(covariance), np.nan) for _ in range(2))
    errors[held], predicted[held] = left, np.sqrt(np.diag(spread))
    return FoldScore(
        fold=fold,
        status=FoldStatus.SCORED,
        theta=found.evaluation.theta,
        errors=errors,
        predicted=predicted,
        log_density=_by_trial(left, spread, observations.trial[held], observations.n_trials),
    )


def _posterior_covariance(found: Constrained) -> Array:
    """Covariance of the parameters of a fit with priors, shape ``(p, p)``.

    Parameters
    ----------
    found
        A fit in units of the noise, rows of the priors included. A parameter that a bound holds
        does not vary.
    """
    jacobian, free = found.evaluation.jacobian, np.flatnonzero(~found.is_held)
    covariance = np.zeros((jacobian.shape[1],) * 2)
    information = jacobian[:, free].T @ jacobian[:, free]
    covariance[np.ix_(free, free)] = cho_solve(cho_factor(information), np.eye(free.size))
    return covariance


def _by_trial(left: Array, spread: Array, trial: IntArray, n_trials: int) -> Array:
    """Log density of each trial's values together, shape ``(n,)``; NaN where it has none."""
    densities = np.full(n_trials, np.nan)
    for number in np.unique(trial):
        own = np.flatnonzero(trial == number)
        factor = np.linalg.cholesky(spread[np.ix_(own, own)])
        whitened = solve_triangular(factor, left[own], lower=True)
        densities[number] = -0.5 * (whitened @ whitened + own.size * np.log(2.0 * np.pi))
        densities[number] -= np.log(np.diag(factor)).sum()
    return densities


def _hangs_on_the_prior(
    whole: Evaluation, rows: tuple[IntArray, IntArray], observations: Observations, p: Parameters
) -> bool:
    """Whether held values vary by more than noise with what the trials kept say nothing of.

    Few trials always leave some direction of many parameters to the prior; it counts where the
    prediction depends on it.
    """
    steps = p.prior_sd * np.where(p.is_log, whole.theta, 1.0)
    scaled = whole.jacobian / observations.sd[:, None] * steps
    held, kept = (scaled[x] for x in rows)
    _, sizes, directions = np.linalg.svd(kept)
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
