"""Arrays, and data classes whose fields declare once their meaning, unit, axes and place in files.

Read-only copies of arrays, ``result.json``, ``result.nc``, the way back from both and the page on
result files all follow from these declarations.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import Enum
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar, dataclass_transform

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


ENTRY, DERIVED = "entry", "__entry__"
OF_PARAMETER = "kN or %, as the parameter's name says"
OF_COORDINATE = "mm or deg, as the coordinate's name says"
OF_QUANTITY = "unit of the quantity"
# Names along axes that never differ; packages add theirs with `name_axis`.
AXIS_NAMES: dict[str, tuple[str, ...]] = {"axis": ("x", "y", "z")}
Getter = TypeVar("Getter", bound=Callable[..., Any])
Made = TypeVar("Made")


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Declaration of a field: its meaning, and its place in files.

    Attributes
    ----------
    meaning
        What the field holds, as a phrase with its noun and no full stop.
    unit
        Unit; empty for words, ``"1"`` for plain numbers.
    dims
        Axes of an array; none for everything else.
    dtype
        Type of an array's numbers.
    is_in_json, is_in_arrays
        Whether ``result.json`` and ``result.nc`` have it.
    key
        Its name in files, where that is not the field's.
    group
        Group of ``result.nc`` that holds it and all that stands below it.
    rows
        Axis along which the records of a mapping or tuple are stacked in ``result.nc``.
    only
        When the entry is present; empty where it always is.
    is_inline
        Whether the entries of a record stand among those of the record that holds it.
    words
        What the whole numbers of an array mean, as words; each number is a place among them.
    """

    meaning: str
    unit: str = ""
    dims: tuple[str, ...] = ()
    dtype: type = float
    is_in_json: bool = True
    is_in_arrays: bool = False
    key: str = ""
    group: str = ""
    rows: str = ""
    only: str = ""
    is_inline: bool = False
    words: tuple[str, ...] = ()

    @property
    def meaning_with_unit(self) -> str:
        """The meaning, with the unit in brackets where there is one."""
        return self.meaning if self.unit in ("", "1") else f"{self.meaning} [{self.unit}]"

    @property
    def is_in_files(self) -> bool:
        """Whether either file has it; other fields are for callers in Python only."""
        return self.is_in_json or bool(self.dims or self.group or self.rows)


def entry(
    meaning: str,
    *,
    unit: str = "",
    default: Any = MISSING,
    default_factory: Any = MISSING,
    **where: Any,
) -> Any:
    """Field that holds a number, a word, another record or several; `where` as in `Entry`."""
    metadata = {ENTRY: Entry(meaning=meaning, unit=unit, **where)}
    if default_factory is not MISSING:
        return field(default_factory=default_factory, metadata=metadata)
    return field(default=default, metadata=metadata)


def array(
    meaning: str,
    *dims: str,
    unit: str = "1",
    dtype: type = float,
    default: Any = MISSING,
    **where: Any,
) -> Any:
    """Field that holds a read-only array over named axes, stored in ``result.nc``.

    Arrays of one record that share an axis must agree on its length, also with a tuple of names
    along it; an axis named by a number has that length. Where the default is None the array may be
    missing.
    """
    known = {"dims": dims, "dtype": dtype, "is_in_json": False, "is_in_arrays": True, **where}
    return entry(meaning, unit=unit, default=default, **known)


def derived(meaning: str, **where: Any) -> Callable[[Getter], Getter]:
    """Decorator, below ``@property``, of what ``result.json`` says beside the fields.

    The meaning is the docstring of a property that has no other.
    """

    def mark(getter: Getter) -> Getter:
        about = Entry(meaning=meaning, **where)
        setattr(getter, DERIVED, about)
        getter.__doc__ = getter.__doc__ or f"{about.meaning_with_unit}."
        return getter

    return mark


@dataclass_transform(
    eq_default=False,
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(entry, array, field),
)
def declared(cls: type[Made]) -> type[Made]:
    """A frozen data class, compared by identity, with read-only copies of its arrays and mappings.

    The class's own ``__post_init__`` runs after they are made. The meanings of its entries become
    the section *Attributes* of its docstring, and it prints as `short_repr` says.

    Raises
    ------
    ValueError
        On construction, if an array holds no numbers or does not fit its axes.

    Examples
    --------
    >>> @declared
    ... class Curve:
    ...     "A curve."
    ...     x: np.ndarray = array("Places", "point", unit="mm")
    ...     y: np.ndarray = array("Heights", "point", unit="mm")
    >>> Curve(x=[0, 1], y=[2, 3]).y
    array([2., 3.])
    >>> Curve(x=[0, 1], y=[2])
    Traceback (most recent call last):
    ValueError: y must have shape 2, got (1,)
    """
    own = cls.__dict__.get("__post_init__")

    def complete(self: Any) -> None:
        _freeze(self)
        if own is not None:
            own(self)

    setattr(cls, "__post_init__", complete)  # noqa: B010 - the type has no such attribute
    # Neither read-only arrays nor mappings survive a pickle, and records travel between processes.
    if "__reduce__" not in cls.__dict__:
        setattr(cls, "__reduce__", _reduced)  # noqa: B010
    if cls.__repr__ is object.__repr__:
        setattr(cls, "__repr__", short_repr)  # noqa: B010
    made = dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)(cls)
    lines = []
    for name, about in entries(made).items():
        shape = f", shape ``({', '.join(about.dims)}{',' * (len(about.dims) == 1)})``"
        lines += [name, f"    {about.meaning_with_unit}{shape if about.dims else ''}."]
    text = made.__doc__ or ""
    if lines and "Attributes\n" not in text:
        made.__doc__ = "\n".join([text.rstrip(), "", "Attributes", "----------", *lines, ""])
    return made


def entries(cls: type) -> dict[str, Entry]:
    """The declared fields of a class by name, in their order."""
    return {x.name: x.metadata[ENTRY] for x in fields(cls) if ENTRY in x.metadata}


def derived_entries(cls: type) -> dict[str, Entry]:
    """The declared properties of a class by name, in their order."""
    found = {}
    for owner in reversed(cls.__mro__):
        for name, value in vars(owner).items():
            getter = value.fget if isinstance(value, property) else None
            if hasattr(getter, DERIVED):
                found[name] = getattr(getter, DERIVED)
    return found


def name_axis(dim: str, names: Sequence[str]) -> None:
    """State the names along an axis that are the same in all records."""
    AXIS_NAMES[dim] = tuple(names)


def is_declared(cls: Any) -> bool:
    """Whether a type is a class of declared fields."""
    return _is_declared(cls)


@cache
def _is_declared(cls: Any) -> bool:
    return isinstance(cls, type) and hasattr(cls, "__dataclass_fields__") and bool(entries(cls))


def _reduced(record: Any) -> tuple[Any, ...]:
    values = {x.name: getattr(record, x.name) for x in fields(record) if x.init}
    plain = {k: dict(v) if isinstance(v, MappingProxyType) else v for k, v in values.items()}
    return _made, (type(record), plain)


def _made(cls: Callable[..., Any], values: Mapping[str, Any]) -> Any:
    return cls(**values)


def _freeze(record: Any) -> None:
    kind: Any = type(record)
    # Settings of the mechanics, made dozens of times a simulation, have no arrays over axes.
    if not _has_axes(kind):
        for name in _mappings(kind):
            value = getattr(record, name)
            if type(value) is dict:
                object.__setattr__(record, name, MappingProxyType(value.copy()))
        return
    lengths = {dim: len(names) for dim, names in AXIS_NAMES.items()}
    for name, about, may_miss in _given(kind):
        value = getattr(record, name)
        if about is not None and about.dims and not about.is_in_arrays:
            value = tuple(value)
            object.__setattr__(record, name, value)
        elif about is not None and about.dims:
            if value is None and may_miss:
                continue
            made = _array(name, value, about, lengths)
            lengths |= dict(zip(about.dims, made.shape, strict=True))
            object.__setattr__(record, name, made)
        elif type(value) is dict:
            object.__setattr__(record, name, MappingProxyType(value.copy()))
        lengths |= {dim: len(x) for dim, x in axis_names_within(about, value)}


@cache
def _mappings(cls: Any) -> tuple[str, ...]:
    """Names of the fields that a record is made with and that may hold a mapping."""
    hints = ("dict", "Mapping", "Any")
    return tuple(x.name for x in fields(cls) if x.init and any(y in str(x.type) for y in hints))


@cache
def _given(cls: Any) -> tuple[tuple[str, Entry | None, bool], ...]:
    """Name, entry and whether it may be missing, of each field that a record is made with."""
    return tuple((x.name, x.metadata.get(ENTRY), x.default is None) for x in fields(cls) if x.init)


@cache
def _has_axes(cls: Any) -> bool:
    return any(about is not None and about.dims for _, about, _ in _given(cls))


def axis_names_within(about: Entry | None, value: Any) -> list[tuple[str, tuple[str, ...]]]:
    """Names along axes that a field's value holds: the value itself, or those of a record."""
    if about is not None and about.dims and not about.is_in_arrays:
        return [(about.dims[0], value)]
    kind: Any = type(value)
    if not is_declared(kind):
        return []
    return [
        found
        for name, inner in _without_arrays(kind)
        for found in axis_names_within(inner, getattr(value, name))
    ]


@cache
def _without_arrays(cls: type) -> tuple[tuple[str, Entry], ...]:
    """The entries that may hold names: all but the arrays."""
    return tuple((k, x) for k, x in entries(cls).items() if not (x.dims and x.is_in_arrays))


def _array(name: str, value: Any, about: Entry, lengths: Mapping[str, int]) -> np.ndarray:
    wanted = (int(x) if x.isdigit() else lengths.get(x) for x in about.dims)
    made = frozen(value, *wanted, name=name)
    if about.dtype is float:
        return made
    converted: np.ndarray = made.astype(about.dtype)
    if not np.array_equal(converted, made):
        raise ValueError(f"{name} must hold whole numbers")
    if about.words and not np.all((converted >= 0) & (converted < len(about.words))):
        raise ValueError(f"{name}: a code stands for none of {', '.join(about.words)}")
    converted.flags.writeable = False
    return converted
