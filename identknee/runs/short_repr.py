"""What a record prints as: its fields, long ones by their size, on one screen at most."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

WIDTH, MOST_LINES = 88, 25
MOST_LETTERS, MOST_ITEMS = 60, 5


def short_repr(record: Any) -> str:
    """The class of a data class with its fields; arrays by their shape, long lists by their length.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> short_repr(load_protocol("drawer"))
    "Protocol(name='drawer', trials=<9 entries>, flexion_deg=<array 9>, loads=<array 9 x 5>)"
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
    if isinstance(value, Mapping | tuple | list):
        return _few(value)
    text = repr(value)
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 3]}..."


def _few(values: Any) -> str:
    text = repr(dict(values) if isinstance(values, Mapping) else values)
    items = values.values() if isinstance(values, Mapping) else values
    is_plain = len(values) <= MOST_ITEMS and not any(map(is_dataclass, items))
    is_short = is_plain and len(text) <= MOST_LETTERS and "\n" not in text
    return text if is_short else f"<{len(values)} entries>"
