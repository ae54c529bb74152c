"""Declared records as plain JSON values and back, every value checked on the way in."""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from enum import Enum
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import AliasChoices, BaseModel, BeforeValidator, ConfigDict, Field, create_model

from identknee.runs.declare import Entry, derived_entries, entries, is_declared
from identknee.runs.errors import InputError
from identknee.runs.schema import Fault, validated

Made = TypeVar("Made")
_HINTS: dict[Any, dict[str, Any]] = {}
_MODELS: dict[Any, type[BaseModel]] = {}
# A number that is not known is null in a file.
_Float = Annotated[float, BeforeValidator(lambda x: np.nan if x is None else x)]


def to_plain(record: Any) -> dict[str, Any]:
    """Every field of a record by its name, arrays included, for `from_plain`."""
    return {name: plain_value(getattr(record, name)) for name in entries(type(record))}


def plain_value(value: Any) -> Any:
    """A value of a field in types that JSON has, records within it as `to_plain` has them."""
    return _plain(value, to_plain)


def summary_of(record: Any) -> dict[str, Any]:
    """What ``result.json`` says of a record: its fields but the arrays, and derived values."""
    said: dict[str, Any] = {}
    for name, about in (entries(type(record)) | derived_entries(type(record))).items():
        if about.is_inline:
            said |= summary_of(getattr(record, name))
        elif about.is_in_json:
            said[about.key or name] = _plain(getattr(record, name), summary_of)
    return said


def from_plain(
    cls: type[Made], values: Any, refuse: Callable[[Fault], InputError] | None = None
) -> Made:
    """The record that `to_plain` took apart, or one put together from files.

    Parameters
    ----------
    cls
        A class of declared fields.
    values
        Its fields by their names or those they have in files; what is beside them is not read.
    refuse
        Turns a `Fault` into the error to raise.

    Raises
    ------
    InputError
        If a value is missing or of the wrong kind, or as `refuse` has it.
    """
    refuse = refuse or _refuse
    checked = validated(_model(cls), values, refuse)
    try:
        return _built(cls, checked)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise refuse(Fault(place=(), key="", why=str(error), remedy="")) from None


def record_within(hint: Any) -> tuple[type | None, str]:
    """The declared class in a type, and how it stands there: ``one``, ``list``, ``dict`` or none.

    Examples
    --------
    >>> record_within(tuple[int, ...])
    (None, '')
    """
    hint = _without_none(hint)
    if is_declared(hint):
        return hint, "one"
    origin, inner = get_origin(hint), get_args(hint)
    if origin is tuple and inner and is_declared(inner[0]):
        return inner[0], "list"
    if origin is not None and _is_mapping(origin) and is_declared(inner[1]):
        return inner[1], "dict"
    return None, ""


def type_hints_of(cls: Any) -> dict[str, Any]:
    """The types of a class's fields and declared properties by name."""
    if cls not in _HINTS:
        made = {x: get_type_hints(getattr(cls, x).fget)["return"] for x in derived_entries(cls)}
        _HINTS[cls] = get_type_hints(cls) | made
    return _HINTS[cls]


def _refuse(fault: Fault) -> InputError:
    where = "/".join(str(x) for x in (*fault.place, *([fault.key] * bool(fault.key))))
    return InputError("stored result", where, fault.why, fault.remedy or "Compute it again.")


def _plain(value: Any, of_record: Any) -> Any:
    if is_declared(type(value)):
        return of_record(value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {
            str(k.value if isinstance(k, Enum) else k): _plain(v, of_record)
            for k, v in value.items()
        }
    if isinstance(value, tuple | list):
        return [_plain(x, of_record) for x in value]
    return value


def _model(cls: Any) -> type[BaseModel]:
    if cls in _MODELS:
        return _MODELS[cls]
    hints = type_hints_of(cls)
    own_fields = {x.name: x for x in fields(cls)}
    wanted: dict[str, Any] = {}
    for name, about in entries(cls).items():
        own = own_fields[name]
        is_needed = own.default is MISSING and own.default_factory is MISSING
        kind = _kind(hints[name], about)
        known_as = AliasChoices(about.key or name, name)
        field: Any = Field(default=... if is_needed else None, validation_alias=known_as)
        # The name of a field may be one of pydantic's own.
        wanted[f"x_{name}"] = (kind | None if own.default is None else kind, field)
    config = ConfigDict(strict=True, extra="ignore", arbitrary_types_allowed=True)
    _MODELS[cls] = create_model(cls.__name__, __config__=config, **wanted)
    return _MODELS[cls]


def _kind(hint: Any, about: Entry | None = None) -> Any:
    """The type that a schema wants for the type of a field."""
    if about is not None and about.dims and get_origin(_without_none(hint)) is not tuple:
        return Any
    if hint is float:
        return _Float
    if get_origin(hint) in (Union, UnionType):
        return Union[tuple(_member(x) for x in get_args(hint))]  # noqa: UP007
    return _member(hint)


def _member(hint: Any) -> Any:
    if is_declared(hint):
        return _model(hint)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return Annotated[hint, Field(strict=False)]
    origin, inner = get_origin(hint), get_args(hint)
    if origin is tuple:
        several = len(inner) == 2 and inner[1] is Ellipsis
        kinds: Any = (_kind(inner[0]), ...) if several else tuple(_kind(x) for x in inner)
        # Types made while running, which the type checker cannot follow.
        made: Any = tuple
        return Annotated[made[kinds], Field(strict=False)]
    if origin is not None and _is_mapping(origin):
        made = dict
        return made[Annotated[inner[0], Field(strict=False)], _kind(inner[1])]
    return hint


def _built(cls: type[Made], checked: BaseModel) -> Made:
    values = {}
    for name in entries(cls):
        if f"x_{name}" in checked.model_fields_set:
            values[name] = _value(type_hints_of(cls)[name], getattr(checked, f"x_{name}"))
    return cls(**values)


def _value(hint: Any, value: Any) -> Any:
    kind, how = record_within(hint)
    if kind is None or value is None:
        return value
    if how == "one":
        return _built(kind, value)
    if how == "list":
        return tuple(_built(kind, x) for x in value)
    return {name: _built(kind, x) for name, x in value.items()}


def _without_none(hint: Any) -> Any:
    if get_origin(hint) not in (Union, UnionType):
        return hint
    kept = [x for x in get_args(hint) if x is not NoneType]
    return kept[0] if len(kept) == 1 else hint


def _is_mapping(origin: Any) -> bool:
    return isinstance(origin, type) and issubclass(origin, Mapping)
