"""Files against the schema of their kind: what is wrong first, as one sentence with its remedy."""

import json
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, WrapValidator
from pydantic_core import PydanticCustomError

from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import PathLike, check_readable

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


def custom_message(why: str, remedy: str) -> WrapValidator:
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
