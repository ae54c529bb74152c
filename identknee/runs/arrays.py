"""Array types, and the read-only copies that frozen data classes keep of their arguments."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
ReachArray = NDArray[np.uint16]
# Unsigned: compiled code need not ask whether an index counts from the end.
IndexArray = NDArray[np.uint32]
BitArray = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]
# A kilometre: squares and cubes of anything larger may overflow.
FARTHEST_MM = 1e6


def frozen(values: ArrayLike, *shape: int | None, name: str) -> Array:
    """A read-only float64 copy of `values`, its shape checked; what is one is not copied.

    Parameters
    ----------
    values
        Anything numpy can turn into numbers.
    shape
        The lengths wanted, ``None`` where any length will do.
    name
        What to call the values in a message.

    Raises
    ------
    ValueError
        If the values are not numbers or the shape differs.

    Examples
    --------
    >>> frozen([1, 2, 3], 3, name="femur").flags.writeable
    False
    """
    # A read-only array that owns its numbers cannot be changed elsewhere, so no copy is needed.
    if type(values) is np.ndarray and values.base is None and values.dtype.char == "d":
        is_read_only = values.flags.c_contiguous and not values.flags.writeable
        if is_read_only and _fits(values.shape, shape):
            return values
    try:
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must hold numbers only, got {values!r}") from error
    if not _fits(array.shape, shape):
        wanted = " x ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} must have shape {wanted}, got {array.shape}")
    array.flags.writeable = False
    return array


def frozen_integers(values: ArrayLike) -> IntArray:
    """A read-only int64 copy of `values`."""
    array = np.array(values, dtype=np.int64, order="C")
    array.flags.writeable = False
    return array


# Remedy for points that are too far away.
CHECK_UNITS = "check the units and the export"


def implausible_coordinates(points: ArrayLike) -> str:
    """How far points [mm] lie beyond any measurement, in words; empty where none does.

    Examples
    --------
    >>> implausible_coordinates([0.0, 1e9, 0.0])
    '1e+09 mm away, which no measurement is'
    """
    largest = float(np.abs(points).max(initial=0.0))
    if largest <= FARTHEST_MM:
        return ""
    return f"{largest:g} mm away, which no measurement is"


def _fits(actual: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    # Most shapes are wanted to the last length.
    return actual == wanted or (
        len(actual) == len(wanted)
        and all(want is None or have == want for have, want in zip(actual, wanted, strict=True))
    )


# Of a printed record: characters in a line, lines, characters of a value, and items of a list.
WIDTH, MOST_LINES = 88, 25
MOST_LETTERS, MOST_ITEMS = 60, 5


def short_repr(record: Any) -> str:
    """The class of a data class with its fields; arrays by their shape, long lists by their length.

    Examples
    --------
    >>> from identknee.laxity.protocol import dominant_loads, load_protocol
    >>> short_repr(dominant_loads(load_protocol("drawer")))
    'DominantLoads(axis=<array 9>, size=<array 9>)'
    """
    words = [f"{x.name}={_short(getattr(record, x.name))}" for x in fields(record) if x.repr]
    name = type(record).__name__
    line = f"{name}({', '.join(words)})"
    if len(line) <= WIDTH:
        return line
    if len(words) > (room := MOST_LINES - 2):
        words = [*words[: room - 1], f"... {len(words) - room + 1} more fields"]
    return "\n".join([f"{name}(", *(f"    {x}," for x in words), ")"])


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"<array {' x '.join(map(str, value.shape))}>" if value.ndim else f"{value:g}"
    if isinstance(value, Enum):
        return f"{type(value).__name__}.{value.name}"
    if is_dataclass(value):
        name = getattr(value, "name", None)
        return f"<{type(value).__name__}{f' {name}' if isinstance(name, str) else ''}>"
    if isinstance(value, float):
        return f"{value:.6g}"
    text = repr(dict(value) if isinstance(value, Mapping) else value)
    if isinstance(value, Mapping | tuple | list):
        items = value.values() if isinstance(value, Mapping) else value
        is_plain = len(value) <= MOST_ITEMS and not any(map(is_dataclass, items))
        is_short = is_plain and len(text) <= MOST_LETTERS and "\n" not in text
        return text if is_short else f"<{len(value)} entries>"
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 3]}..."
