"""Isolability of causes under a protocol, and trials that would separate confounded ones."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.linalg import eigh
from scipy.sparse.csgraph import connected_components

from identknee.diagnosis.score import LEAST_DISTANCE, ProjectedSignature, effect_names
from identknee.identify.trial_choice import choose
from identknee.runs.declare import Array, BoolArray, IntArray, array, declared, entry, frozen
from identknee.runs.marginalise import NuisancePosterior, schur_complement

# Trials are advised until the least distance is ENOUGH, a margin above LEAST_DISTANCE, or until
# there are MOST_TRIALS.
ENOUGH, MOST_TRIALS = 7.0, 12
# Prior standard deviations within which a mix of amplitudes is plausible.
REACH = 3.0
# Share of the largest eigenvalue of the scaled information below which a direction is unknown.
LEAST_EIGENVALUE = 1e-12


@declared
class Distances:
    """How far the data expected under each effect are from what each rival could fit to them."""

    effects: tuple[str, ...] = array("Names of the rows", "effect", is_in_arrays=False)
    rivals: tuple[str, ...] = array("Names of the columns", "rival", is_in_arrays=False)
    values: Array = array(
        "Root of the expected rise of the objective when the rival is fitted in place of the "
        "effect, base parameters free; 0 where both are one",
        "effect",
        "rival",
    )


def noncentrality_root(signature: ProjectedSignature, amplitude: Array) -> float:
    """Square root of the noncentrality of an effect after the fit."""
    return float(np.sqrt(max(float(amplitude @ signature.gram @ amplitude), 0.0)))


def distances(
    effects: Sequence[ProjectedSignature],
    amplitudes: Sequence[Array],
    rivals: Sequence[ProjectedSignature],
) -> Distances:
    """The distances of effects of known amplitudes, each rival with its best variant.

    Parameters
    ----------
    effects
        One variant of each, supposed true.
    amplitudes
        Amplitudes of each, shape ``(k,)``.
    rivals
        All variants of all rivals; they keep to their signs and priors.
    """
    names = effect_names(rivals)
    values = np.full((len(effects), len(names)), np.inf)
    for row, (effect, amplitude) in enumerate(zip(effects, amplitudes, strict=True)):
        expected = effect.projected @ amplitude
        for rival in rivals:
            left = expected @ expected - rival.gain((expected @ rival.projected)[None])[0]
            _lower(values, row, names.index(rival.signature.name), left)
        _zero_for_same_effect(values[row], names, effect)
    return Distances(effects=effect_names(effects), rivals=names, values=values)


def least_favourable_distances(
    effects: Sequence[ProjectedSignature],
    root: float,
    rivals: Sequence[ProjectedSignature],
) -> Distances:
    """The distances before any data, each effect with the mix of amplitudes nearest to its rival.

    The mix that counts is the one closest to the rival, by generalised eigenvalues, among those
    that stand out of the noise by `root` with no amplitude beyond three prior standard deviations.
    Signs are ignored. An effect whose mixes are all too small counts with its most visible one. An
    invisible effect is at infinite distance from all others.

    Parameters
    ----------
    effects
        One variant of each, supposed true.
    root
        How far each stands out of the noise, see `noncentrality_root`.
    rivals
        All variants of all rivals; they keep to their priors.
    """
    names = effect_names(rivals)
    values = np.full((len(effects), len(names)), np.inf)
    for row, effect in enumerate(effects):
        # Mixes of amplitudes that all stand out by 1 and are orthogonal in that, shape ``(k, n)``.
        prior_sd = effect.signature.prior_sd
        size, vectors = np.linalg.eigh(prior_sd[:, None] * effect.gram * prior_sd)
        plausible = size >= (root / REACH) ** 2
        plausible[-1] = True
        used = np.maximum(size[plausible], np.finfo(np.float64).tiny)
        mixes = np.asarray(prior_sd[:, None] * vectors[:, plausible] / np.sqrt(used))
        for rival in rivals if effect.is_seen else ():
            shared = rival.projected.T @ effect.projected
            left = effect.gram - shared.T @ rival.covariance @ shared
            least = eigh(mixes.T @ left @ mixes, eigvals_only=True)[0]
            _lower(values, row, names.index(rival.signature.name), root**2 * least)
        _zero_for_same_effect(values[row], names, effect)
    return Distances(effects=effect_names(effects), rivals=names, values=values)


def groups(found: Distances, *, least: float = LEAST_DISTANCE) -> tuple[tuple[str, ...], ...]:
    """Groups of effects that cannot be distinguished, directly or through others, in their order.

    Parameters
    ----------
    found
        Distances of all effects from one another, rows and columns alike.
    least
        Two effects are distinguished at this distance or more, whichever of them is true.

    Raises
    ------
    ValueError
        If the rivals are not the effects.
    """
    if set(found.effects) != set(found.rivals):
        raise ValueError("groups need the distances of effects from one another")
    values = found.values[:, [found.rivals.index(x) for x in found.effects]]
    _, labels = connected_components(values < least, directed=False)
    return tuple(
        tuple(name for name, label in zip(found.effects, labels, strict=True) if label == group)
        for group in dict.fromkeys(labels.tolist())
    )


@declared
class Pair:
    """An effect of known amplitude and the rival to distinguish it from."""

    effect: IntArray = array("Its columns", "amplitude", dtype=int)
    amplitude: Array = array("Its amplitudes", "amplitude")
    rival: IntArray = array("Columns of the rival", "rival", dtype=int)
    rival_prior_sd: Array = array(
        "Prior standard deviation of each amplitude of the rival", "rival"
    )


@declared
class AdvisedTrials:
    """Trials to add, and the distances that they achieve."""

    chosen: tuple[int, ...] = entry(
        "Which candidates, in the order of choice; one may come several times"
    )
    distances: Array = entry(
        "Distance of each pair before and after each choice, shape ``(n_chosen + 1, n_pairs)``"
    )
    single: Array = entry(
        "Distance of each pair after one candidate alone, shape ``(n_candidates, n_pairs)``; NaN "
        "where the candidate has no prediction"
    )


def advise_trials(
    made: Array,
    candidates: Array,
    pairs: Sequence[Pair],
    *,
    n_base: int,
    n_nuisances: int = 0,
    n_trials: int = MOST_TRIALS,
    enough: float = ENOUGH,
) -> AdvisedTrials:
    """The trials that separate the pairs most: each choice raises the least distance most.

    Greedy, repeats allowed. Amplitudes of rivals keep to their priors, not to their signs. In an
    added trial nuisances have the posterior that the trials before it give.

    Parameters
    ----------
    made
        Whitened derivatives of the trials made by all parameters, rows of the prior of the base
        parameters included: first the base parameters, then the effects, last what a prior standard
        deviation of each nuisance does, shape ``(m, q)``.
    candidates
        The same of each candidate trial, shape ``(n, r, q)``; NaN in one that has no prediction.
    pairs
        What to distinguish.
    n_base, n_nuisances
        How many of the columns belong to the base parameters and to nuisances.
    n_trials
        How many trials to choose at most.
    enough
        The least distance at which no more are chosen.

    Raises
    ------
    ValueError
        If no candidate has a prediction.

    References
    ----------
    A. C. Atkinson and V. V. Fedorov, The design of experiments for discriminating between two rival
    models, Biometrika 62 (1975) 57-70, doi:10.1093/biomet/62.1.57.
    """
    usable: BoolArray = np.asarray(np.isfinite(candidates).all(axis=(1, 2)))
    if not usable.any():
        raise ValueError("no candidate trial has a prediction; offer others")
    known = np.where(usable[:, None, None], candidates, 0.0)
    n = known.shape[2] - n_nuisances

    @cache
    def after(chosen: tuple[int, ...]) -> Array:
        """Distances of the pairs with each candidate beside those chosen, ``(n, n_pairs)``."""
        information, nuisances = _marginalised(np.vstack([made, *known[list(chosen)]]), n_nuisances)
        added = nuisances.rows(known[:, :, :n], known[:, :, n:])
        return _pair_distances(information, added, pairs, n_base)

    def reached(chosen: Sequence[int]) -> Array:
        if not chosen:
            return pair_distances(made, pairs, n_base=n_base, n_nuisances=n_nuisances)
        return np.asarray(after(tuple(chosen[:-1]))[chosen[-1]])

    def losses(chosen: tuple[int, ...]) -> Array:
        # The sum over the pairs breaks ties between candidates.
        return np.asarray(-after(chosen).min(axis=1) - 1e-6 * after(chosen).sum(axis=1))

    chosen = choose(
        losses, usable, n_trials, is_enough=lambda x: bool(reached(x).min() >= enough), exchanges=0
    )
    followed = [reached(chosen[:i]) for i in range(len(chosen) + 1)]
    return AdvisedTrials(
        chosen=chosen,
        distances=frozen(followed, None, None, name="distances"),
        single=frozen(np.where(usable[:, None], after(()), np.nan), None, None, name="single"),
    )


def pair_distances(
    made: Array, pairs: Sequence[Pair], *, n_base: int, n_nuisances: int = 0
) -> Array:
    """Distance of each pair by rows that are made, shape ``(n_pairs,)``; as in `advise_trials`."""
    information, _ = _marginalised(made, n_nuisances)
    nothing = np.zeros((1, 0, len(information)))
    return np.asarray(_pair_distances(information, nothing, pairs, n_base)[0])


def _marginalised(rows: Array, n_nuisances: int) -> tuple[Array, NuisancePosterior]:
    """Information of rows about the parameters, nuisances marginalised, and their posterior."""
    n = rows.shape[1] - n_nuisances
    is_kept = np.arange(rows.shape[1]) < n
    information = schur_complement(rows.T @ rows + np.diag(np.where(is_kept, 0.0, 1.0)), is_kept)
    return information, NuisancePosterior.after(np.zeros((1, len(rows))), rows[:, :n], rows[:, n:])


def _lower(values: Array, row: int, column: int, square: float) -> None:
    values[row, column] = min(values[row, column], np.sqrt(max(float(square), 0.0)))


def _zero_for_same_effect(row: Array, names: tuple[str, ...], effect: ProjectedSignature) -> None:
    if effect.signature.name in names:
        row[names.index(effect.signature.name)] = 0.0


def _pair_distances(information: Array, added: Array, pairs: Sequence[Pair], n_base: int) -> Array:
    """The distance of each pair with each of n trials beside an information, ``(n, n_pairs)``.

    Parameters
    ----------
    information
        Of what is made, shape ``(q, q)``.
    added
        Rows of each trial in units of their errors, shape ``(n, r, q)``.
    pairs, n_base
        As in `advise_trials`.
    """
    # Many effects share a rival, and its inverse takes most of the time.
    rivals: dict[tuple[bytes, bytes], _Rival] = {}
    columns = []
    for pair in pairs:
        key = pair.rival.tobytes(), pair.rival_prior_sd.tobytes()
        if key not in rivals:
            rivals[key] = _Rival(information, added, pair, n_base)
        columns.append(rivals[key].distance(pair))
    return np.stack(columns, axis=1)


class _Rival:
    """The span of the base parameters and the amplitudes of a rival, and trials that add to it.

    A trial has few rows, so the inverse with it is a low-rank update of that without it.
    """

    def __init__(self, information: Array, added: Array, pair: Pair, n_base: int) -> None:
        self._information, self._rows = information, added
        self._free = np.concatenate([np.arange(n_base), pair.rival])
        precision = np.concatenate([np.zeros(n_base), pair.rival_prior_sd**-2.0])
        among = information[np.ix_(self._free, self._free)] + np.diag(precision)
        least = np.finfo(np.float64).tiny
        self._scale = np.sqrt(np.maximum(np.diag(among), least))
        sizes, vectors = np.linalg.eigh(among / self._scale[:, None] / self._scale)
        lowest = LEAST_EIGENVALUE * max(float(np.abs(sizes).max(initial=0.0)), least)
        is_seen = sizes > lowest
        self._inverse = (vectors[:, is_seen] / sizes[is_seen]) @ vectors[:, is_seen].T
        # A trial may show directions that nothing has shown yet.
        self._of_free = added[:, :, self._free] / self._scale
        spread = self._of_free @ (vectors / np.sqrt(np.maximum(sizes, lowest)))
        self._spread = np.eye(added.shape[1]) + spread @ spread.mT

    def distance(self, pair: Pair) -> Array:
        """Distance of a pair's effect from what the span explains, with each trial, ``(n,)``."""
        effect, amplitude = pair.effect, pair.amplitude
        towards = self._information[np.ix_(self._free, effect)] @ amplitude / self._scale
        total = amplitude @ self._information[np.ix_(effect, effect)] @ amplitude
        explaining = self._inverse @ towards
        # What a trial shows of the effect beyond what explains it in all that is made.
        shown = self._rows[:, :, effect] @ amplitude - self._of_free @ explaining
        gained = np.einsum(
            "nr,nr->n", shown, np.linalg.solve(self._spread, shown[..., None])[..., 0]
        )
        return np.asarray(np.sqrt(np.maximum(total - towards @ explaining + gained, 0.0)))
