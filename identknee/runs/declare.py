"""Data classes whose fields declare once their meaning, unit, axes and place in files.

Read-only copies of arrays, ``result.json``, ``result.nc``, the way back from both and the page on
result files all follow from these declarations.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar, dataclass_transform

import numpy as np

from identknee.runs.arrays import frozen, short_repr

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
