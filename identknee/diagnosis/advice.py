"""Which trials to add so that explanations that fit alike come apart."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identknee.diagnosis.attribution import Attribution
from identknee.diagnosis.data_noise import DataNoise
from identknee.diagnosis.isolability import Pair
from identknee.diagnosis.noise_model import build_noise_model
from identknee.diagnosis.offered_trials import OfferedTrials, Rows
from identknee.diagnosis.refit import Refit
from identknee.diagnosis.rivals import Rival
from identknee.laxity.candidates import candidate_trials
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.model.effects.library import NEEDS_ORDER, NEEDS_PHASE
from identknee.runs.arrays import Array

# Rivals beyond these follow from the nearest ones.
MOST_RIVALS = 6
# In units of noise: where explanations that fit alike differ by more in a single value, one of the
# knees snaps, and whether it does hangs on parameters that hardly differ.
MOST_DIFFERENCE = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Advice:
    """Trials to add, and what they would do.

    Attributes
    ----------
    trials
        The protocol to add, the most useful first.
    rivals
        Names of the causes of each rival.
    before, after
        Distance of each rival in units of noise without and with these trials, see
        `identknee.diagnosis.refit.expected_distance`.
    """

    trials: Protocol
    rivals: tuple[tuple[str, ...], ...]
    before: Array
    after: Array

    @property
    def sentence(self) -> str:
        """What they would do, for a person."""
        trials = ", ".join(self.trials.trials)
        least = float(self.after.min())
        return (
            f"Adding {trials} would set the nearest rival {least:.1f} units of noise apart "
            f"instead of {float(self.before.min()):.1f}; 5 are enough."
        )


def advise(attribution: Attribution, laxity: Laxity, noise: DataNoise) -> Advice | None:
    """The trials that separate the best explanation from its open rivals; None without any.

    Causes that depend on the order of the trials are left out: no choice of loads tells them apart.

    Trials of the data may be advised once more. Each is taken to be measured as those made were.

    Parameters
    ----------
    attribution
        The explanations.
    laxity, noise
        The data and their errors.
    """
    best = attribution.best
    rivals = [x for x in attribution.open_rivals if not _depends_on_order(x.refit)][:MOST_RIVALS]
    if not rivals or _depends_on_order(best):
        return None
    offer = OfferedTrials(
        laxity=replace(laxity, sd=noise.sd, within_trial_correlation=noise.correlation),
        noise=build_noise_model(noise.sd, laxity.is_measured, correlation=noise.correlation),
        candidates=candidate_trials(laxity.protocol),
    )
    rows, pairs = _table(best, rivals, offer)
    trials, found = offer.advise(rows, pairs, best.fitted, n_base=best.n_base)
    return Advice(
        trials=trials,
        rivals=tuple(x.refit.names for x in rivals),
        before=found.distances[0],
        after=found.distances[-1],
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
        snaps = (np.abs(differences) > MOST_DIFFERENCE).any(axis=1)
        differences[snaps] = np.nan
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
