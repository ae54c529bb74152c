"""Sobol and Morris indices of all outputs at once, with failed simulations kept in view.

A simulation may have no prediction for some outputs. Two rules say what their indices are then, and
both are reported. The main rule uses every simulation: for Sobol indices an output without a
prediction takes its mean over the simulations that have one, so that the indices are those of a
function defined in the whole box and a failure adds no variance of its own; for Morris effects
every pair of neighbours that both have a prediction counts. The second rule, `complete`, uses only
blocks or trajectories without any failure of that output, which leaves a part of the box out. Where
the two differ by more than their confidence intervals the indices depend on what failed.

A posterior's parameters are correlated, and Sobol indices mean nothing there. These indices need no
design, only draws with their outputs: delta and PAWN compare whole distributions, HDMR splits a
parameter's share of variance into its own and what it shares with others, and Shapley effects share
out the variance, shared parts included, so that they add up to what is explained.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import combinations
from math import factorial

import numpy as np
import scipy

from identknee.runs.declare import Array, BoolArray, IntArray, array, declared

RESAMPLES = 200
CONFIDENCE = 0.95
Z = float(scipy.stats.norm.ppf(0.5 + CONFIDENCE / 2.0))
# Parts of all samples at which indices are shown converging.
PARTS = (8, 4, 2, 1)
FEWEST = 4
# Standard deviations below this part of an output's size are rounding.
ROUNDING = 1e-9
BY_GROUP = ("group", "parameter")
OF_INDEX = "1; mm or deg for elementary effects, as the group's name says"


@declared
class Index:
    """One kind of sensitivity index of every group of outputs to every parameter."""

    levels: IntArray = array(
        "Numbers of samples (blocks, trajectories or draws) at which it was estimated, ascending; "
        "the last one is all of them",
        "level",
        dtype=int,
        key="n_samples",
    )
    values: Array = array(
        "The index at each level: 0 for outputs that do not vary, NaN for a group of whose "
        "outputs there are too few to say anything",
        *("level", *BY_GROUP),
        unit=OF_INDEX,
        key="index_by_level",
    )
    half_widths: Array = array(
        "Half-width of its 95 % bootstrap confidence interval at each level",
        *("level", *BY_GROUP),
        unit=OF_INDEX,
        key="half_width_by_level",
    )
    complete: Array = array("The index from samples without any failure", *BY_GROUP, unit=OF_INDEX)
    complete_half_widths: Array = array(
        "Half-width of that", *BY_GROUP, unit=OF_INDEX, key="complete_half_width"
    )
    noise_floor: Array | None = array(
        "Value that it has for an input without influence, estimated with a made-up one; not "
        "there where that is zero by definition",
        "group",
        unit=OF_INDEX,
        default=None,
    )

    @property
    def final(self) -> Array:
        """The index from all samples, shape ``(n_groups, n_parameters)``."""
        return np.asarray(self.values[-1])

    @property
    def final_half_widths(self) -> Array:
        """Half-widths of its 95 % confidence interval, shape ``(n_groups, n_parameters)``."""
        return np.asarray(self.half_widths[-1])


# Indices (resamples, groups, parameters) by name, from weights of samples (resamples, samples).
Estimator = Callable[[Array], Mapping[str, Array]]


def sobol_indices(outputs: Array, groups: IntArray, seed: int) -> dict[str, Index]:
    """First-order (``"S1"``) and total (``"ST"``) indices of every group of outputs.

    The index of a group is the share of the summed variance of its outputs, which must be in one
    unit (the generalised Sobol index). Blocks are drawn again with replacement for the confidence
    intervals; they are a little too wide, because blocks of a Sobol sequence are more even than
    independent ones.

    Parameters
    ----------
    outputs
        At the points of `saltelli_blocks`, shape ``(n, p + 2, m)``, not finite where failed.
    groups
        The group of each output, 0 to k - 1, shape ``(m,)``.
    seed
        Seed of the resampling.

    References
    ----------
    A. Saltelli et al., Computer Physics Communications 181 (2010) 259-270, table 2, (b) and (f),
    doi:10.1016/j.cpc.2009.09.018. F. Gamboa, A. Janon, T. Klein, A. Lagnoux, Electronic Journal of
    Statistics 8 (2014) 575-603, doi:10.1214/14-EJS895.
    """
    known: BoolArray = np.asarray(np.isfinite(outputs))
    # Outputs less their mean, 0 where unknown, and the variance of each that is rounding.
    ends, seen = outputs[:, [0, -1]], known[:, [0, -1]]
    count = np.maximum(seen.sum(axis=(0, 1)), 1)
    mean = np.where(seen, ends, 0.0).sum(axis=(0, 1)) / count
    size = np.abs(np.where(known, outputs, 0.0)).max(axis=(0, 1))
    centred, floor = np.where(known, outputs - mean, 0.0), (ROUNDING * size) ** 2
    member = _membership(groups)
    # Not even the main rule can say anything about an output that is never there.
    everything = np.broadcast_to(known.any(axis=(0, 1)), outputs.shape[::2]).astype(float)
    whole = known.all(axis=1).astype(float)

    def estimator(used: Array) -> Estimator:
        return lambda counts: _sobol(centred[: counts.shape[1]], used, counts, member, floor)

    return _converging(estimator(everything), estimator(whole), len(outputs), seed)


def morris_indices(points: Array, outputs: Array, groups: IntArray, seed: int) -> dict[str, Index]:
    """Elementary effects: ``"mu_star"``, ``"mu"`` and ``"sigma"`` of every group of outputs.

    An effect is the change of an output by a parameter's whole range, in the output's unit. For a
    group they are means over its outputs: of the mean absolute effect, of the mean effect and, as
    a root of mean squares, of the standard deviation of the effects.

    Parameters
    ----------
    points
        Trajectories in the unit cube, shape ``(n, p + 1, p)``.
    outputs
        At these points, shape ``(n, p + 1, m)``, not finite where failed.
    groups
        The group of each output, 0 to k - 1, shape ``(m,)``.
    seed
        Seed of the resampling of trajectories for the confidence intervals.

    References
    ----------
    M. D. Morris, Technometrics 33 (1991) 161-174, doi:10.1080/00401706.1991.10484804.
    F. Campolongo, J. Cariboni, A. Saltelli, Environmental Modelling & Software 22 (2007) 1509-1518,
    doi:10.1016/j.envsoft.2006.10.004.
    """
    known: BoolArray = np.asarray(np.isfinite(outputs))
    # Effects by parameter, shape ``(n, p, m)``, and whether both their ends are known.
    steps = np.diff(points, axis=1)
    moved = np.argmax(np.abs(steps), axis=2)
    sizes = np.take_along_axis(steps, moved[:, :, None], axis=2)
    change = np.diff(np.where(known, outputs, 0.0), axis=1) / sizes
    both = known[:, 1:] & known[:, :-1]
    by_parameter = np.argsort(moved, axis=1)[:, :, None]
    effects = np.take_along_axis(change * both, by_parameter, axis=1)
    pairs = np.take_along_axis(both, by_parameter, axis=1)
    whole = np.broadcast_to(np.all(known, axis=1)[:, None, :], pairs.shape).astype(float)
    member = _membership(groups)

    def estimator(used: Array) -> Estimator:
        return lambda counts: _morris(effects, used, counts, member)

    return _converging(estimator(pairs.astype(float)), estimator(whole), len(outputs), seed)


def sample_sizes(n: int, fewest: int = FEWEST) -> IntArray:
    """Numbers of samples at which indices are estimated: an eighth, a quarter, half and all of n.

    Examples
    --------
    >>> sample_sizes(64)
    array([ 8, 16, 32, 64])
    """
    return np.array([n // part for part in PARTS if part == 1 or n // part >= fewest])


def half_width(resampled: Array) -> Array:
    """Half-width of the 95 % confidence interval from resampled values, first axis taken out."""
    return np.asarray(Z * np.std(resampled, axis=0, ddof=1))


def _converging(
    estimate: Estimator, estimate_complete: Estimator, n: int, seed: int
) -> dict[str, Index]:
    """Indices at every level, and from samples without failure at the last one."""
    generator = np.random.default_rng(seed)
    levels = sample_sizes(n)
    by_level = []
    for level in levels:
        counts = np.ones((1 + RESAMPLES, level))
        counts[1:] = generator.multinomial(level, np.full(level, 1.0 / level), RESAMPLES)
        by_level.append(estimate(counts))
    complete = estimate_complete(counts)
    return {
        name: Index(
            levels=levels,
            values=np.array([found[name][0] for found in by_level]),
            half_widths=np.array([half_width(found[name][1:]) for found in by_level]),
            complete=complete[name][0],
            complete_half_widths=half_width(complete[name][1:]),
        )
        for name in complete
    }


def _sobol(
    centred: Array, used: Array, counts: Array, member: Array, floor: Array
) -> dict[str, Array]:
    used = used[: len(centred)]
    a, b, mixed = centred[:, 0], centred[:, -1], centred[:, 1:-1]
    weight = counts @ used
    per_block = 1.0 / np.where(weight > 0, weight, 1.0)
    mean = 0.5 * (counts @ (used * (a + b))) * per_block
    variance = 0.5 * (counts @ (used * (a**2 + b**2))) * per_block - mean**2
    # Outputs that only rounding moves would otherwise be shared out among the parameters.
    moves = variance > floor
    total_variance = (variance * moves) @ member

    def share(products: Array) -> Array:
        parts = ((counts @ (used * products)) * per_block * moves) @ member
        some = total_variance > 0
        of_nothing = np.where((weight > 0) @ member > 0, 0.0, np.nan)
        return np.where(some, parts / np.where(some, total_variance, 1.0), of_nothing)

    parameters = range(mixed.shape[1])
    return {
        "S1": np.stack([share(b * (mixed[:, i] - a)) for i in parameters], axis=-1),
        "ST": np.stack([share(0.5 * (a - mixed[:, i]) ** 2) for i in parameters], axis=-1),
    }


def _morris(effects: Array, used: Array, counts: Array, member: Array) -> dict[str, Array]:
    n = counts.shape[1]
    found: dict[str, list[Array]] = {"mu_star": [], "mu": [], "sigma": []}
    for effect, weights in zip(
        np.moveaxis(effects[:n], 1, 0), np.moveaxis(used[:n], 1, 0), strict=True
    ):
        weight = counts @ weights
        per_effect = 1.0 / np.where(weight > 0, weight, 1.0)
        mean = (counts @ (weights * effect)) * per_effect
        square = (counts @ (weights * effect**2)) * per_effect
        spread = np.maximum(square - mean**2, 0.0) * weight / np.maximum(weight - 1.0, 1.0)
        # Outputs without an effect in these samples have no say in their group's mean.
        seen = (weight > 0) @ member
        of_group = np.where(seen > 0, 1.0 / np.maximum(seen, 1.0), np.nan)
        found["mu_star"].append(
            ((counts @ (weights * np.abs(effect))) * per_effect) @ member * of_group
        )
        found["mu"].append(mean @ member * of_group)
        found["sigma"].append(np.sqrt(spread @ member * of_group))
    return {name: np.stack(values, axis=-1) for name, values in found.items()}


def _membership(groups: IntArray) -> Array:
    return np.asarray(groups[:, None] == np.arange(int(groups.max()) + 1), dtype=np.float64)


GIVEN_RESAMPLES = 25
# The least number of draws that all methods take.
FEWEST_DRAWS = 300
DENSITY_POINTS = 100
PAWN_SLICES = 10
# Shapley effects need a regression for each of 2^p subsets.
MOST_SHAPLEY_PARAMETERS = 14
RIDGE = 1e-10
GivenIndex = Callable[[Array, Array, int], Mapping[str, Array]]


def converging_indices(
    method: str, draws: Array, scores: Array, levels: IntArray, seed: int
) -> dict[str, dict[str, Array]]:
    """Indices of one output at increasing numbers of draws, with half-widths.

    Parameters
    ----------
    method
        One of `METHODS`.
    draws
        Parameter vectors, shape ``(n, p)``, in random order.
    scores
        The output at each, shape ``(n,)``; NaN where it has none, and these draws are left out.
    levels
        Numbers of draws, ascending.
    seed
        Seed of the resampling.

    Returns
    -------
    indices
        By name ``{"values", "half_widths"}``, shape ``(n_levels, p)`` each, and ``"noise_floor"``,
        the value of an input without influence, where the method has one.
    """
    generator = np.random.default_rng(seed)
    has_floor = method in WITH_NOISE_FLOOR
    if has_floor:
        draws = np.column_stack([draws, generator.random(len(draws))])
    known = np.isfinite(scores)
    rows: dict[str, list[tuple[Array, Array]]] = {}
    for level in levels:
        used = np.flatnonzero(known[:level])
        for name, pair in _with_half_widths(method, draws[used], scores[used], generator).items():
            rows.setdefault(name, []).append(pair)
    found: dict[str, dict[str, Array]] = {}
    for name, pairs in rows.items():
        values, half_widths = (np.array(x) for x in zip(*pairs, strict=True))
        found[name] = {"values": values, "half_widths": half_widths}
        if has_floor:
            found[name] = {
                "values": values[:, :-1],
                "half_widths": half_widths[:, :-1],
                "noise_floor": values[-1, -1],
            }
    return found


def leading_component(outputs: Array) -> tuple[Array, float]:
    """The first principal component of a group of outputs, and its share of their variance.

    Parameters
    ----------
    outputs
        Shape ``(n, m)``, all in one unit; a row with a value that is not finite counts as unknown.

    Returns
    -------
    scores
        The first principal component, shape ``(n,)``, larger where the outputs are larger on the
        whole; NaN for unknown rows.
    share
        Its variance over the sum of the outputs' variances; 1 where nothing varies.
    """
    known = np.isfinite(outputs).all(axis=1)
    scores = np.full(len(outputs), np.nan)
    if not known.any():
        return scores, 1.0
    centred = outputs[known] - outputs[known].mean(axis=0)
    _, size, right = np.linalg.svd(centred, full_matrices=False)
    direction = right[0] * (1.0 if right[0].sum() >= 0 else -1.0)
    scores[known] = centred @ direction
    total = float(np.sum(size**2))
    return scores, float(size[0] ** 2) / total if total > 0 else 1.0


def delta_index(draws: Array, scores: Array, _seed: int) -> dict[str, Array]:
    """Borgonovo's delta of every parameter, shape ``(p,)``.

    Half the area between the density of the output and its density given the parameter, on
    average; 0 without influence, 1 where the parameter decides everything.

    References
    ----------
    E. Borgonovo, Reliability Engineering & System Safety 92 (2007) 771-784,
    doi:10.1016/j.ress.2006.04.015. E. Plischke, E. Borgonovo, C. L. Smith, European Journal of
    Operational Research 226 (2013) 536-550, equation 26, doi:10.1016/j.ejor.2012.11.047.
    """
    from SALib.analyze import delta

    n = len(scores)
    power = 2.0 / (7.0 + np.tanh((1500.0 - n) / 500.0))
    edges = np.linspace(0, n, min(int(np.ceil(n**power)), 48) + 1)
    if len(np.unique(scores)) == 2:
        return {"delta": np.array([_delta_of_binary_output(x, scores, edges) for x in draws.T])}
    grid = np.linspace(scores.min(), scores.max(), DENSITY_POINTS)
    values = [delta.calc_delta(scores, grid, column, edges) for column in draws.T]
    return {"delta": np.array(values)}


def pawn_index(draws: Array, scores: Array, _seed: int) -> dict[str, Array]:
    """The PAWN index of every parameter, shape ``(p,)``.

    The median over slices of a parameter of the Kolmogorov-Smirnov distance between the output's
    distribution and that within the slice.

    References
    ----------
    F. Pianosi, T. Wagener, Environmental Modelling & Software 108 (2018) 197-207,
    doi:10.1016/j.envsoft.2018.07.019.
    """
    # SALib's own works out a p-value for every distance, which takes fifty times as long.
    n = len(scores)
    order = np.argsort(scores, kind="stable")
    ordered = scores[order]
    last_of_ties = np.r_[ordered[1:] != ordered[:-1], True]
    whole = np.arange(1, n + 1)[last_of_ties] / n
    medians = []
    for column in draws.T:
        edges = np.quantile(column, np.linspace(0.0, 1.0, PAWN_SLICES + 1)[1:-1])
        slices = np.searchsorted(edges, column[order], side="right")
        inside = slices == np.arange(PAWN_SLICES)[:, None]
        filled = inside[inside.any(axis=1)]
        within = np.cumsum(filled, axis=1)[:, last_of_ties] / filled.sum(axis=1, keepdims=True)
        medians.append(np.median(np.abs(within - whole).max(axis=1)))
    return {"pawn": np.array(medians)}


def hdmr_index(draws: Array, scores: Array, seed: int) -> dict[str, Array]:
    """Shares of variance of every parameter, shape ``(p,)``, from an expansion in its functions.

    ``"Sa"`` is its own, ``"Sb"`` what it shares with correlated parameters (may be negative), and
    ``"ST"`` their sum with all interactions.

    References
    ----------
    G. Li et al., Journal of Physical Chemistry A 114 (2010) 6022-6032, doi:10.1021/jp9096919.
    Y. Gao, A. Sahin, J. A. Vrugt, Water Resources Research 59 (2023) e2022WR032834,
    doi:10.1029/2022WR032834.
    """
    from SALib.analyze import enhanced_hdmr

    p = draws.shape[1]
    # What SALib wants to know, fresh each time because it writes into it.
    problem = {
        "num_vars": p,
        "names": [f"x{i}" for i in range(p)],
        "bounds": [[float(x.min()), float(x.max())] for x in draws.T],
    }
    found = enhanced_hdmr.analyze(
        problem, draws, scores, bootstrap=1, subset=len(scores), seed=1 + seed
    )
    return {name: np.array(found[name][:p], dtype=np.float64) for name in ("Sa", "Sb", "ST")}


def shapley_index(draws: Array, scores: Array, _seed: int) -> dict[str, Array]:
    """Shapley effects of every parameter, shape ``(p,)``, whatever their correlations.

    The variance that a subset of parameters explains is that of the best quadratic function of
    them, adjusted for the number of its terms. The effects are exact for linear functions of
    Gaussian parameters; their sum says how much of the variance quadratic functions explain.

    Raises
    ------
    ValueError
        If there are more than 14 parameters: the number of subsets is 2^p.

    References
    ----------
    A. B. Owen, SIAM/ASA Journal on Uncertainty Quantification 2 (2014) 245-251,
    doi:10.1137/130936233. B. Iooss, C. Prieur, International Journal for Uncertainty Quantification
    9 (2019) 493-514, doi:10.1615/Int.J.UncertaintyQuantification.2019028372.
    """
    p = draws.shape[1]
    if p > MOST_SHAPLEY_PARAMETERS:
        raise ValueError(
            f"Shapley effects of {p} parameters need 2^{p} regressions; hold some fixed so that at "
            f'most {MOST_SHAPLEY_PARAMETERS} remain, or use "delta"'
        )
    # Share of the variance explained by a quadratic function of each subset of parameters.
    n = len(draws)
    standard = (draws - draws.mean(axis=0)) / draws.std(axis=0)
    pairs = [(i, j) for i in range(p) for j in range(i, p)]
    terms = np.column_stack([standard, *(standard[:, i] * standard[:, j] for i, j in pairs)])
    terms -= terms.mean(axis=0)
    centred = scores - scores.mean()
    total = float(centred @ centred)
    gram, projected = terms.T @ terms / n, terms.T @ centred / n
    gram[np.diag_indices_from(gram)] *= 1.0 + RIDGE
    owners = [{i} for i in range(p)] + [{i, j} for i, j in pairs]
    explained: dict[tuple[int, ...], float] = {(): 0.0}
    for size in range(1, p + 1):
        for subset in combinations(range(p), size):
            of = [k for k, owner in enumerate(owners) if owner <= set(subset)]
            weights = np.linalg.solve(gram[np.ix_(of, of)], projected[of])
            share = n * float(projected[of] @ weights) / total
            explained[subset] = 1.0 - (1.0 - share) * (n - 1) / (n - 1 - len(of))
    effects = np.zeros(p)
    for subset in explained:
        for i in set(range(p)) - set(subset):
            weight = factorial(len(subset)) * factorial(p - len(subset) - 1) / factorial(p)
            joined = explained[tuple(sorted((*subset, i)))]
            effects[i] += weight * (joined - explained[subset])
    return {"shapley": effects}


METHODS: Mapping[str, GivenIndex] = {
    "delta": delta_index,
    "pawn": pawn_index,
    "hdmr": hdmr_index,
    "shapley": shapley_index,
}
# Distances between distributions estimated from few draws are never zero.
WITH_NOISE_FLOOR = ("delta", "pawn")
# Whose bootstrap says how much too large the estimate is (Plischke 2013, equation 30).
BIAS_REDUCED = ("delta",)


def _with_half_widths(
    method: str, draws: Array, scores: Array, generator: np.random.Generator
) -> dict[str, tuple[Array, Array]]:
    """Index and half-width by name, shape ``(p,)`` each; zero where the output is constant."""
    n, index = len(scores), METHODS[method]
    seeds = generator.integers(2**31, size=1 + GIVEN_RESAMPLES)
    rows = generator.integers(max(n, 1), size=(GIVEN_RESAMPLES, n))
    if n < FEWEST_DRAWS or np.ptp(scores) == 0.0:
        # An output that never changes depends on nothing; the names come from any output.
        dummy = np.random.default_rng(0).random((FEWEST_DRAWS, 1 + draws.shape[1]))
        nothing = np.full(draws.shape[1], 0.0 if n >= FEWEST_DRAWS else np.nan)
        with _silenced_salib():
            names = tuple(index(dummy[:, 1:], dummy[:, 0], 0))
        return dict.fromkeys(names, (nothing, nothing))
    with _silenced_salib():
        found = index(draws, scores, int(seeds[0]))
        again = [
            index(draws[chosen], scores[chosen], int(seed))
            for chosen, seed in zip(rows, seeds[1:], strict=True)
        ]
    pairs = {}
    for name, values in found.items():
        resampled = np.array([x[name] for x in again])
        if method in BIAS_REDUCED:
            values = 2.0 * values - resampled.mean(axis=0)
        pairs[name] = (np.asarray(values), half_width(resampled))
    return pairs


def _delta_of_binary_output(column: Array, scores: Array, edges: Array) -> float:
    """Delta of an output that is one of two values, whose densities are shares."""
    is_high = scores == scores.max()
    rank = np.argsort(np.argsort(column, kind="stable"), kind="stable") + 1
    classes = np.searchsorted(edges, rank, side="left") - 1
    count = np.bincount(classes, minlength=len(edges) - 1)
    high = np.bincount(classes, weights=is_high, minlength=len(edges) - 1)
    apart = np.abs(high / np.maximum(count, 1) - is_high.mean())
    return float(np.sum(count * apart) / len(scores))


@contextmanager
def _silenced_salib() -> Iterator[None]:
    """SALib's warnings and its seeding of numpy's global generator kept from the caller."""
    state = np.random.get_state()  # noqa: NPY002 - to put it back
    formatting = warnings.formatwarning
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        warnings.formatwarning = formatting
        np.random.set_state(state)  # noqa: NPY002
