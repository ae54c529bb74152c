"""Results declared once: a field's dimensions, unit and meaning, and the files they go to.

Read-only copies of arrays, ``result.json``, ``result.nc``, the way back from both and the page on
result files all follow from these declarations.
"""

import json
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any, TypeVar, dataclass_transform

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, WrapValidator
from pydantic_core import PydanticCustomError

from identknee.runs.arrays import frozen, short_repr
from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import PathLike, check_readable

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
    """What a field holds, and where files have it.

    Attributes
    ----------
    meaning
        What it is, as a phrase with its noun and no full stop.
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
        When it is there, where that is not always.
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
    def is_in_files(self) -> bool:
        """Whether either file has it; what is not, the caller of a verb gets alone."""
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
    known = {"is_in_json": False, "is_in_arrays": True, **where}
    metadata = {ENTRY: Entry(meaning=meaning, unit=unit, dims=dims, dtype=dtype, **known)}
    return field(default=default, metadata=metadata)


def derived(meaning: str, **where: Any) -> Callable[[Getter], Getter]:
    """Decorator, below ``@property``, of what ``result.json`` says beside the fields."""

    def mark(getter: Getter) -> Getter:
        setattr(getter, DERIVED, Entry(meaning=meaning, **where))
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
    _document(made)
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
        lengths |= {dim: len(x) for dim, x in names_within(about, value)}


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


def names_within(about: Entry | None, value: Any) -> list[tuple[str, tuple[str, ...]]]:
    """Names along axes that a field's value holds: the value itself, or those of a record."""
    if about is not None and about.dims and not about.is_in_arrays:
        return [(about.dims[0], value)]
    kind: Any = type(value)
    if not is_declared(kind):
        return []
    return [
        found
        for name, inner in _without_arrays(kind)
        for found in names_within(inner, getattr(value, name))
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


def _document(cls: type) -> None:
    """Append the section *Attributes* from the entries, where the docstring has none."""
    lines = []
    for name, about in entries(cls).items():
        unit = f" [{about.unit}]" if about.unit not in ("", "1") else ""
        shape = f", shape ``({', '.join(about.dims)}{',' * (len(about.dims) == 1)})``"
        lines += [name, f"    {about.meaning}{unit}{shape if about.dims else ''}."]
    text = cls.__doc__ or ""
    if lines and "Attributes\n" not in text:
        cls.__doc__ = "\n".join([text.rstrip(), "", "Attributes", "----------", *lines, ""])


LONGEST_SHOWN = 60
_WANTED = {
    "string_type": "text",
    "bool_type": "true or false",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
}


class Part(BaseModel):
    """A table of a file: its keys and what they hold, nothing converted and nothing beside them."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


Model = TypeVar("Model", bound=BaseModel)
Place = tuple[str | int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """What is wrong first in a file.

    Attributes
    ----------
    place
        Keys and positions that lead to it; to the table that lacks a key.
    key
        The key in question where it is missing or unknown; empty elsewhere.
    is_unknown
        Whether the key is there and should not be.
    why, remedy
        What is wrong, and what to do; remedy empty where only the kind of file knows.
    """

    place: Place
    key: str
    is_unknown: bool = False
    why: str
    remedy: str


def refusal(why: str, remedy: str) -> PydanticCustomError:
    """What a validator raises to have its own words told."""
    # Braces would be read as places to fill in.
    context = {"why": why, "remedy": remedy}
    return PydanticCustomError("said", "{why}", context)


def otherwise(why: str, remedy: str) -> WrapValidator:
    """Words for a value of the wrong form, in place of the general ones.

    Parameters
    ----------
    why, remedy
        What is wrong, where ``{}`` stands for the value, and what to do.
    """

    def check(value: Any, inner: Callable[[Any], Any]) -> Any:
        try:
            return inner(value)
        except ValidationError as error:
            # What is wrong further inside has a better place, and what has words keeps them.
            if any(x["loc"] or x["type"] == "said" for x in error.errors(include_url=False)):
                raise
        raise refusal(why.replace("{}", shown(value)), remedy)

    return WrapValidator(check)


def number(
    wrong: str = "{} is not a number",
    remedy: str = "Write a number without quotes.",
    remedy_infinite: str = "Write the measured value.",
) -> WrapValidator:
    """Words for what is no finite number."""

    def check(value: Any, inner: Callable[[Any], Any]) -> Any:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise refusal(wrong.replace("{}", shown(value)), remedy)
        try:
            is_finite = math.isfinite(value)
        except OverflowError:
            is_finite = False
        if not is_finite:
            raise refusal(f"{shown(value)} is not a finite number", remedy_infinite)
        return inner(value)

    return WrapValidator(check)


Number = Annotated[float, number()]


def read_toml(path: PathLike, limit_mb: float = 512) -> dict[str, Any]:
    """The content of a TOML file.

    Raises
    ------
    InputError
        If it cannot be read, is larger than `limit_mb` [MB], not UTF-8 or no TOML.
    """
    file = check_readable(path, limit_mb)
    try:
        return tomllib.loads(file.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(file, "", "the text is not UTF-8", "Save it as UTF-8.") from error
    except RecursionError as error:
        raise InputError(
            file, "", "this is not TOML: it is nested too deeply", "Correct the file."
        ) from error
    # Dates that are none and numbers of too many digits are no TOMLDecodeError.
    except (ValueError, OverflowError) as error:
        paths = " Write paths with /, on Windows too." * ("\\" in str(error))
        remedy = f"Correct that line.{paths}"
        raise InputError(file, "", f"this is not TOML: {error}", remedy) from error


def read_json(path: PathLike, remedy: str, limit_mb: float = 512) -> Any:
    """The content of a JSON file.

    Raises
    ------
    InputError
        With this remedy, if it cannot be read, is larger than `limit_mb` [MB], no JSON or holds
        text that cannot be written again.
    """
    file = check_readable(path, limit_mb)
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
        json.dumps(values, ensure_ascii=False).encode()
    except RecursionError as error:
        why = "this is not JSON: it is nested too deeply"
        raise InputError(file, "", why, remedy) from error
    # No UTF-8, half of a surrogate pair and numbers of too many digits among them.
    except ValueError as error:
        raise InputError(file, "", "this is not JSON", remedy) from error
    return values


def validated(model: type[Model], values: object, refuse: Callable[[Fault], InputError]) -> Model:
    """`values` as the model; the first fault in them is raised as `refuse` puts it.

    Parameters
    ----------
    model
        The schema.
    values
        What a file holds.
    refuse
        Turns a fault into the error to raise, which names the file and the place in it.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise refuse(_fault(error)) from None


def keys_of(model: type[BaseModel], place: Place) -> tuple[str, ...]:
    """The keys that the schema knows at a place; none where any key may stand.

    Examples
    --------
    >>> class Inner(Part):
    ...     a: Number
    >>> class Outer(Part):
    ...     inner: list[Inner]
    >>> keys_of(Outer, ("inner", 0)), keys_of(Outer, ())
    (('a',), ('inner',))
    """
    found: type[BaseModel] | None = model
    for step in place:
        if isinstance(step, int) or found is None:
            continue
        field = found.model_fields.get(step)
        found = None if field is None else _model_in(field.annotation)
    return () if found is None else tuple(found.model_fields)


def remedy_of(model: type[BaseModel], fault: Fault, examples: Mapping[str, str]) -> str:
    """What to do about a fault: as its validator said, the closest key, or as in an example.

    Parameters
    ----------
    model
        The schema.
    fault
        Fault of one of its files.
    examples
        What to write by key.
    """
    if fault.remedy:
        return fault.remedy
    known = keys_of(model, fault.place)
    if fault.is_unknown:
        return suggestion(fault.key, known)
    name = fault.key or next((x for x in reversed(fault.place) if isinstance(x, str)), "it")
    return f"{'Add' if fault.key else 'Write'} {examples.get(name, name)}."


def shown(value: object) -> str:
    """A value from a file, short enough for a sentence."""
    try:
        text = repr(value)
    # Whole numbers beyond 4300 digits have no text, and some nesting is too deep for one.
    except (ValueError, RecursionError):
        return f"a value too long to show ({type(value).__name__})"
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."


def _fault(error: ValidationError) -> Fault:
    faults = error.errors(include_url=False)
    # A key that is unknown is often the one that is missing, spelled wrongly.
    first = min(faults, key=lambda x: x["type"] != "extra_forbidden")
    kind = first["type"]
    place = tuple(x if isinstance(x, int) else x[:LONGEST_SHOWN] for x in first["loc"])
    if kind in ("extra_forbidden", "missing"):
        key, is_unknown = str(place[-1]), kind == "extra_forbidden"
        why = f"there is no key {shown(key)} here" if is_unknown else f"the key {key!r} is missing"
        return Fault(place=place[:-1], key=key, is_unknown=is_unknown, why=why, remedy="")
    if kind == "said":
        said = first["ctx"]
        return Fault(place=place, key="", why=said["why"], remedy=said["remedy"])
    value = shown(first["input"])
    wanted = _WANTED.get(kind)
    why = f"{value} is not {wanted}" if wanted else f"{value}: {first['msg']}"
    return Fault(place=place, key="", why=why, remedy="")


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The model in a type such as ``list[Model]`` or ``Model | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    parts: Sequence[Any] = getattr(annotation, "__args__", ())
    return next((x for part in parts if (x := _model_in(part)) is not None), None)
