"""Trials made and trials that might be added, in the same units and with the same nuisances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.base_fit import Fitted, nuisance_changes
from identknee.diagnosis.isolability import AdvisedTrials, Pair, advise_trials
from identknee.diagnosis.noise_model import NoiseModel
from identknee.laxity.candidates import repeated
from identknee.laxity.protocol import Protocol, concatenate
from identknee.laxity.table import Laxity
from identknee.model.candidate_laxity import CandidateLaxity, typical_errors
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Predictions in units of the noise of the m values made and the r values of n offered trials.

    Attributes
    ----------
    made, offered
        Shapes ``(m, ...)`` and ``(n, r, ...)``; NaN in offered trials without a prediction.
    """

    made: Array
    offered: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OfferedTrials:
    """The trials of data, and others to choose from.

    Attributes
    ----------
    laxity
        The data with their errors.
    noise
        Those errors, without nuisances.
    candidates
        The trials to choose from, each measured as those made were.
    """

    laxity: Laxity
    noise: NoiseModel
    candidates: Protocol

    def predict(self, model: LaxityModel, theta: Array) -> tuple[Rows, Rows]:
        """What a model predicts less what was measured, and its derivatives by theta."""
        compared = LaxityResiduals(model=model, laxity=self.laxity)
        values, jacobian = self._choice(model, theta).predict(theta, range(self.candidates.n))
        return (
            Rows(made=self.noise.whiten(compared.residuals(theta)), offered=values),
            Rows(made=self.noise.whiten(compared.jacobian(theta)), offered=jacobian),
        )

    def nuisances(self, fitted: Fitted) -> Rows:
        """What nuisances change, for one prior standard deviation of each in the last dimension."""
        choice = self._choice(fitted.model, fitted.theta)
        # One that is made and offered is there once.
        whole = concatenate([self.laxity.protocol, choice.trials], name="made and offered")
        changes, spreads = nuisance_changes(fitted.model.with_protocol(whole), fitted.theta)
        offered = [whole.trials.index(x) for x in choice.trials.trials]
        return Rows(
            made=self.noise.whiten(fitted.compared.rows(changes[: self.laxity.n] * spreads)),
            offered=choice.rows(changes[offered] * spreads),
        )

    def advise(
        self, rows: Rows, pairs: Sequence[Pair], fitted: Fitted, *, n_base: int
    ) -> tuple[Protocol, AdvisedTrials]:
        """The trials that separate pairs most, under a fit's prior and nuisances.

        Parameters
        ----------
        rows
            Columns of `n_base` base parameters, then of the effects in `pairs`.
        pairs
            What to tell apart, see `identknee.diagnosis.isolability.advise_trials`.
        fitted
            The fit.
        n_base
            How many base parameters there are.
        """
        nuisances = self.nuisances(fitted)
        n = nuisances.made.shape[1]
        prior = fitted.evaluation.jacobian[fitted.n_data :, :n_base]
        of_base = np.pad(prior, ((0, 0), (0, rows.made.shape[1] - n_base + n)))
        found = advise_trials(
            np.vstack([np.hstack([rows.made, nuisances.made]), of_base]),
            np.concatenate([rows.offered, nuisances.offered], axis=2),
            pairs,
            n_base=n_base,
            n_nuisances=n,
        )
        # A trial may come several times.
        chosen, offered = list(found.chosen), self.candidates
        advised = Protocol(
            name="advised",
            trials=repeated([offered.trials[i] for i in chosen], self.laxity.protocol.trials),
            flexion_deg=offered.flexion_deg[chosen],
            loads=offered.loads[chosen],
        )
        return advised, found

    def _choice(self, model: LaxityModel, theta: Array) -> CandidateLaxity:
        return CandidateLaxity(
            model=model,
            laxity=self.laxity,
            protocol=self.candidates,
            sd=typical_errors(self.laxity),
            free=model.parameters.with_fixed((), theta),
        )
