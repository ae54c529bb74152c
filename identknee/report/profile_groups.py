"""Profiles as xarray datasets and as the words of a summary."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray

from identknee.identify.profile.pairs import PairProfile
from identknee.identify.profile.result import Interval, Profile, Side
from identknee.runs.arrays import Array

# Nested sets beside the profile's own.
LEVELS = (0.5, 0.8, 0.9)
PAIR_LEVELS = (0.5, 0.8)


def profile_groups(
    profiles: Sequence[Profile], parameters: Sequence[str], pairs: Sequence[PairProfile] = ()
) -> dict[str, xarray.Dataset]:
    """Groups ``profile`` (the curves), ``ci`` (the sets) and, where asked, ``profile_pairs``.

    Parameters
    ----------
    profiles
        Of any quantities, over the same parameters.
    parameters
        Names of the parameters.
    pairs
        Of two parameters at once, all of one level.
    """
    groups = {"profile": _curves(profiles, parameters), "ci": _sets(profiles)}
    if pairs:
        groups["profile_pairs"] = _pairs(pairs)
    return groups


def profile_summary(profile: Profile) -> dict[str, Any]:
    """What ``result.json`` says of one profile; an open end is null."""
    return {
        "value": profile.optimum_value,
        "unit": profile.unit,
        "lower": profile.lower,
        "upper": profile.upper,
        "lower_status": profile.lower_status,
        "upper_status": profile.upper_status,
        "verdict": profile.verdict,
        "sentence": profile.verdict.sentence,
        "intervals": profile.intervals,
        "level": profile.level,
        "threshold": profile.threshold,
        "practical_level": profile.practical_level,
        "n_simulations": profile.n_simulations,
        "n_points": len(profile.values),
        "n_restarts": profile.n_restarts,
        "lower_side": _side(profile.lower_side),
        "upper_side": _side(profile.upper_side),
    }


def pair_summary(pair: PairProfile) -> dict[str, Any]:
    """What ``result.json`` says of one pair; null where a way meets no end."""
    return {
        "parameters": pair.names,
        "level": pair.level,
        "threshold": pair.threshold,
        "edge": pair.contour(pair.level),
        "statuses": [ray.status for ray in pair.rays],
        "n_simulations": pair.n_simulations,
    }


def nested(profile: Profile) -> dict[float, tuple[Interval, ...]]:
    """Sets of likely values by level, from low levels to the profile's own."""
    levels = [x for x in LEVELS if x < profile.level]
    return {level: profile.intervals_at(level) for level in (*levels, profile.level)}


def _side(side: Side) -> dict[str, Any]:
    return {
        "sentence": side.sentence,
        "error": side.error,
        "reached": side.reached,
        "max_deviance": side.max_deviance,
        "at_bounds": side.at_bounds,
    }


def _curves(profiles: Sequence[Profile], parameters: Sequence[str]) -> xarray.Dataset:
    length = max((len(x.values) for x in profiles), default=0)
    dims = ("quantity", "point")

    def padded(of: Callable[[Profile], Array]) -> Array:
        rows = [np.asarray(of(x), dtype=np.float64) for x in profiles]
        shape = (len(profiles), length, *rows[0].shape[1:]) if rows else (0, length)
        whole = np.full(shape, np.nan)
        for row, filled in zip(whole, rows, strict=True):
            row[: len(filled)] = filled
        return whole

    return xarray.Dataset(
        {
            "value": (dims, padded(lambda x: x.values)),
            "delta_deviance": (dims, padded(lambda x: x.deltas)),
            "nll": (dims, padded(lambda x: 0.5 * (x.deviance + x.deltas))),
            "z": (dims, padded(lambda x: x.z)),
            "slope": (dims, padded(lambda x: x.slopes)),
            "branch": (dims, padded(lambda x: x.branches.astype(np.float64))),
            "theta": ((*dims, "parameter"), padded(lambda x: x.thetas)),
            "n_eval": ("quantity", [x.n_simulations for x in profiles]),
            "threshold": ("quantity", [x.threshold for x in profiles]),
            "optimum": (("quantity", "parameter"), np.array([x.optimum for x in profiles])),
            "optimum_value": ("quantity", [x.optimum_value for x in profiles]),
        },
        coords={
            "quantity": [x.name for x in profiles],
            "unit": ("quantity", [x.unit for x in profiles]),
            "parameter": list(parameters),
        },
        attrs={"padding": "NaN where a profile has fewer points"},
    )


def _sets(profiles: Sequence[Profile]) -> xarray.Dataset:
    most = max((len(x.intervals) for x in profiles), default=0)
    ends = np.full((len(profiles), most, 2), np.nan)
    for row, profile in zip(ends, profiles, strict=True):
        for place, interval in zip(row, profile.intervals, strict=False):
            place[:] = [_number(x) for x in interval]
    sides: Mapping[str, Callable[[Profile], Side]] = {
        "lower": lambda x: x.lower_side,
        "upper": lambda x: x.upper_side,
    }
    variables: dict[str, Any] = {
        "interval": (("quantity", "interval_number", "end"), ends),
        "verdict": ("quantity", [x.verdict.value for x in profiles]),
        "practical_level": ("quantity", [x.practical_level for x in profiles]),
        "level": ("quantity", [x.level for x in profiles]),
        "nested": (("quantity", "nested_level", "end"), _nested_ends(profiles)),
    }
    for name, side in sides.items():
        found = [side(x) for x in profiles]
        variables |= {
            name: ("quantity", [_number(x.end) for x in found]),
            f"{name}_open": ("quantity", [x.end is None for x in found]),
            f"{name}_status": ("quantity", [x.status.value for x in found]),
            f"{name}_error": ("quantity", [x.error for x in found]),
            f"{name}_reached": ("quantity", [x.reached for x in found]),
            f"{name}_max_deviance": ("quantity", [x.max_deviance for x in found]),
        }
    return xarray.Dataset(
        variables,
        coords={
            "quantity": [x.name for x in profiles],
            "unit": ("quantity", [x.unit for x in profiles]),
            "nested_level": list(LEVELS),
            "end": ["lower", "upper"],
        },
        attrs={"method": "profile likelihood", "open": "NaN"},
    )


def _nested_ends(profiles: Sequence[Profile]) -> Array:
    """The outermost ends at each of `LEVELS` below the profile's, shape ``(n, levels, 2)``."""
    ends = np.full((len(profiles), len(LEVELS), 2), np.nan)
    for row, profile in zip(ends, profiles, strict=True):
        for place, level in zip(row, LEVELS, strict=True):
            if level < profile.level:
                intervals = profile.intervals_at(level)
                # A profile that ended early may know no value as likely as that.
                if intervals:
                    place[:] = [_number(intervals[0][0]), _number(intervals[-1][1])]
    return ends


def _pairs(pairs: Sequence[PairProfile]) -> xarray.Dataset:
    levels = [*(x for x in PAIR_LEVELS if x < pairs[0].level), pairs[0].level]
    edges = np.array([[pair.contour(level) for level in levels] for pair in pairs])
    return xarray.Dataset(
        {
            "edge": (("pair", "level", "ray", "member"), edges),
            "optimum": (("pair", "member"), np.array([x.optimum for x in pairs])),
            "reached": (("pair", "ray", "member"), [[r.end for r in x.rays] for x in pairs]),
            "status": (("pair", "ray"), [[r.status.value for r in x.rays] for x in pairs]),
            "n_eval": ("pair", [x.n_simulations for x in pairs]),
        },
        coords={
            "pair": [" and ".join(x.names) for x in pairs],
            "first": ("pair", [x.names[0] for x in pairs]),
            "second": ("pair", [x.names[1] for x in pairs]),
            "level": levels,
        },
        attrs={"open": "NaN where a way from the optimum reaches a bound first"},
    )


def _number(end: float | None) -> float:
    return np.nan if end is None else end
