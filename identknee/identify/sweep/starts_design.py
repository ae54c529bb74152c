"""Where many searches begin: spread over the bounds, or at stated distances from one point."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from identknee.calibrate.scales import STIFFNESS_UNIT, STRAIN_UNIT, typical_steps
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, IntArray

# Unit of `distance`.
DISTANCE = "kN and %"
# Draws of one start before it is said that the bounds leave no room at its distance.
MAX_DRAWS = 10_000


def sobol_starts(parameters: Parameters, n: int, *, seed: int = 0) -> Array:
    """Points that fill the bounds evenly, shape ``(n, p)``; the first ones stay when `n` grows.

    They are a Sobol sequence with Owen's scrambling.

    Raises
    ------
    ValueError
        If `n` is less than 1 or a bound is infinite.

    References
    ----------
    .. [1] Owen (1998), Journal of Complexity 14(4), 466-489.
           https://doi.org/10.1006/jcom.1998.0487
    """
    _check_number(n)
    for name, low, high in zip(parameters.names, parameters.lower, parameters.upper, strict=True):
        if not np.isfinite(high - low):
            raise ValueError(
                f"the bounds of {name} are {low:g} and {high:g}; "
                "give finite ones to spread starts between them"
            )
    sequence = qmc.Sobol(parameters.n, seed=seed)
    unit = sequence.random_base2(int(n - 1).bit_length())[:n]
    return np.asarray(parameters.lower + (parameters.upper - parameters.lower) * unit)


def shell_starts(
    parameters: Parameters, n: int, *, center: ArrayLike, distances: ArrayLike, seed: int = 0
) -> Array:
    """Points at stated distances from one point, shape ``(n, p)``; start i has distance i mod k.

    On a shell at distance d the parameters of each unit differ by d on average: the stiffnesses by
    d kN and the reference strains by d %, as the paper counts the distance of its initial guesses.
    Within a unit the differences are uniform on that sphere of mean absolute values. Points outside
    the bounds are drawn again.

    Parameters
    ----------
    parameters
        For their units and bounds.
    n
        How many.
    center
        Truth or best fit, shape ``(p,)``.
    distances
        The distances of the shells, not negative, shape ``(k,)``.
    seed
        Start i is the same for the same seed whatever `n` is.

    Raises
    ------
    ValueError
        If `n` is less than 1, a distance is negative or missing, or the bounds leave no room.
    """
    _check_number(n)
    shells = np.asarray(distances, dtype=np.float64)
    if shells.ndim != 1 or shells.size == 0 or not np.all(shells >= 0):
        raise ValueError(f"distances of shells must be 0 or more, got {shells.tolist()}")
    middle = np.asarray(center, dtype=np.float64)
    groups = unit_groups(parameters)
    units = distance_units(parameters)
    starts = np.empty((n, parameters.n))
    for i in range(n):
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
        distance = float(shells[i % shells.size])
        for group in range(int(groups.max()) + 1):
            of_group = np.flatnonzero(groups == group)
            span = distance * units[of_group]
            starts[i, of_group] = _on_shell(of_group, middle, span, parameters, generator)
    return starts


def distance(thetas: ArrayLike, target: ArrayLike, parameters: Parameters) -> Array:
    """How far parameter sets are from one, as the paper counts it, shape ``(...,)``.

    The mean absolute difference of the stiffnesses [kN] or of the reference strains [%], whichever
    is larger; parameters in other units count in typical steps, and nuisances do not count.

    Parameters
    ----------
    thetas
        Shape ``(..., p)``.
    target
        Shape ``(p,)``.
    parameters
        For their units.
    """
    groups = unit_groups(parameters)
    differences = np.abs(np.asarray(thetas) - np.asarray(target)) / distance_units(parameters)
    asked = [groups[parameters.is_of_interest] == k for k in range(int(groups.max()) + 1)]
    means = [
        differences[..., parameters.is_of_interest][..., one].mean(axis=-1)
        for one in asked
        if one.any()
    ]
    return np.asarray(np.max(means, axis=0))


def distance_units(parameters: Parameters) -> Array:
    """What counts as a distance of 1, shape ``(p,)``: 1 kN, 1 %, or a typical step."""
    is_known = [name.endswith((STIFFNESS_UNIT, STRAIN_UNIT)) for name in parameters.names]
    return np.where(is_known, 1.0, typical_steps(parameters))


def unit_groups(parameters: Parameters) -> IntArray:
    """The same number for parameters of the same kind, shape ``(p,)``: stiffness, strain, other."""
    kinds = [
        0 if name.endswith(STIFFNESS_UNIT) else 1 if name.endswith(STRAIN_UNIT) else 2
        for name in parameters.names
    ]
    return np.asarray(np.unique(kinds, return_inverse=True)[1], dtype=np.int64)


def _on_shell(
    of_group: IntArray,
    center: Array,
    span: Array,
    parameters: Parameters,
    generator: np.random.Generator,
) -> Array:
    """Values of a group's parameters on its shell, inside their bounds."""
    low, high = parameters.lower[of_group], parameters.upper[of_group]
    for _ in range(MAX_DRAWS):
        shares = generator.dirichlet(np.ones(of_group.size)) * of_group.size
        values = center[of_group] + generator.choice([-1.0, 1.0], of_group.size) * shares * span
        if np.all((values >= low) & (values <= high)):
            return np.asarray(values)
    names = ", ".join(parameters.names[i] for i in of_group)
    raise ValueError(
        f"the bounds of {names} leave no room for starts at a distance of "
        f"{float(span.max()):g}; widen the bounds or choose smaller distances"
    )


def _check_number(n: int) -> None:
    if n < 1:
        raise ValueError(f"the number of starts must be at least 1, got {n}")
