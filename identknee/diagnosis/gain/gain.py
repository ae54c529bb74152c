"""What a named cause gains: misfit, prediction of held trials, evidence, parameters, forces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.calibrate.evaluation import Evaluation, evaluate
from identknee.diagnosis.explanations.fitting import Fitted, weighed
from identknee.diagnosis.gain.discrepancy import Discrepancy, fit_discrepancy
from identknee.diagnosis.gain.folds import (
    Fold,
    Observations,
    Rmse,
    extreme_trials,
    held_out_folds,
    observations_of,
)
from identknee.diagnosis.gain.held_out import FoldScore, HeldOut, held_out
from identknee.diagnosis.score.misfit import Check, base_projector, omnibus_check
from identknee.identify.laplace import Interval, Laplace, laplace
from identknee.laxity.table import COORDINATES
from identknee.model.tensions import tensions_of
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_PARAMETER, array, declared, entry

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
    families: tuple[FamilyDifference, ...] = entry("The same for each family of folds")

    @property
    def folds(self) -> tuple[Fold, ...]:
        """All folds that count."""
        return tuple(fold for x in self.families for fold in x.folds)


def elpd_difference(before: HeldOut, after: HeldOut) -> ElpdDifference:
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
    covariance = observations.noise.covariance[np.ix_(held, held)]
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
    """How well one model does."""

    check: Check = entry(
        "Chi-square of data and priors together, its degrees of freedom and its probability"
    )
    errors: Array = array("Measured less predicted values", "value", unit="mm or deg")
    in_sample: Rmse = entry("Their root mean squares")
    held_out: HeldOut = entry("Prediction of trials it was not fitted to")
    posterior: Laplace = entry("Intervals of its parameters and its evidence")


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
    elpd_absorbed: ElpdDifference = entry("The same of the process less the base model")
    explained: dict[str, float] = entry(
        "Share of the mean square of each measured coordinate that the cause removes; negative "
        "where it adds"
    )
    parameters: tuple[ParameterChange, ...] = entry("Those of both models")
    forces: ForceChange = entry("Ligament forces under the largest loads")

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
    absorbed = _assess(before, discrepancy.observations, folds, noise_degrees)
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
