"""What a named cause gains: misfit, prediction of held trials, evidence, parameters, forces."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identknee.diagnosis.base_fit import Fitted
from identknee.diagnosis.discrepancy import Discrepancy, fit_discrepancy
from identknee.diagnosis.elpd import ElpdDifference, elpd_difference
from identknee.diagnosis.folds import Fold, extreme_trials, held_out_folds
from identknee.diagnosis.goodness import Check, omnibus_check
from identknee.diagnosis.held_out import HeldOut, held_out
from identknee.diagnosis.laplace import Laplace, laplace
from identknee.diagnosis.observations import Observations, Rmse, observations_of
from identknee.diagnosis.projection import base_projector
from identknee.diagnosis.weighing import weighed
from identknee.identify.evaluation import Evaluation, evaluate
from identknee.laxity.table import COORDINATES
from identknee.model.tensions import tensions_of
from identknee.runs.arrays import Array, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessment:
    """How well one model does.

    Attributes
    ----------
    check
        Chi-square of data and priors together, its degrees of freedom and its probability.
    errors
        Measured less predicted values [mm, deg], shape ``(m,)``.
    in_sample
        Their root mean squares.
    held_out
        Prediction of trials it was not fitted to.
    posterior
        Intervals of its parameters and its evidence.
    """

    check: Check
    errors: Array
    in_sample: Rmse
    held_out: HeldOut
    posterior: Laplace

    def __post_init__(self) -> None:
        object.__setattr__(self, "errors", frozen(self.errors, None, name="errors"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterChange:
    """A parameter of both models, before and after.

    Attributes
    ----------
    name
        Of the parameter.
    before, after
        Its values, in its own unit.
    interval_before, interval_after
        95 % intervals; an end is None where the data give none, as in `Estimate`.
    shift
        How far it moved, in standard errors of before.
    interval_ratio
        Length of the interval after over before: the honest price of one more cause; NaN where one
        of them is open.
    """

    name: str
    before: float
    after: float
    interval_before: tuple[float | None, float | None]
    interval_after: tuple[float | None, float | None]
    shift: float
    interval_ratio: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceChange:
    """Ligament forces under the largest loads, before and after.

    Attributes
    ----------
    trials
        Names of the trials.
    ligaments
        Names of the ligaments.
    before, after
        Their forces [N], shape ``(n_trials, n_ligaments)``; NaN where a trial has no equilibrium.
    """

    trials: tuple[str, ...]
    ligaments: tuple[str, ...]
    before: Array
    after: Array

    def __post_init__(self) -> None:
        shape = len(self.trials), len(self.ligaments)
        for name in ("before", "after"):
            object.__setattr__(self, name, frozen(getattr(self, name), *shape, name=name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gain:
    """What the cause gains over the base model, and what a Gaussian process does in its place.

    Attributes
    ----------
    before, after
        The base model, and the one with the cause.
    absorbed
        The base model with a Gaussian process for what it leaves: it names nothing. Its spreads and
        lengths are those of all trials also where some are held out, to its favour.
    discrepancy
        That process.
    elpd
        Log predictive density of held trials, with the cause less without it.
    elpd_absorbed
        The same of the process less the base model.
    explained
        Share of the mean square of each measured coordinate that the cause removes; negative where
        it adds.
    parameters
        Those of both models.
    forces
        Ligament forces under the largest loads.
    """

    before: Assessment
    after: Assessment
    absorbed: Assessment
    discrepancy: Discrepancy
    elpd: ElpdDifference
    elpd_absorbed: ElpdDifference
    explained: dict[str, float]
    parameters: tuple[ParameterChange, ...]
    forces: ForceChange

    @property
    def log_evidence_difference(self) -> float:
        """Logarithm of the Bayes factor of the cause."""
        return self.after.posterior.log_evidence - self.before.posterior.log_evidence

    @property
    def shared_folds(self) -> tuple[Fold, ...]:
        """Folds that both models predict."""
        pairs = zip(self.before.held_out.scores, self.after.held_out.scores, strict=True)
        return tuple(x.fold for x, y in pairs if x.is_scored and y.is_scored)

    def rmse_held_out(self, of: Assessment, family: str | None = None) -> Rmse:
        """Error of held values over the folds that both models predict."""
        return of.held_out.rmse(family, folds=self.shared_folds)

    def expected_rmse(self, of: Assessment, family: str | None = None) -> Rmse:
        """The error that `of` itself expects there, see `HeldOut.expected_rmse`."""
        return of.held_out.expected_rmse(family, folds=self.shared_folds)


def measure_gain(
    before: Fitted, after: Fitted, sd: Array, *, noise_degrees: float = np.inf
) -> Gain:
    """What the model `after` gains over `before`, fitted to the same data.

    Parameters
    ----------
    before, after
        The fits without and with the cause; noise and nuisances are those of `before`.
    sd
        Standard deviation of the noise alone of each value, shape ``(n, 5)``.
    noise_degrees
        Degrees of freedom of the noise where it is an estimate.
    """
    laxity = before.laxity
    observations = observations_of(laxity, sd, before.noise)
    folds = held_out_folds(laxity.protocol)
    assessed = [_assess(x, observations, folds, noise_degrees) for x in (before, after)]
    discrepancy = fit_discrepancy(before.compared, observations, before.theta, laxity.protocol)
    # The same fit under the process as noise.
    with_process = replace(observations, noise=discrepancy.noise)
    absorbed = _assess(before, with_process, folds, noise_degrees)
    absorbed = replace(
        absorbed,
        errors=discrepancy.errors,
        in_sample=observations.rmse(discrepancy.errors),
    )
    return Gain(
        before=assessed[0],
        after=assessed[1],
        absorbed=absorbed,
        discrepancy=discrepancy,
        elpd=elpd_difference(assessed[0].held_out, assessed[1].held_out),
        elpd_absorbed=elpd_difference(assessed[0].held_out, absorbed.held_out),
        explained=_explained(observations, assessed[0].errors, assessed[1].errors),
        parameters=_parameter_changes(before, after, assessed[0].posterior, assessed[1].posterior),
        forces=_force_change(before, after),
    )


def _assess(
    fitted: Fitted, observations: Observations, folds: Sequence[Fold], noise_degrees: float
) -> Assessment:
    at = _evaluation(fitted, observations)
    errors = -fitted.compared.residuals(fitted.theta)
    return Assessment(
        check=omnibus_check(
            -at.residuals, base_projector(at.jacobian), noise_degrees=noise_degrees
        ),
        errors=errors,
        in_sample=observations.rmse(errors),
        held_out=held_out(fitted.compared, observations, fitted.theta, folds),
        posterior=laplace(at, fitted.model.parameters, observations.noise.factor),
    )


def _evaluation(fitted: Fitted, observations: Observations) -> Evaluation:
    """Whitened by the noise of `observations`, which need not be that of the fit."""
    if observations.noise is fitted.noise:
        return fitted.evaluation
    return evaluate(weighed(fitted.model, fitted.laxity, observations.noise), fitted.theta)


def _explained(observations: Observations, before: Array, after: Array) -> dict[str, float]:
    shares = {}
    for i in np.unique(observations.coordinate):
        own = observations.coordinate == i
        left, whole = (np.sum((x[own] / observations.sd[own]) ** 2) for x in (after, before))
        shares[COORDINATES[i]] = float(1.0 - left / whole) if whole > 0 else 0.0
    return shares


def _parameter_changes(
    before: Fitted, after: Fitted, old: Laplace, new: Laplace
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


def _force_change(before: Fitted, after: Fitted) -> ForceChange:
    extreme = np.flatnonzero(extreme_trials(before.laxity.protocol))
    forces = []
    for fitted in (before, after):
        model = fitted.compared.model
        forces.append(tensions_of(model, model.predict_once(fitted.theta))[extreme])
    return ForceChange(
        trials=tuple(before.laxity.protocol.trials[i] for i in extreme),
        ligaments=tuple(x.name for x in before.model.knee.ligaments),
        before=forces[0],
        after=forces[1],
    )
