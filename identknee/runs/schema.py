"""Files and stored records against their schema: the first fault as a sentence with its remedy."""

import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from enum import Enum
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    WrapValidator,
    create_model,
)
from pydantic_core import PydanticCustomError

from identknee.runs.declare import Entry, derived_entries, entries, is_declared
from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import BACKSLASH, PathLike, check_readable

LONGEST_SHOWN = 60
# Largest JSON file that is read.
LARGEST_JSON_MB = 512
# What a value should be, by pydantic's type of error.
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
    """A table of a file: its keys and their types; no value is converted, no other key accepted."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


Model = TypeVar("Model", bound=BaseModel)
Place = tuple[str | int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """The first fault found in a file.

    Attributes
    ----------
    place
        Keys and positions that lead to the value, or to the table that lacks a key.
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
    """The error by which a validator states its own message and remedy."""
    # Braces would be read as places to fill in.
    return PydanticCustomError("said", "{why}", {"why": why, "remedy": remedy})


def custom_message(why: str, remedy: str) -> WrapValidator:
    """A message for values of the wrong form, in place of the general one.

    Parameters
    ----------
    why, remedy
        What is wrong, where ``{}`` stands for the value, and what to do.
    """

    def check(value: Any, inner: Callable[[Any], Any]) -> Any:
        try:
            return inner(value)
        except ValidationError as error:
            # A fault further inside has a more exact place, and a message of its own is kept.
            if any(x["loc"] or x["type"] == "said" for x in error.errors(include_url=False)):
                raise
        raise refusal(why.replace("{}", shown(value)), remedy)

    return WrapValidator(check)


def number(
    wrong: str = "{} is not a number",
    remedy: str = "Write a number without quotes.",
    remedy_infinite: str = "Write the measured value.",
) -> WrapValidator:
    """A message for values that are not finite numbers."""

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
        If it cannot be read, is larger than `limit_mb` [MB], not UTF-8 or not TOML.
    """
    file = check_readable(path, limit_mb)
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(file, "", "the text is not UTF-8", "Save it as UTF-8.") from error
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise InputError(
            file, "", "this is not TOML: it is nested too deeply", "Correct the file."
        ) from error
    # Impossible dates and numbers of too many digits raise other errors than TOMLDecodeError.
    except (ValueError, OverflowError) as error:
        if found := _backslash(text, str(error)):
            line, within = found
            why = f'the backslash in "{within}" begins a special character between double quotes'
            raise InputError(file, f"line {line}", why, BACKSLASH) from error
        raise InputError(file, "", f"this is not TOML: {error}", "Correct that line.") from error


def _backslash(text: str, error: str) -> tuple[int, str] | None:
    """Line at which a TOML text breaks off, and the text in double quotes with a backslash there.

    None where there is no such text. A backslash before the last quote makes the parser go on.
    """
    place = re.search(r"at line (\d+)", error)
    lines = text.splitlines()
    number = int(place[1]) if place else len(lines)
    row = lines[number - 1] if 0 < number <= len(lines) else ""
    # What stands between single quotes keeps its backslashes.
    quoted = re.search(r'"([^"\n]*\\[^"\n]*)"?', re.sub(r"'[^'\n]*'", "", row))
    return (number, quoted[1][:LONGEST_SHOWN]) if quoted else None


def read_json(path: PathLike, remedy: str) -> Any:
    """The content of a JSON file.

    Raises
    ------
    InputError
        With this remedy, if it cannot be read, is larger than 512 MB, is not JSON, or holds text
        that cannot be written again.
    """
    file = check_readable(path, LARGEST_JSON_MB)
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
        json.dumps(values, ensure_ascii=False).encode()
    except RecursionError as error:
        why = "this is not JSON: it is nested too deeply"
        raise InputError(file, "", why, remedy) from error
    # Including text that is not UTF-8, half of a surrogate pair, and numbers of too many digits.
    except ValueError as error:
        raise InputError(file, "", "this is not JSON", remedy) from error
    return values


def validated(model: type[Model], values: object, refuse: Callable[[Fault], InputError]) -> Model:
    """`values` as an instance of the model; the first fault in them is raised by `refuse`.

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
        faults = error.errors(include_url=False)
    # A key that is unknown is often the one that is missing, spelled wrongly.
    first = min(faults, key=lambda x: x["type"] != "extra_forbidden")
    kind = first["type"]
    place = tuple(x if isinstance(x, int) else x[:LONGEST_SHOWN] for x in first["loc"])
    if kind in ("extra_forbidden", "missing"):
        key, is_unknown = str(place[-1]), kind == "extra_forbidden"
        why = f"there is no key {shown(key)} here" if is_unknown else f"the key {key!r} is missing"
        fault = Fault(place=place[:-1], key=key, is_unknown=is_unknown, why=why, remedy="")
    elif kind == "said":
        fault = Fault(place=place, key="", **first["ctx"])
    else:
        value, wanted = shown(first["input"]), _WANTED.get(kind)
        why = f"{value} is not {wanted}" if wanted else f"{value}: {first['msg']}"
        fault = Fault(place=place, key="", why=why, remedy="")
    raise refuse(fault)


def known_keys(model: type[BaseModel], place: Place) -> tuple[str, ...]:
    """The keys that the schema knows at a place; none where any key may stand.

    Examples
    --------
    >>> class Inner(Part):
    ...     a: Number
    >>> class Outer(Part):
    ...     inner: list[Inner]
    >>> known_keys(Outer, ("inner", 0)), known_keys(Outer, ())
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
    """Remedy of a fault: that of its validator, the closest known key, or an example."""
    if fault.remedy:
        return fault.remedy
    known = known_keys(model, fault.place)
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


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The model in a type such as ``list[Model]`` or ``Model | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    parts: Sequence[Any] = getattr(annotation, "__args__", ())
    return next((x for part in parts if (x := _model_in(part)) is not None), None)


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
    cls: type[Made],
    values: Any,
    *,
    file: PathLike = "stored result",
    remedy: str = "Compute it again.",
) -> Made:
    """The record that `to_plain` took apart, or one put together from files.

    Parameters
    ----------
    cls
        A class of declared fields.
    values
        Its fields by their names or those they have in files; what is beside them is not read.
    file, remedy
        Where they were read from, and what to do if they are wrong.

    Raises
    ------
    InputError
        If a value is missing or of the wrong kind.
    """

    def refuse(fault: Fault) -> InputError:
        where = "/".join(str(x) for x in (*fault.place, *([fault.key] * bool(fault.key))))
        return InputError(file, where, fault.why, fault.remedy or remedy)

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
