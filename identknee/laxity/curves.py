"""Mean loading curves from time series of ramped loads, loops of loading and unloading included."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from identknee.laxity.dominant import DIRECTIONS, SAME_FLEXION_DEG, STRAY, TYPICAL
from identknee.runs.arrays import Array
from identknee.runs.errors import InputError

TIME = "time_s"
LEVELS = (50.0, 100.0)  # % of the load that every ramp reaches
# A load turns where it goes back by this share of its range: less is noise of a sensor.
TURN = 0.2
# A second load that is ramped by this share of the first, both beside a usual test's, is a test.
SECOND = 0.5
# A loop narrower than this is one that no sensor resolves [mm, deg].
LEAST_SD = 1e-3


def mean_curves(
    path: Path, ramps: Sequence[str], samples: Array, levels: Sequence[float] = LEVELS
) -> tuple[tuple[str, ...], Array]:
    """Trials of a laxity table from samples over time: their names and rows.

    The load of a ramp that changes most is the one that it is about. Each way that it goes, up or
    down, crosses a level of it once: a row has the mean of all crossings. Its standard deviations
    are the spread of the crossings about these means, over all levels of the ramp, so that half a
    loop's width and what differs from one cycle to the next are errors. A ramp that crosses each
    level once has those of the others.

    Parameters
    ----------
    path
        The file, for messages.
    ramps
        The ramp that each sample belongs to.
    samples
        Time, flexion, loads and coordinates, shape ``(n, 12)``; NaN where not measured.
    levels
        Levels of the load [% of what every cycle reaches].

    Returns
    -------
    names, rows
        The trials, and flexion, loads, coordinates and standard deviations, shape ``(k, 16)``; NaN
        where no ramp crosses a level twice.

    Raises
    ------
    InputError
        If time goes back, no load of a ramp is ramped or two are, or flexion changes.
    """
    names: list[str] = []
    rows: list[Array] = []
    spreads: list[Array] = []
    for ramp in dict.fromkeys(ramps):
        own = samples[[i for i, x in enumerate(ramps) if x == ramp]]
        axis = _ramped(path, ramp, own)
        crossed = _crossings(own[:, 1:], axis, levels)
        deviations = [x - x.mean(axis=0) for _, x in crossed]
        n_free = sum(len(x) - 1 for x in deviations)
        squares = sum((x**2).sum(axis=0) for x in deviations)
        for load, values in crossed:
            rows.append(values.mean(axis=0))
            rows[-1][1 + axis] = load
            names.append(_name(ramp, axis, load))
        spreads += [squares / n_free if n_free else np.full(11, np.nan)] * len(crossed)
    variance = np.array(spreads)[:, 6:]
    has_one = np.asarray(np.isfinite(variance).any(axis=1))
    typical = variance[has_one].mean(axis=0) if has_one.any() else np.nan
    sd = np.sqrt(np.where(has_one[:, None], variance, typical))
    return tuple(names), np.hstack([rows, np.maximum(sd, LEAST_SD)])


def _ramped(path: Path, ramp: str, samples: Array) -> int:
    """Place of the load that a ramp is about."""
    where = f"ramp {ramp}"
    if (np.diff(samples[:, 0]) < 0.0).any():
        why, remedy = "time goes back", "Give each ramp a name of its own in a column trial."
        raise InputError(path, where, why, remedy)
    changes = np.ptp(samples[:, 1:7], axis=0)
    if changes[0] > SAME_FLEXION_DEG:
        why = f"flexion changes by {changes[0]:.1f} deg"
        remedy = "Give one flexion angle a ramp, named in a column trial."
        raise InputError(path, where, why, remedy)
    shares = changes[1:] / TYPICAL
    second, first = (int(x) for x in np.argsort(shares)[-2:])
    if shares[first] < STRAY:
        why = f"no load changes by more than {100 * STRAY:.0f} % of a usual test's"
        raise InputError(path, where, why, "Give the samples while a load grows.")
    if shares[second] > SECOND * shares[first]:
        words = " and ".join(f"{DIRECTIONS[x][0]} ({changes[1 + x]:.3g})" for x in (first, second))
        why, remedy = f"two loads change: {words}", "Name each load's ramp in a column trial."
        raise InputError(path, where, why, remedy)
    return first


def _crossings(values: Array, axis: int, levels: Sequence[float]) -> list[tuple[float, Array]]:
    """Each level of the load, and the values where it is crossed, one row a crossing."""
    load = values[:, 1 + axis]
    ends = _turns(load)
    found = []
    for sign in (-1.0, 1.0):
        farthest = sign * load[ends]
        top = farthest.max()
        if top < STRAY * np.ptp(load):
            continue
        reached = farthest[farthest > 0.5 * top].min()
        for level in levels:
            at = sign * reached * level / 100.0
            rows = [
                _at(values[i : j + 1], axis, at)
                for i, j in itertools.pairwise(ends)
                if min(load[i], load[j]) <= at <= max(load[i], load[j])
            ]
            if rows:
                found.append((at, np.array(rows)))
    return found


def _turns(load: Array) -> list[int]:
    """Samples at which the load turns, the first and the last among them."""
    least = TURN * np.ptp(load)
    ends, low, high = [0], 0, 0
    way = 0
    for i, value in enumerate(load.tolist()):
        low, high = (i if value < load[low] else low), (i if value > load[high] else high)
        if way >= 0 and value < load[high] - least:
            ends += [high] if high > ends[-1] else []
            way, low, high = -1, i, i
        elif way <= 0 and value > load[low] + least:
            ends += [low] if low > ends[-1] else []
            way, low, high = 1, i, i
    last = low if way < 0 else high
    return [*ends, last] if last > ends[-1] else ends


def _at(branch: Array, axis: int, load: float) -> Array:
    """The values of one way of the load where it crosses `load`, shape ``(11,)``."""
    order = np.argsort(branch[:, 1 + axis], kind="stable")
    along = branch[order, 1 + axis]
    made = [
        np.interp(load, along[known], column[known])
        if (known := ~np.isnan(column)).any()
        else np.nan
        for column in branch[order].T
    ]
    return np.array(made)


def _name(ramp: str, axis: int, load: float) -> str:
    """The ramp, then the load as in ``rotation internal 5 N m``."""
    word = DIRECTIONS[axis][0 if load > 0.0 else 1].split()[0]
    return f"{ramp}_{word}{abs(load):.3g}"
