"""Sobol and Morris indices of all outputs at once, with failed simulations kept in view.

A simulation may have no prediction for some outputs. Two rules say what their indices are then, and
both are reported. The main rule uses every simulation: for Sobol indices an output without a
prediction takes its mean over the simulations that have one, so that the indices are those of a
function defined in the whole box and a failure adds no variance of its own; for Morris effects
every pair of neighbours that both have a prediction counts. The second rule, `complete`, uses only
blocks or trajectories without any failure of that output, which leaves a part of the box out. Where
the two differ by more than their confidence intervals the indices depend on what failed.
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.stats import norm

from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import array, declared

RESAMPLES = 200
CONFIDENCE = 0.95
Z = float(norm.ppf(0.5 + CONFIDENCE / 2.0))
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
    centred, floor = _centred(outputs, known)
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
    effects, pairs = _elementary_effects(points, np.where(known, outputs, 0.0), known)
    whole = np.broadcast_to(np.all(known, axis=1)[:, None, :], pairs.shape).astype(float)
    member = _membership(groups)

    def estimator(used: Array) -> Estimator:
        return lambda counts: _morris(effects, used, counts, member)

    return _converging(estimator(pairs.astype(float)), estimator(whole), len(outputs), seed)


def levels_of(n: int, fewest: int = FEWEST) -> IntArray:
    """Numbers of samples at which indices are estimated: an eighth, a quarter, half and all of n.

    Examples
    --------
    >>> levels_of(64)
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
    levels = levels_of(n)
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


def _elementary_effects(points: Array, outputs: Array, known: BoolArray) -> tuple[Array, BoolArray]:
    """Effects by parameter, shape ``(n, p, m)``, and whether both their ends are known."""
    steps = np.diff(points, axis=1)
    moved = np.argmax(np.abs(steps), axis=2)
    sizes = np.take_along_axis(steps, moved[:, :, None], axis=2)
    change = np.diff(outputs, axis=1) / sizes
    both = known[:, 1:] & known[:, :-1]
    by_parameter = np.argsort(moved, axis=1)[:, :, None]
    return (
        np.take_along_axis(change * both, by_parameter, axis=1),
        np.take_along_axis(both, by_parameter, axis=1),
    )


def _centred(outputs: Array, known: BoolArray) -> tuple[Array, Array]:
    """Outputs less their mean, 0 where unknown, and the variance of each that is rounding."""
    ends, seen = outputs[:, [0, -1]], known[:, [0, -1]]
    count = np.maximum(seen.sum(axis=(0, 1)), 1)
    mean = np.where(seen, ends, 0.0).sum(axis=(0, 1)) / count
    size = np.abs(np.where(known, outputs, 0.0)).max(axis=(0, 1))
    return np.where(known, outputs - mean, 0.0), (ROUNDING * size) ** 2


def _membership(groups: IntArray) -> Array:
    """Which output belongs to which group, shape ``(m, k)``."""
    return np.asarray(groups[:, None] == np.arange(int(groups.max()) + 1), dtype=np.float64)
