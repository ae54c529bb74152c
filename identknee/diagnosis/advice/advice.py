"""Which trials to add so that explanations that fit alike come apart."""

from collections.abc import Mapping, Sequence

import numpy as np

from identknee.diagnosis.advice.isolability import (
    AdvisedTrials,
    Pair,
    advise_trials,
    pair_distances,
)
from identknee.diagnosis.explanations.fitting import Fitted, plain_noise
from identknee.diagnosis.explanations.refit import Refit, Rival
from identknee.identify.design.better_known import SHARE
from identknee.identify.nuisances import nuisance_places
from identknee.laxity.candidates import repeated
from identknee.laxity.protocol import Protocol, concatenate
from identknee.laxity.table import Laxity
from identknee.model.candidate_laxity import CandidateLaxity, offered_trials, typical_errors
from identknee.model.effects.library import NEEDS_ORDER, NEEDS_PHASE
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.model.shared_errors import nuisance_changes
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry

# Rivals beyond these follow from the nearest ones.
MOST_RIVALS = 6
# In units of noise: where explanations that fit alike differ by more in a single value, one of the
# knees jumps, and whether it does depends on parameters that hardly differ.
MOST_DIFFERENCE = 10.0


@declared
class Rows:
    """Predictions, in units of noise, of the m values made and of n offered trials with r each."""

    made: Array = entry("Predictions of the values made, shape ``(m, ...)``")
    offered: Array = entry(
        "Those of the values of the offered trials, shape ``(n, r, ...)``; NaN without a prediction"
    )


@declared
class OfferedTrials:
    """The trials of data, and others to choose from."""

    laxity: Laxity = entry("The data with their errors")
    candidates: Protocol = entry("The trials to choose from, each measured as those made were")

    def predict(self, model: LaxityModel, theta: Array) -> tuple[Rows, Rows]:
        """What a model predicts less what was measured, and its derivatives by theta."""
        compared = LaxityResiduals(model=model, laxity=self.laxity)
        values, jacobian = self._choice(model, theta).predict(theta, range(self.candidates.n))
        noise = plain_noise(self.laxity)
        return (
            Rows(made=noise.whiten(compared.residuals(theta)), offered=values),
            Rows(made=noise.whiten(compared.jacobian(theta)), offered=jacobian),
        )

    def nuisances(self, fitted: Fitted) -> Rows:
        """What nuisances change, for one prior standard deviation of each in the last dimension."""
        choice = self._choice(fitted.model, fitted.theta)
        # One that is made and offered is there once.
        whole = concatenate([self.laxity.protocol, choice.trials], name="made and offered")
        changes, spreads = nuisance_changes(choice.model.with_protocol(whole), fitted.theta)
        offered = [whole.trials.index(x) for x in choice.trials.trials]
        return Rows(
            made=plain_noise(self.laxity).whiten(
                fitted.compared.rows(changes[: self.laxity.n] * spreads)
            ),
            offered=choice.rows(changes[offered] * spreads),
        )

    def advise(
        self,
        rows: Rows,
        pairs: Sequence[Pair],
        fitted: Fitted,
        *,
        n_base: int,
        measured: Sequence[Array] = (),
    ) -> tuple[Protocol, AdvisedTrials, Array]:
        """The trials that separate pairs most, under a fit's prior and nuisances.

        Parameters
        ----------
        rows
            Columns of `n_base` base parameters, then of the effects in `pairs`.
        pairs
            What to tell apart, see `identknee.diagnosis.advice.isolability.advise_trials`.
        fitted
            The fit.
        n_base
            How many base parameters there are.
        measured
            Rows of other measurements, shape ``(k, q)`` each, whose distances are wanted too.

        Returns
        -------
        trials, found
            The trials, and what they bring.
        others
            Distance of each pair with each other measurement alone, ``(len(measured), n_pairs)``.
        """
        nuisances = self.nuisances(fitted)
        n = nuisances.made.shape[1]
        prior = fitted.evaluation.jacobian[fitted.n_data :, :n_base]
        of_base = np.pad(prior, ((0, 0), (0, rows.made.shape[1] - n_base + n)))
        made = np.vstack([np.hstack([rows.made, nuisances.made]), of_base])
        others = [
            pair_distances(
                np.vstack([made, np.pad(x, ((0, 0), (0, n)))]), pairs, n_base=n_base, n_nuisances=n
            )
            for x in measured
        ]
        found = advise_trials(
            made,
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
        return advised, found, np.array(others).reshape(-1, len(pairs))

    def _choice(self, model: LaxityModel, theta: Array) -> CandidateLaxity:
        choice = CandidateLaxity(
            model=model,
            laxity=self.laxity,
            protocol=self.candidates,
            sd=typical_errors(self.laxity),
            free=model.parameters.with_fixed((), theta),
        )
        return choice.begun_at(theta)


@declared
class Advice:
    """Trials to add, and what they would do."""

    trials: Protocol = entry("The protocol to add, the most useful first")
    rivals: tuple[tuple[str, ...], ...] = entry("Names of the causes of each rival")
    before: Array = entry(
        "Distance of each rival in units of noise without these trials, see "
        "`identknee.diagnosis.explanations.refit.expected_distance`"
    )
    after: Array = entry("The same with these trials")
    with_one_trial: Array = entry("The same with the first of these trials alone")
    with_error_halved: Mapping[str, tuple[float, ...]] = entry(
        "The same, without any trial, with one stated error known twice as well, by its name"
    )

    @property
    def sentence(self) -> str:
        """What they would do, for a person."""
        n = self.trials.n
        which = "this trial" if n == 1 else f"these {n} trials"
        return (
            f"With {which} the nearest rival would be {float(self.after.min()):.1f} units of noise "
            f"away instead of {float(self.before.min()):.1f}; 5 are enough to tell it apart."
        )


def advise(best: Refit, rivals: Sequence[Rival], laxity: Laxity) -> Advice | None:
    """The trials that separate the best explanation from its open rivals.

    None without any, and where the model has no equilibrium in the trials that could be added.

    Causes that depend on the order of the trials are left out: no choice of loads tells them apart.

    Trials of the data may be advised once more. Each is taken to be measured as those made were.

    Parameters
    ----------
    best
        The best explanation.
    rivals
        Those that the data leave open, the most likely first.
    laxity
        The data with the errors found in them.
    """
    rivals = [x for x in rivals if not _depends_on_order(x.refit)][:MOST_RIVALS]
    if not rivals or _depends_on_order(best):
        return None
    offer = OfferedTrials(
        laxity=laxity, candidates=offered_trials(best.fitted.model, laxity.protocol)
    )
    rows, pairs = _table(best, rivals, offer)
    measured = measured_errors(best, rivals, pairs, rows.made.shape[1])
    trials, found, others = offer.advise(
        rows, pairs, best.fitted, n_base=best.n_base, measured=list(measured.values())
    )
    if not (found.chosen and np.isfinite(found.distances[0]).all()):
        return None
    return Advice(
        trials=trials,
        rivals=tuple(x.refit.names for x in rivals),
        before=found.distances[0],
        after=found.distances[-1],
        with_one_trial=found.distances[min(1, len(found.chosen))],
        with_error_halved={k: tuple(x) for k, x in zip(measured, others.tolist(), strict=True)},
    )


def _depends_on_order(explanation: Refit) -> bool:
    """Whether it says what trials yield by when they are made, which nobody knows beforehand."""
    return any(x in NEEDS_ORDER | NEEDS_PHASE for x in explanation.names)


def _table(best: Refit, rivals: Sequence[Rival], offer: OfferedTrials) -> tuple[Rows, list[Pair]]:
    """Columns of the base parameters, of differences and of the rivals' causes, and the pairs.

    The difference between the predictions of the best explanation and of a rival is one column,
    with amplitude 1, and is to be told from any change of the rival's amplitudes.
    """
    n_base = best.n_base
    whole, slopes = offer.predict(best.fitted.model, best.fitted.theta)
    made, offered = [slopes.made[:, :n_base]], [slopes.offered[:, :, :n_base]]
    pairs = []
    place = n_base
    for rival in rivals:
        other = rival.refit.fitted
        values, own = offer.predict(other.model, other.theta)
        made += [(whole.made - values.made)[:, None], own.made[:, n_base:]]
        differences = whole.offered - values.offered
        jumps = (np.abs(differences) > MOST_DIFFERENCE).any(axis=1)
        differences[jumps] = np.nan
        offered += [differences[:, :, None], own.offered[:, :, n_base:]]
        end = place + 1 + other.model.parameters.n - n_base
        pairs.append(
            Pair(
                effect=np.array([place]),
                amplitude=np.ones(1),
                rival=np.arange(place + 1, end),
                rival_prior_sd=other.model.parameters.prior_sd[n_base:],
            )
        )
        place = end
    return Rows(made=np.hstack(made), offered=np.concatenate(offered, axis=2)), pairs


def measured_errors(
    best: Refit, rivals: Sequence[Rival], pairs: Sequence[Pair], n_columns: int
) -> dict[str, Array]:
    """Each stated error measured so well that its prior narrows to half, as rows of data.

    Explanations that fit alike may hold such an error to be different; then its measurement speaks
    for one of them, beside what the base parameters can no longer take on themselves.

    Parameters
    ----------
    best, rivals
        The explanations.
    pairs
        Where the difference between them is a column, one a rival.
    n_columns
        Columns of the table, those of the base parameters first.

    Returns
    -------
    measured
        By the name of the error, rows in units of their noise, shape ``(k, n_columns)``.
    """
    parameters = best.fitted.model.parameters
    made = {}
    for name, places in nuisance_places(parameters).items():
        per_unit = np.sqrt(SHARE**-2 - 1.0) / parameters.prior_sd[places]
        rows = np.zeros((len(places), n_columns))
        rows[np.arange(len(places)), places] = per_unit
        for rival, pair in zip(rivals, pairs, strict=True):
            apart = best.fitted.theta[places] - rival.refit.fitted.theta[places]
            rows[:, pair.effect[0]] = per_unit * apart
        made[name] = rows
    return made
