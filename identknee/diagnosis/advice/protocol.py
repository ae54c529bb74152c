"""What a protocol can tell before anything is measured: which causes, and which from which."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from identknee.diagnosis.advice.advice import OfferedTrials, Rows
from identknee.diagnosis.advice.isolability import (
    LEAST_DISTANCE,
    Distances,
    Pair,
    groups,
    visible_root,
    worst_distances,
)
from identknee.diagnosis.explanations.candidates import (
    UNSEEN,
    Candidates,
    Variant,
    Visibility,
    half_way,
    library_candidates,
)
from identknee.diagnosis.explanations.fitting import (
    Fitted,
    base_model,
    fit_from,
    fitted_with_nuisances,
    plain_noise,
)
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.model.candidate_laxity import offered_trials
from identknee.model.effects.effect import Effect
from identknee.model.effects.library import library
from identknee.model.effects.stored import values_of
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.subject.knee import Knee

# How far each effect is taken to stand out of the noise, as the root of its chi-square.
ROOT = 8.0
# With shifts of all insertions this effect imitates a little of every other one: it would join all
# groups into one.
IMITATOR = "insertion"


@declared
class GroupAdvice:
    """Trials that would separate effects that the protocol cannot tell apart."""

    names: tuple[str, ...] = entry("The effects")
    trials: Protocol = entry("To add, the most useful first")
    before: float = entry(
        "Least distance within the group without them, see `identknee.diagnosis.advice.isolability`"
    )
    after: float = entry("The same with them")


@declared
class ProtocolIsolability:
    """What a protocol can and cannot tell."""

    protocol: Protocol = entry("The trials that have a prediction")
    visibility: tuple[Visibility, ...] = entry(
        "Size that would be seen, for every effect of the library"
    )
    distances: Distances = entry(
        "How far the effects are from one another, each as far out of the noise as `ROOT`"
    )
    advice: tuple[GroupAdvice, ...] = entry(
        "For each group of effects that cannot be told apart. Errors of the insertions are in no "
        "group, since they imitate a little of everything"
    )
    look_alikes: dict[str, tuple[str, ...]] = entry(
        "The effects that each cannot be told from, the closest first"
    )

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The effects that cannot be told apart."""
        return tuple(x.names for x in self.advice)


def protocol_isolability(
    knee: Knee, protocol: Protocol, *, sd_mm: float, sd_deg: float, seed: int = 0
) -> ProtocolIsolability | None:
    """What a protocol can tell on a subject with its own values; None where no trial is predicted.

    Each structure that may be there is where anatomy puts it, but a rival may be a few millimetres
    away from there. Trials without a prediction are left out.

    Parameters
    ----------
    knee, protocol
        The subject and the trials.
    sd_mm, sd_deg
        Standard deviation of the errors, > 0.
    seed
        Seed of the distributions under no effect.
    """
    told = _told(knee, protocol, np.array([sd_mm] * 3 + [sd_deg] * 2), seed)
    if told is None:
        return None
    fitted, candidates, variants = told.fitted, told.candidates, told.variants
    return ProtocolIsolability(
        protocol=fitted.laxity.protocol,
        visibility=tuple(candidates.visibility(x.effect) for x in variants),
        distances=told.apart,
        advice=tuple(
            _advise(fitted, candidates, [x for x in variants if x.effect.name in names])
            for names in told.groups
            if len(names) > 1
        ),
        look_alikes=_look_alikes(told.apart),
    )


def protocol_groups(
    knee: Knee, protocol: Protocol, *, sd_mm: float, sd_deg: float, seed: int = 0
) -> tuple[tuple[str, ...], ...]:
    """The effects in groups that the protocol cannot tell apart, without advice on trials.

    Parameters as in `protocol_isolability`; empty where no trial is predicted.
    """
    told = _told(knee, protocol, np.array([sd_mm] * 3 + [sd_deg] * 2), seed)
    return () if told is None else told.groups


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Told:
    """What the subject's own values tell: the fit, its candidates and how far they are apart."""

    fitted: Fitted
    candidates: Candidates
    variants: tuple[Variant, ...]
    apart: Distances

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        return groups(_among(self.apart, [x for x in self.apart.effects if x != IMITATOR]))


def _told(knee: Knee, protocol: Protocol, sd: Array, seed: int) -> _Told | None:
    fitted = _own_fit(knee, protocol, sd)
    if fitted is None:
        return None
    present = {x.name for x in fitted.model.effects}
    tried = [x for x in library(knee) if x.name not in present]
    candidates = library_candidates(fitted, tried, seed=seed)
    typical = [candidates.typical(x.name) for x in tried]
    variants = tuple(x for x in typical if x is not None)
    projected = [candidates.projected(x) for x in variants]
    apart = worst_distances(projected, ROOT, candidates.test.signatures)
    return _Told(fitted=fitted, candidates=candidates, variants=variants, apart=apart)


def _own_fit(knee: Knee, protocol: Protocol, sd: Array) -> Fitted | None:
    """The base model at the subject's own values, as if fitted to its own prediction."""
    model = base_model(knee, protocol)
    theta = model.parameters.vector(values_of(knee))
    predicted = model.predict(theta, derivatives=False).is_converged
    if not predicted.any():
        return None
    model = model.with_protocol(protocol.select(np.flatnonzero(predicted)))
    coordinates = model.predict_once(theta).coordinates
    sds = np.broadcast_to(sd, coordinates.shape)
    laxity = Laxity(protocol=model.protocol, coordinates=coordinates, sd=sds)
    plain = fit_from(model, laxity, plain_noise(laxity), [theta])
    return fitted_with_nuisances(plain, sds, laxity.within_trial_correlation)


def _among(apart: Distances, names: Sequence[str]) -> Distances:
    """The distances of these effects from one another."""
    rows = [apart.effects.index(x) for x in names]
    columns = [apart.rivals.index(x) for x in names]
    values = apart.values[np.ix_(rows, columns)]
    return Distances(effects=tuple(names), rivals=tuple(names), values=values)


def _look_alikes(apart: Distances) -> dict[str, tuple[str, ...]]:
    square = _among(apart, apart.effects)
    least = np.minimum(square.values, square.values.T)
    near = {}
    for row, name in enumerate(square.effects):
        order = [k for k in np.argsort(least[row], kind="stable") if k != row]
        near[name] = tuple(square.effects[k] for k in order if least[row, k] < LEAST_DISTANCE)
    return near


def _advise(fitted: Fitted, candidates: Candidates, members: Sequence[Variant]) -> GroupAdvice:
    """The trials that set the members of a group apart, each from the others where most alike."""
    confused = [
        (one, _most_alike(candidates, one, other.effect)) for one, other in permutations(members, 2)
    ]
    variants = list({id(x): x for x in [*members, *(rival for _, rival in confused)]}.values())
    laxity = fitted.laxity
    offer = OfferedTrials(laxity=laxity, candidates=offered_trials(fitted.model, laxity.protocol))
    trials, found, _ = offer.advise(
        _rows(fitted, variants, offer),
        _pairs(fitted, candidates, variants, confused),
        fitted,
        n_base=fitted.model.parameters.n,
    )
    return GroupAdvice(
        names=tuple(x.effect.name for x in members),
        trials=trials,
        before=float(found.distances[0].min()),
        after=float(found.distances[-1].min()),
    )


def _rows(fitted: Fitted, variants: Sequence[Variant], offer: OfferedTrials) -> Rows:
    """Derivatives by the base parameters, then by the amplitudes of each effect, side by side."""
    model, theta = fitted.model, fitted.theta
    _, slopes = offer.predict(model, theta)
    blocks = [slopes]
    for variant in variants:
        extended = model.with_effects([*model.effects, variant.effect])
        p = variant.effect.parameters
        _, slopes = offer.predict(extended, np.r_[theta, variant.values])
        size = np.linalg.norm(slopes.made[:, theta.size :], axis=0) * p.prior_sd
        if not (size > UNSEEN).any():
            values = half_way(variant.effect, variant.values)
            _, slopes = offer.predict(extended, np.r_[theta, values])
        moved = theta.size + variant.moved
        blocks.append(Rows(made=slopes.made[:, moved], offered=slopes.offered[:, :, moved]))
    return Rows(
        made=np.concatenate([x.made for x in blocks], axis=1),
        offered=np.concatenate([x.offered for x in blocks], axis=2),
    )


def _most_alike(candidates: Candidates, effect: Variant, rival: Effect) -> Variant:
    """The variant of a rival that is hardest to tell from an effect."""
    rivals = [x for x in candidates.variants if x.effect is rival]
    seen = [candidates.projected(effect)]
    values = [worst_distances(seen, ROOT, [candidates.projected(x)]).values[0, 0] for x in rivals]
    return rivals[int(np.argmin(values))]


def _pairs(
    fitted: Fitted,
    candidates: Candidates,
    variants: Sequence[Variant],
    confused: Sequence[tuple[Variant, Variant]],
) -> list[Pair]:
    """Each effect against its rival, at a leading amplitude that stands out by `ROOT`."""
    ends = fitted.model.parameters.n + np.cumsum([len(x.moved) for x in variants])
    places = {
        id(x): np.arange(end - len(x.moved), end) for end, x in zip(ends, variants, strict=True)
    }
    pairs = []
    for one, other in confused:
        amplitude = np.zeros(len(one.moved))
        amplitude[0] = 1.0
        amplitude[0] = ROOT / visible_root(candidates.projected(one), amplitude)
        pairs.append(
            Pair(
                effect=places[id(one)],
                amplitude=amplitude,
                rival=places[id(other)],
                rival_prior_sd=other.signature.prior_sd,
            )
        )
    return pairs
