"""What a protocol can tell before anything is measured: which causes, and which from which."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from identknee.diagnosis.base_fit import Fitted, fit_from, nuisances
from identknee.diagnosis.causes import unit_of
from identknee.diagnosis.exclusions import hardest, typical_variant
from identknee.diagnosis.isolability import (
    LEAST_DISTANCE,
    Distances,
    Pair,
    groups,
    visible_root,
    worst_distances,
)
from identknee.diagnosis.library_signatures import UNSEEN, Variant, half_way, library_variants
from identknee.diagnosis.noise_model import NoiseModel, build_noise_model
from identknee.diagnosis.offered_trials import OfferedTrials, Rows
from identknee.diagnosis.projection import base_projector
from identknee.diagnosis.score import ScoreTest, score_test
from identknee.diagnosis.signature import ProjectedSignature
from identknee.laxity.candidates import candidate_trials
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.model.effects.contact_law import contact_nuisance
from identknee.model.effects.facts import FACTS
from identknee.model.effects.library import library
from identknee.model.laxity_model import LaxityModel
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

# How far each effect is taken to stand out of the noise, as the root of its chi-square.
ROOT = 8.0
# With shifts of all insertions this effect imitates a little of every other one: it would join all
# groups into one.
IMITATOR = "insertion"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Visibility:
    """Which size of an effect the protocol would show.

    Attributes
    ----------
    name
        Of the effect.
    parameter, unit
        The amplitude: of those in the unit of the first, the hardest to see.
    detectable
        Its size that is found in nine of ten data sets; infinite where it never is.
    relevant
        The smallest size worth knowing.
    power
        How often that size is found.
    """

    name: str
    parameter: str
    unit: str
    detectable: float
    relevant: float
    power: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroupAdvice:
    """Trials that would separate effects that the protocol cannot tell apart.

    Attributes
    ----------
    names
        The effects.
    trials
        To add, the most useful first.
    before, after
        The least distance within the group without and with them, see
        `identknee.diagnosis.isolability`.
    """

    names: tuple[str, ...]
    trials: Protocol
    before: float
    after: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProtocolIsolability:
    """What a protocol can and cannot tell.

    Attributes
    ----------
    protocol
        The trials that have a prediction.
    visibility
        Of every effect of the library.
    distances
        Of the effects from one another, each as far out of the noise as `ROOT`.
    advice
        For each group of effects that cannot be told apart. Errors of the insertions are in no
        group, since they imitate a little of everything.
    look_alikes
        Of each effect the others that it cannot be told from, the closest first.
    """

    protocol: Protocol
    visibility: tuple[Visibility, ...]
    distances: Distances
    advice: tuple[GroupAdvice, ...]
    look_alikes: dict[str, tuple[str, ...]]

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
        Of the distributions under no effect.
    """
    fitted = _own_fit(knee, protocol, np.array([sd_mm] * 3 + [sd_deg] * 2))
    if fitted is None:
        return None
    everything = library_variants(fitted, library(knee))
    variants = _typical_variants(everything)
    projector = base_projector(fitted.evaluation.jacobian)
    test = score_test(projector, [x.signature for x in everything], seed=seed, scale="unknown")
    found = worst_distances([_seen(test, x) for x in variants], ROOT, test.signatures)
    together = groups(_among(found, [x for x in found.effects if x != IMITATOR]))
    return ProtocolIsolability(
        protocol=fitted.laxity.protocol,
        visibility=tuple(_visibility(test, x) for x in variants),
        distances=found,
        advice=tuple(
            _advise(fitted, test, [x for x in variants if x.effect.name in names], everything)
            for names in together
            if len(names) > 1
        ),
        look_alikes=_look_alikes(found),
    )


def _own_fit(knee: Knee, protocol: Protocol, sd: Array) -> Fitted | None:
    """The base model at the subject's own values, as if fitted to its own prediction."""
    model = LaxityModel(knee=knee, protocol=protocol, effects=(contact_nuisance(),))
    theta = model.parameters.center
    predicted = model.predict(theta, derivatives=False).is_converged
    if not predicted.any():
        return None
    model = model.with_protocol(protocol.select(np.flatnonzero(predicted)))
    coordinates = model.predict_once(theta).coordinates
    sds = np.broadcast_to(sd, coordinates.shape)
    laxity = Laxity(protocol=model.protocol, coordinates=coordinates, sd=sds)
    columns, spreads = nuisances(fit_from(model, laxity, _plain_noise(laxity), [theta]))
    noise = build_noise_model(
        sds, laxity.is_measured, correlation=0.0, nuisance=columns, nuisance_sd=spreads
    )
    return fit_from(model, laxity, noise, [theta])


def _plain_noise(laxity: Laxity) -> NoiseModel:
    return build_noise_model(np.asarray(laxity.sd), laxity.is_measured, correlation=0.0)


def _typical_variants(found: Sequence[Variant]) -> list[Variant]:
    """One variant of each effect that has any."""
    names = [name for name in FACTS if any(x.effect.name == name for x in found)]
    return [typical_variant(x for x in found if x.effect.name == name) for name in names]


def _seen(test: ScoreTest, variant: Variant) -> ProjectedSignature:
    return test.signature(variant.signature.name, variant.signature.variant)


def _visibility(test: ScoreTest, variant: Variant) -> Visibility:
    relevant = FACTS[variant.effect.name].relevant
    name, detectable, power = hardest(test, variant, relevant)
    return Visibility(
        name=variant.effect.name,
        parameter=name.partition(".")[2],
        unit=unit_of(name),
        detectable=detectable,
        relevant=relevant,
        power=power,
    )


def _among(found: Distances, names: Sequence[str]) -> Distances:
    """The distances of these effects from one another."""
    rows = [found.effects.index(x) for x in names]
    columns = [found.rivals.index(x) for x in names]
    values = found.values[np.ix_(rows, columns)]
    return Distances(effects=tuple(names), rivals=tuple(names), values=values)


def _look_alikes(found: Distances) -> dict[str, tuple[str, ...]]:
    square = _among(found, found.effects)
    least = np.minimum(square.values, square.values.T)
    near = {}
    for row, name in enumerate(square.effects):
        order = [k for k in np.argsort(least[row], kind="stable") if k != row]
        near[name] = tuple(square.effects[k] for k in order if least[row, k] < LEAST_DISTANCE)
    return near


def _advise(
    fitted: Fitted, test: ScoreTest, members: Sequence[Variant], everything: Sequence[Variant]
) -> GroupAdvice:
    """The trials that set the members of a group apart, each from the others where most alike."""
    confused = [
        (one, _most_alike(test, one, [x for x in everything if x.effect is other.effect]))
        for one, other in permutations(members, 2)
    ]
    variants = list({id(x): x for x in [*members, *(rival for _, rival in confused)]}.values())
    offer = OfferedTrials(
        laxity=fitted.laxity,
        noise=_plain_noise(fitted.laxity),
        candidates=candidate_trials(fitted.laxity.protocol),
    )
    trials, found = offer.advise(
        _rows(fitted, variants, offer),
        _pairs(fitted, test, variants, confused),
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


def _most_alike(test: ScoreTest, effect: Variant, rivals: Sequence[Variant]) -> Variant:
    """The variant of a rival that is hardest to tell from an effect."""
    seen = [_seen(test, effect)]
    values = [worst_distances(seen, ROOT, [_seen(test, x)]).values[0, 0] for x in rivals]
    return rivals[int(np.argmin(values))]


def _pairs(
    fitted: Fitted,
    test: ScoreTest,
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
        amplitude[0] = ROOT / visible_root(_seen(test, one), amplitude)
        pairs.append(
            Pair(
                effect=places[id(one)],
                amplitude=amplitude,
                rival=places[id(other)],
                rival_prior_sd=other.signature.prior_sd,
            )
        )
    return pairs
