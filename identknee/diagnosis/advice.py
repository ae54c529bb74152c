"""Which trials to add so that explanations that fit alike come apart."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from identknee.diagnosis.attribution import Attribution, Rival
from identknee.diagnosis.data_noise import DataNoise
from identknee.diagnosis.isolability import Pair, advise_trials
from identknee.diagnosis.refit import Refit
from identknee.laxity.candidates import candidate_trials, repeated
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.model.candidate_laxity import CandidateLaxity, typical_errors
from identknee.model.effects.library import NEEDS_ORDER, NEEDS_PHASE
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array

# Rivals beyond these follow from the nearest ones.
MOST_RIVALS = 6


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
    candidates = candidate_trials(laxity.protocol)
    data = replace(laxity, sd=noise.sd, within_trial_correlation=noise.correlation)
    made, pairs = _table(best, rivals, partial(_in_data, best))
    offered, _ = _table(best, rivals, partial(_in_candidates, data, candidates))
    prior = best.fitted.evaluation.jacobian[best.fitted.n_data :, : best.n_base]
    padded = np.pad(prior, ((0, 0), (0, made.shape[1] - best.n_base)))
    found = advise_trials(np.vstack([made, padded]), offered, pairs, n_base=best.n_base)
    chosen = [candidates.trials[i] for i in found.chosen]
    trials = Protocol(
        name="advised",
        trials=repeated(chosen, laxity.protocol.trials),
        flexion_deg=candidates.flexion_deg[list(found.chosen)],
        loads=candidates.loads[list(found.chosen)],
    )
    return Advice(
        trials=trials,
        rivals=tuple(x.refit.names for x in rivals),
        before=found.distances[0],
        after=found.distances[-1],
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Predicted:
    """Whitened predictions of a refit in some trials, and their derivatives."""

    values: Array
    jacobian: Array


def _depends_on_order(explanation: Refit) -> bool:
    """Whether it says what trials yield by when they are made, which nobody knows beforehand."""
    return any(x in NEEDS_ORDER | NEEDS_PHASE for x in explanation.names)


Predict = Callable[[LaxityModel, Array], _Predicted]


def _in_data(best: Refit, model: LaxityModel, theta: Array) -> _Predicted:
    """In the trials of the data, shapes ``(m,)`` and ``(m, p)``."""
    compared = LaxityResiduals(model=model, laxity=best.fitted.laxity)
    noise = best.fitted.noise
    return _Predicted(
        values=noise.whiten(compared.residuals(theta)),
        jacobian=noise.whiten(compared.jacobian(theta)),
    )


def _in_candidates(
    data: Laxity, candidates: Protocol, model: LaxityModel, theta: Array
) -> _Predicted:
    """In trials that might be added, shapes ``(n, r)`` and ``(n, r, p)``."""
    offered = CandidateLaxity(
        model=model,
        laxity=data,
        protocol=candidates,
        sd=typical_errors(data),
        free=tuple(range(model.parameters.n)),
        at=theta,
    )
    values, jacobian = offered.predict(theta, range(candidates.n))
    return _Predicted(values=values, jacobian=jacobian)


def _table(best: Refit, rivals: Sequence[Rival], predict: Predict) -> tuple[Array, list[Pair]]:
    """Columns of the base parameters, of differences and of the rivals' causes, and the pairs.

    The difference between the predictions of the best explanation and of a rival is one column,
    with amplitude 1, and is to be told from any change of the rival's amplitudes.
    """
    n_base = best.n_base
    whole = predict(best.fitted.model, best.fitted.theta)
    blocks, pairs = [whole.jacobian[..., :n_base]], []
    place = n_base
    for rival in rivals:
        other = predict(rival.refit.fitted.model, rival.refit.fitted.theta)
        own = other.jacobian[..., n_base:]
        blocks += [(whole.values - other.values)[..., None], own]
        pairs.append(
            Pair(
                effect=np.array([place]),
                amplitude=np.ones(1),
                rival=np.arange(place + 1, place + 1 + own.shape[-1]),
                rival_prior_sd=rival.refit.fitted.model.parameters.prior_sd[n_base:],
            )
        )
        place += 1 + own.shape[-1]
    return np.concatenate(blocks, axis=-1), pairs
