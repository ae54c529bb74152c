"""Which trials to add to distinguish explanations that fit equally well."""

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np

from identknee.diagnosis.candidates import (
    UNSEEN,
    CandidateCauses,
    Detectability,
    Variant,
    library_candidates,
    secant_amplitudes,
)
from identknee.diagnosis.fitting import (
    FittedModel,
    Refit,
    Rival,
    base_model,
    best_fit_from,
    fitted_with_nuisances,
    stated_noise,
)
from identknee.diagnosis.isolability import (
    AdvisedTrials,
    Distances,
    Pair,
    advise_trials,
    groups,
    least_favourable_distances,
    noncentrality_root,
    pair_distances,
)
from identknee.diagnosis.score import LEAST_DISTANCE
from identknee.identify.optimum import nuisance_places
from identknee.laxity.protocol import Protocol, concatenate, unique_names
from identknee.laxity.table import Laxity
from identknee.model.candidate_laxity import CandidateLaxity, offered_laxity, typical_errors
from identknee.model.effects.effect import Effect
from identknee.model.effects.library import NEEDS_ORDER, NEEDS_PHASE, library, values_of
from identknee.model.experiments import causes_in_experiments
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals, nuisance_changes
from identknee.runs.declare import Array, declared, entry
from identknee.runs.marginalise import with_error_measured
from identknee.subject.knee import Knee

# Rivals beyond these follow from the nearest ones.
MOST_RIVALS = 6
# In units of noise: explanations that fit alike but differ by more in a single value do so because
# a knee jumps, which depends on tiny differences of parameters.
MOST_DIFFERENCE = 10.0


@declared
class WhitenedRows:
    """Predictions, in units of noise, of the m values made and of n offered trials with r each."""

    made: Array = entry("Predictions of the values made, shape ``(m, ...)``")
    offered: Array = entry(
        "Those of the values of the offered trials, shape ``(n, r, ...)``; NaN without a prediction"
    )


@declared
class AdviceCandidates:
    """The trials of data, and others to choose from."""

    laxity: Laxity = entry("The data with their errors")
    candidates: Protocol = entry("The trials to choose from, each measured as those made were")

    def predict(self, model: LaxityModel, theta: Array) -> tuple[WhitenedRows, WhitenedRows]:
        """Predicted minus measured values, and their derivatives by theta."""
        compared = LaxityResiduals(model=model, laxity=self.laxity)
        values, jacobian = self._choice(model, theta).predict(theta, range(self.candidates.n))
        noise = stated_noise(self.laxity)
        return (
            WhitenedRows(made=noise.whiten(compared.residuals(theta)), offered=values),
            WhitenedRows(made=noise.whiten(compared.jacobian(theta)), offered=jacobian),
        )

    def nuisances(self, fitted: FittedModel) -> WhitenedRows:
        """What nuisances change, for one prior standard deviation of each in the last dimension."""
        choice = self._choice(fitted.model, fitted.theta)
        # A trial that is both made and offered appears once.
        whole = concatenate([self.laxity.protocol, choice.trials], name="made and offered")
        changes, spreads = nuisance_changes(choice.model.with_protocol(whole), fitted.theta)
        offered = [whole.trials.index(x) for x in choice.trials.trials]
        return WhitenedRows(
            made=stated_noise(self.laxity).whiten(
                fitted.compared.rows(changes[: self.laxity.n] * spreads)
            ),
            offered=choice.rows(changes[offered] * spreads),
        )

    def advise(
        self,
        rows: WhitenedRows,
        pairs: Sequence[Pair],
        fitted: FittedModel,
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
            What to distinguish, see `identknee.diagnosis.isolability.advise_trials`.
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
            trials=unique_names([offered.trials[i] for i in chosen], self.laxity.protocol.trials),
            flexion_deg=offered.flexion_deg[chosen],
            loads=offered.loads[chosen],
            state=tuple(offered.states[i] for i in chosen),
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
        return choice.with_start_poses(theta)


@declared
class Advice:
    """What the advised trials would do to distances, see `identknee.diagnosis.fitting`."""

    sentence: str = entry("What they would do")
    rivals: tuple[tuple[str, ...], ...] = entry("Names of the causes of each rival")
    distance_before: tuple[float, ...] = entry("Distance of each rival now, in units of noise")
    distance_after: tuple[float, ...] = entry("Distance of each rival with the trials")
    distance_with_one_trial: tuple[float, ...] = entry("Distance with the first trial alone")
    distance_with_error_halved: Mapping[str, tuple[float, ...]] = entry(
        "Distance with one stated error known twice as well, by its name"
    )


@declared
class AdvisedProtocol(Advice):
    """What the advised trials would do, and these."""

    trials: Protocol = entry("To add, the most useful first", is_in_json=False)


def advise(best: Refit, rivals: Sequence[Rival], laxity: Laxity) -> AdvisedProtocol | None:
    """The trials that separate the best explanation from its open rivals.

    None without any, and where the model has no equilibrium in the trials that could be added.

    Causes that depend on the order of the trials are left out: no choice of loads can
    distinguish them.

    Trials of the data may be advised once more. Each is taken to be measured as those made were.
    """
    rivals = [x for x in rivals if not _depends_on_order(x.refit)][:MOST_RIVALS]
    if not rivals or _depends_on_order(best):
        return None
    offer = AdviceCandidates(
        laxity=laxity, candidates=offered_laxity(best.fitted.model, laxity.protocol)
    )
    rows, pairs = _table(best, rivals, offer)
    measured = measured_errors(best, rivals, pairs, rows.made.shape[1])
    trials, found, others = offer.advise(
        rows, pairs, best.fitted, n_base=best.n_base, measured=list(measured.values())
    )
    if not (found.chosen and np.isfinite(found.distances[0]).all()):
        return None
    before, after, single = (
        tuple(found.distances[i].tolist()) for i in (0, -1, min(1, len(found.chosen)))
    )
    which = "this trial" if trials.n == 1 else f"these {trials.n} trials"
    return AdvisedProtocol(
        trials=trials,
        sentence=(
            f"With {which} the nearest rival would be {min(after):.1f} units of noise away instead "
            f"of {min(before):.1f}; 5 are enough to distinguish it."
        ),
        rivals=tuple(x.refit.names for x in rivals),
        distance_before=before,
        distance_after=after,
        distance_with_one_trial=single,
        distance_with_error_halved={
            k: tuple(x) for k, x in zip(measured, others.tolist(), strict=True)
        },
    )


def _depends_on_order(explanation: Refit) -> bool:
    return any(x in NEEDS_ORDER | NEEDS_PHASE for x in explanation.names)


def _table(
    best: Refit, rivals: Sequence[Rival], offer: AdviceCandidates
) -> tuple[WhitenedRows, list[Pair]]:
    """Columns of the base parameters, of differences and of the rivals' causes, and the pairs.

    The difference between the predictions of the best explanation and of a rival is one column,
    with amplitude 1, and is to be distinguished from any change of the rival's amplitudes.
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
    return WhitenedRows(made=np.hstack(made), offered=np.concatenate(offered, axis=2)), pairs


def measured_errors(
    best: Refit, rivals: Sequence[Rival], pairs: Sequence[Pair], n_columns: int
) -> dict[str, Array]:
    """Each stated error measured so well that its prior narrows to half, as rows of data.

    Explanations that fit alike may differ in such an error. Its measurement then favours one of
    them, and base parameters can compensate for less.

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
        rows = with_error_measured(n_columns, places, parameters.prior_sd[places])
        for rival, pair in zip(rivals, pairs, strict=True):
            apart = best.fitted.theta[places] - rival.refit.fitted.theta[places]
            rows[:, pair.effect[0]] = rows[:, places] @ apart
        made[name] = rows
    return made


# How far each effect is taken to stand out of the noise, as the root of its chi-square.
ROOT = 8.0
# With shifts of all insertions this effect imitates a little of every other one: it would join all
# groups into one.
IMITATOR = "insertion"


@declared
class GroupAdvice:
    """Trials that would separate effects that the protocol cannot distinguish."""

    names: tuple[str, ...] = entry("The effects")
    trials: Protocol = entry("To add, the most useful first")
    before: float = entry(
        "Least distance within the group without them, see `identknee.diagnosis.isolability`"
    )
    after: float = entry("Least distance within the group with them")


@declared
class ProtocolIsolability:
    """Isolability of the library's effects under a protocol."""

    protocol: Protocol = entry("The trials that have a prediction")
    visibility: tuple[Detectability, ...] = entry(
        "Size that would be seen, for every effect of the library"
    )
    distances: Distances = entry(
        "How far the effects are from one another, each as far out of the noise as `ROOT`"
    )
    advice: tuple[GroupAdvice, ...] = entry(
        "For each group of effects that cannot be distinguished. Errors of the insertions are in "
        "no group, since they imitate a little of everything"
    )
    look_alikes: dict[str, tuple[str, ...]] = entry(
        "The effects that each cannot be distinguished from, the closest first"
    )

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The groups of effects that cannot be distinguished."""
        return tuple(x.names for x in self.advice)


def protocol_isolability(
    knee: Knee, protocol: Protocol, *, sd_mm: float, sd_deg: float, seed: int = 0
) -> ProtocolIsolability | None:
    """What a protocol can tell on a subject with its own values; None where no trial is predicted.

    Each structure that may be there is where anatomy puts it, but a rival may be a few millimetres
    away from there. Trials without a prediction are left out.
    """
    # The base model at the subject's own values, as if fitted to its own prediction.
    model = base_model(knee, protocol)
    theta = model.parameters.vector(values_of(knee))
    predicted = model.predict(theta, derivatives=False).is_converged
    if not predicted.any():
        return None
    model = model.with_protocol(protocol.select(np.flatnonzero(predicted)))
    coordinates = model.predict_once(theta).coordinates
    sds = np.broadcast_to(np.array([sd_mm] * 3 + [sd_deg] * 2), coordinates.shape)
    laxity = Laxity(protocol=model.protocol, coordinates=coordinates, sd=sds)
    plain = best_fit_from(model, laxity, stated_noise(laxity), [theta])
    fitted = fitted_with_nuisances(plain, sds, laxity.within_trial_correlation)
    present = {x.name for x in fitted.model.effects}
    causes = causes_in_experiments(library(knee), protocol)
    tried = [x for x in causes if x.name not in present]
    candidates = library_candidates(fitted, tried, seed=seed)
    variants = [
        x
        for x in [candidates.typical(name) for name in {x.name: None for x in tried}]
        if x is not None
    ]
    projected = [candidates.projected(x) for x in variants]
    apart = least_favourable_distances(projected, ROOT, candidates.test.signatures)
    confused = groups(_mutual_distances(apart, [x for x in apart.effects if x != IMITATOR]))
    square = _mutual_distances(apart, apart.effects)
    least = np.minimum(square.values, square.values.T)
    near = {}
    for row, name in enumerate(square.effects):
        order = [k for k in np.argsort(least[row], kind="stable") if k != row]
        near[name] = tuple(square.effects[k] for k in order if least[row, k] < LEAST_DISTANCE)
    return ProtocolIsolability(
        protocol=fitted.laxity.protocol,
        visibility=tuple(candidates.visibility(x.effect) for x in variants),
        distances=apart,
        advice=tuple(
            _advise(fitted, candidates, [x for x in variants if x.effect.name in names])
            for names in confused
            if len(names) > 1
        ),
        look_alikes=near,
    )


def _mutual_distances(apart: Distances, names: Sequence[str]) -> Distances:
    rows = [apart.effects.index(x) for x in names]
    columns = [apart.rivals.index(x) for x in names]
    values = apart.values[np.ix_(rows, columns)]
    return Distances(effects=tuple(names), rivals=tuple(names), values=values)


def _advise(
    fitted: FittedModel, candidates: CandidateCauses, members: Sequence[Variant]
) -> GroupAdvice:
    """The trials that set the members of a group apart, each from the others where most alike."""
    confused = [
        (one, _least_distinguishable(candidates, one, other.effect))
        for one, other in permutations(members, 2)
    ]
    variants = list({id(x): x for x in [*members, *(rival for _, rival in confused)]}.values())
    laxity = fitted.laxity
    offer = AdviceCandidates(
        laxity=laxity, candidates=offered_laxity(fitted.model, laxity.protocol)
    )
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


def _rows(
    fitted: FittedModel, variants: Sequence[Variant], offer: AdviceCandidates
) -> WhitenedRows:
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
            values = secant_amplitudes(variant.effect, variant.values)
            _, slopes = offer.predict(extended, np.r_[theta, values])
        moved = theta.size + variant.moved
        blocks.append(WhitenedRows(made=slopes.made[:, moved], offered=slopes.offered[:, :, moved]))
    return WhitenedRows(
        made=np.concatenate([x.made for x in blocks], axis=1),
        offered=np.concatenate([x.offered for x in blocks], axis=2),
    )


def _least_distinguishable(candidates: CandidateCauses, effect: Variant, rival: Effect) -> Variant:
    """The variant of a rival that is hardest to distinguish from an effect."""
    rivals = [x for x in candidates.variants if x.effect is rival]
    seen = [candidates.projected(effect)]
    values = [
        least_favourable_distances(seen, ROOT, [candidates.projected(x)]).values[0, 0]
        for x in rivals
    ]
    return rivals[int(np.argmin(values))]


def _pairs(
    fitted: FittedModel,
    candidates: CandidateCauses,
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
        amplitude[0] = ROOT / noncentrality_root(candidates.projected(one), amplitude)
        pairs.append(
            Pair(
                effect=places[id(one)],
                amplitude=amplitude,
                rival=places[id(other)],
                rival_prior_sd=other.signature.prior_sd,
            )
        )
    return pairs
