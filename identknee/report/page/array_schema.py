"""What the page reads of the arrays of each verb: their axes, and which numbers must be there."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray

from identknee.laxity.protocol import FLEXION, LOADS
from identknee.laxity.table import COORDINATES
from identknee.report.page.summary_parts import LARGEST

Kind = Literal["number", "known", "whole", "text", "name"]
Groups = Mapping[str, xarray.Dataset]


@dataclass(frozen=True, slots=True)
class Wanted:
    """A variable of a group.

    Attributes
    ----------
    kind
        Numbers of which some may be unknown, numbers all known, whole numbers, texts, or names that
        differ from each other.
    axes
        Its dimensions in their order.
    is_optional
        Whether it may be missing.
    """

    kind: Kind
    axes: tuple[str, ...]
    is_optional: bool = False


def _wanted(kind: Kind, *axes: str, is_optional: bool = False) -> Wanted:
    return Wanted(kind, axes, is_optional)


def _names(*axes: str) -> dict[str, Wanted]:
    return {x: _wanted("name", x) for x in axes}


_BY_COORDINATE = _wanted("number", "trial", "coordinate")
SCHEMA: Mapping[str, Mapping[str, Wanted]] = {
    "constant_data": {
        **_names("trial", "load"),
        FLEXION: _wanted("known", "trial"),
        "loads": _wanted("known", "trial", "load"),
    },
    "observed_data": {
        **_names("trial", "coordinate"),
        "coordinates": _BY_COORDINATE,
        "sd": _wanted("number", "trial", "coordinate", is_optional=True),
    },
    "posterior_predictive": {
        **_names("trial", "coordinate", "ligament"),
        "coordinates": _wanted("number", "chain", "draw", "trial", "coordinate"),
        "tension_N": _wanted("number", "chain", "draw", "trial", "ligament"),
    },
}
# These must name the same things in the same order as another group's.
FIXED_NAMES = {"coordinate": COORDINATES}


def array_fault(groups: Groups) -> tuple[str, str] | None:
    """The first place in the arrays that is wrong, and why; None where there is none."""
    return next(_faults(groups), None)


def _faults(groups: Groups) -> Iterator[tuple[str, str]]:
    for name, variables in SCHEMA.items():
        if name not in groups:
            continue
        data = groups[name]
        for key, wanted in variables.items():
            if key not in data.variables:
                if not wanted.is_optional:
                    yield f"group {name}", f"there is no variable {key}"
            elif why := _why(data[key], wanted):
                yield f"group {name}, variable {key}", why
        for axis, known in FIXED_NAMES.items():
            if axis in data.coords and tuple(map(str, data[axis].values)) != known:
                yield f"group {name}, variable {axis}", f"it is not {', '.join(known)}"
    yield from _different_trials(groups)


def _why(array: xarray.DataArray, wanted: Wanted) -> str:
    """What is wrong with a variable; empty where nothing is."""
    if array.dims != wanted.axes:
        return f"its axes are {', '.join(map(str, array.dims)) or 'none'}"
    if wanted.kind in ("text", "name"):
        return _why_no_texts(array, wanted.kind)
    if array.dtype.kind not in ("iu" if wanted.kind == "whole" else "fiu"):
        return f"it holds {array.dtype} and no numbers"
    values = np.asarray(array.values, dtype=np.float64)
    if not values.size:
        return "it is empty"
    if wanted.kind == "known" and not np.isfinite(values).all():
        return "a number is missing"
    if np.isnan(values).all() and wanted.axes[:1] == ("quantity",):
        return "all numbers are missing"
    if (np.abs(values[np.isfinite(values)]) > LARGEST).any():
        return "a number is beyond anything a result holds"
    return ""


def _why_no_texts(array: xarray.DataArray, kind: Kind) -> str:
    values = array.values.tolist()
    if not values:
        return "it is empty"
    if not all(isinstance(x, str) for x in values):
        return f"it holds {array.dtype} and no texts"
    return "it names something twice" if kind == "name" and len(set(values)) < len(values) else ""


def _different_trials(groups: Groups) -> Iterator[tuple[str, str]]:
    constant = groups.get("constant_data")
    if constant is None:
        return
    if set(constant["load"].values) != set(LOADS):
        yield "group constant_data, variable load", f"it is not {', '.join(LOADS)}"
    for name in ("observed_data", "posterior_predictive"):
        if name in groups and not np.array_equal(groups[name]["trial"], constant["trial"]):
            yield f"group {name}, variable trial", "its trials are not those of constant_data"
