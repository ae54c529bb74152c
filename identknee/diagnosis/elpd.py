"""Which of two models predicts held trials better, and by how much."""

from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.folds import Fold
from identknee.diagnosis.held_out import FoldScore, HeldOut
from identknee.diagnosis.observations import Observations
from identknee.runs.arrays import Array

# Squared distance of two predictions in units of the noise below which they are the same.
LEAST_SIGNATURE = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FamilyDifference:
    """The difference in log predictive density over one family of folds.

    Attributes
    ----------
    family
        Of the folds.
    difference, se
        Sum over the held trials of the second model's log density less the first's, and its
        standard error over trials; 0 and NaN where no fold counts.
    folds
        Folds that count.
    without_signature
        Folds in which both models predict the same, so that they say nothing of their difference.
    not_scored
        Folds that one of both models could not predict, with the reason.
    """

    family: str
    difference: float
    se: float
    folds: tuple[Fold, ...]
    without_signature: tuple[Fold, ...]
    not_scored: tuple[tuple[Fold, str], ...]

    @property
    def is_gain(self) -> bool:
        """Whether the second model is better by more than two standard errors."""
        return bool(self.difference > 2.0 * self.se)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ElpdDifference:
    """The difference in log predictive density of held trials: after less before.

    Attributes
    ----------
    difference, se
        Over all trials, each averaged over the folds that hold it out, and its standard error;
        0 and NaN where no fold counts.
    families
        The same for each family of folds.
    """

    difference: float
    se: float
    families: tuple[FamilyDifference, ...]

    @property
    def folds(self) -> tuple[Fold, ...]:
        """All folds that count."""
        return tuple(fold for x in self.families for fold in x.folds)

    @property
    def n_gains(self) -> int:
        """Families in which the second model is better by more than two standard errors."""
        return sum(x.is_gain for x in self.families)

    @property
    def n_with_signature(self) -> int:
        """Families in which the models differ at all."""
        return sum(bool(x.folds) for x in self.families)


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
