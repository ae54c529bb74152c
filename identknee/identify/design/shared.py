"""Errors that the trials made and those that may be added share, averaged over to first order.

Both tell of the errors, so that what a trial tells depends on the others. Known as well as the
others leave them, errors widen what it measures, and it is a trial with noise of its own again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from identknee.calibrate.problem import Problem
from identknee.identify.design.added_trials import Candidates, WithTrials
from identknee.identify.design.better_known import SHARE
from identknee.identify.design.criteria import Loss
from identknee.identify.design.predictions import CandidatePredictions
from identknee.identify.marginal import Marginal, marginal
from identknee.identify.nuisances import nuisance_places
from identknee.runs.arrays import Array, BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AtBestErrors:
    """Candidates as they would be with the errors as they fit best.

    Attributes
    ----------
    candidates
        Predicted for all parameters.
    theta
        The best fit of all, shape ``(n,)``.
    is_of_interest
        Which of them vary, shape ``(n,)``.
    """

    candidates: Candidates
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


class Known(NamedTuple):
    """Errors as some trials leave them, at q points: mean, its slope and covariance."""

    mean: Array
    slope: Array
    covariance: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedErrors:
    """A problem whose nuisances its candidates share.

    Attributes
    ----------
    problem
        The parameters of interest alone, see `Marginal`.
    candidates
        The trials that may be added.
    slopes
        Change of each value of a candidate with one prior standard deviation of each error, shape
        ``(k, m, e)``; NaN where the candidate has no prediction.
    groups
        Which errors belong together, by name.
    """

    problem: Marginal
    candidates: AtBestErrors
    slopes: Array
    groups: dict[str, list[int]]

    def with_trials(self, chosen: tuple[int, ...], theta: Array) -> Marginal:
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

    def known(self, points: CandidatePredictions) -> Known:
        """The errors as the trials made leave them, less their best fit, at the points."""
        slopes, inner = self.problem.slopes, self.problem.problem
        covariance = np.asarray(np.linalg.inv(np.eye(slopes.shape[1]) + slopes.T @ slopes), float)
        gain = -covariance @ slopes.T
        residuals = np.array([inner.residuals(x) for x in points.thetas])
        jacobians = np.array([inner.jacobian(x) for x in points.thetas]) * points.scales
        return Known(
            mean=(residuals - residuals[0]) @ gain.T,
            slope=gain @ jacobians,
            covariance=covariance,
        )


def told(known: Known, values: Array, jacobians: Array, slopes: Array) -> tuple[Array, Array]:
    """What k trials tell beside those that the errors are known from, as of independent noise.

    Parameters
    ----------
    known
        The errors.
    values, jacobians
        Of the trials, shapes ``(q, k, m)`` and ``(q, k, m, n)``.
    slopes
        Their change with the errors, shape ``(k, m, e)``.
    """
    spread = np.eye(slopes.shape[1]) + slopes @ known.covariance @ slopes.mT
    whitening = np.linalg.inv(np.linalg.cholesky(spread))
    values = values + np.einsum("kme,qe->qkm", slopes, known.mean)
    jacobians = jacobians + np.einsum("kme,qen->qkmn", slopes, known.slope, optimize=True)
    return (
        np.einsum("kab,qkb->qka", whitening, values),
        np.einsum("kab,qkbn->qkan", whitening, jacobians, optimize=True),
    )


def better_known(known: Known, value: Array, jacobian: Array, slopes: Array) -> Known:
    """The errors with one more trial, its change from the best fit ``(q, m)`` and ``(q, m, n)``."""
    spread = np.eye(len(slopes)) + slopes @ known.covariance @ slopes.T
    gain = np.linalg.solve(spread, slopes @ known.covariance).T
    # Beyond what the data allow a trial may have no prediction: it then says nothing.
    value = np.nan_to_num(value + known.mean @ slopes.T)
    jacobian = np.nan_to_num(jacobian + slopes @ known.slope)
    return Known(
        mean=known.mean - value @ gain.T,
        slope=known.slope - gain @ jacobian,
        covariance=known.covariance - gain @ slopes @ known.covariance,
    )


def shared_errors(problem: Problem, theta: Array, candidates: Candidates) -> SharedErrors:
    """The nuisances of a problem as errors that its candidates share, about the best fit theta."""
    parameters = problem.parameters
    is_asked = parameters.is_of_interest
    _, jacobians = candidates.predict(theta, range(len(candidates.names)))
    errors = np.flatnonzero(~is_asked)
    place = {int(x): i for i, x in enumerate(errors)}
    return SharedErrors(
        problem=marginal(problem, theta),
        candidates=AtBestErrors(candidates=candidates, theta=theta, is_of_interest=is_asked),
        slopes=jacobians[:, :, errors] * parameters.prior_sd[errors],
        groups={name: [place[i] for i in x] for name, x in nuisance_places(parameters).items()},
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Telling:
    """Features of the trials made with some added, and of each trial that may follow.

    Attributes
    ----------
    loss
        Whose features.
    points
        Where trials were predicted.
    allowed
        Which candidates are offered, shape ``(k,)``.
    shared, known
        The errors that trials share, and as the trials made leave them; None where there are none.
    """

    loss: Loss
    points: CandidatePredictions
    allowed: BoolArray
    shared: SharedErrors | None = None
    known: Known | None = None

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
            made = made + self.loss.of_trials(*told(known, *own))[0]
            known = better_known(known, own[0][:, 0], own[1][:, 0], own[2][0])
        offered = np.flatnonzero(self.allowed)
        trials[offered] = self.loss.of_trials(*told(known, *self._of(offered.tolist())))
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
            slopes = np.sqrt(SHARE**-2 - 1.0) * np.eye(n)[None, places]
            rows = told(self.known, np.zeros((q, 1, m)), np.zeros((q, 1, m, p)), slopes)
            found[name] = self.loss.of_trials(*rows)
        return found

    def _of(self, trials: list[int]) -> tuple[Array, Array, Array]:
        """Changes of trials from the best fit, their derivatives, and their slopes."""
        if self.shared is None:  # pragma: no cover - asked for with shared errors only
            raise AssertionError
        values = self.points.values[:, trials]
        return values - values[0], self.points.jacobians[:, trials], self.shared.slopes[trials]
