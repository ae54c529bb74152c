"""What a protocol's TOML file may hold, and how a message about it names the place."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import PathLike
from identknee.runs.schema import (
    Fault,
    Part,
    Place,
    number,
    otherwise,
    read_toml,
    refusal,
    remedy_of,
    shown,
    validated,
)

FORMAT = 1
LARGEST_MB = 10
BLOCKS = ("ramps", "trials")

_REMEDIES = {"flexion_deg": "[0, 30]", "values": "[0, 30]"}
Number = Annotated[
    float, number("{} is no number", "Write numbers without quotes.", remedy_infinite="Give one.")
]
Numbers = Annotated[
    list[Number],
    Field(min_length=1),
    otherwise("the list is empty", "Write at least one number."),
    BeforeValidator(lambda x: x if isinstance(x, list) else [x]),
]


def _is_load(value: Any) -> Any:
    if not isinstance(value, str) or value not in HeldLoads.model_fields:
        remedy = suggestion(str(value)[:100], HeldLoads.model_fields)
        raise refusal(f"no load is {shown(value)}", remedy)
    return value


class HeldLoads(Part):
    """Loads by name."""

    internal_moment_Nm: Number = 0.0  # noqa: N815 - the unit
    varus_moment_Nm: Number = 0.0  # noqa: N815
    anterior_force_N: Number = 0.0  # noqa: N815
    distraction_force_N: Number = 0.0  # noqa: N815
    lateral_force_N: Number = 0.0  # noqa: N815


class Ramp(Part):
    """A ``[[ramps]]``."""

    load: Annotated[str, BeforeValidator(_is_load)]
    flexion_deg: Numbers
    values: Numbers
    held: Annotated[
        HeldLoads, otherwise("this is no table", "Write held = { anterior_force_N = 30 }.")
    ] = HeldLoads()


class Trial(HeldLoads):
    """A ``[[trials]]``."""

    flexion_deg: Numbers
    name: Annotated[str, otherwise("the name {} is no text", "Put it in quotes.")] | None = None


_RAMPS, _TRIALS = (
    otherwise("these are no blocks", f"Start each with a line [[{x}]].") for x in BLOCKS
)


class ProtocolTables(Part):
    """The whole of a protocol's file."""

    format: Annotated[
        Literal[1],
        otherwise("the format is {}", f"Write format = {FORMAT}, the only one there is."),
    ]
    name: Annotated[str, otherwise("the name {} is no text", "Put it in quotes.")] | None = None
    description: Annotated[str, otherwise("{} is no text", "Put it in quotes.")] = ""
    ramps: Annotated[list[Annotated[Ramp, _RAMPS]], _RAMPS] = Field(default_factory=list)
    trials: Annotated[list[Annotated[Trial, _TRIALS]], _TRIALS] = Field(default_factory=list)


def read_tables(path: PathLike) -> ProtocolTables:
    """The whole of a protocol's file, against its schema.

    Raises
    ------
    InputError
        If it cannot be read, is no TOML or breaks the schema: it names the place and the remedy.
    """
    file = Path(path)
    return validated(ProtocolTables, read_toml(file, LARGEST_MB), lambda fault: _error(file, fault))


def _error(file: Path, fault: Fault) -> InputError:
    if fault.is_unknown:
        why = f"the word {shown(fault.key)} is unknown here"
        remedy = remedy_of(ProtocolTables, fault, {})
        return InputError(file, _place(fault.place), why, remedy)
    if not fault.key:
        remedy = fault.remedy or "Write it as the documentation of load_protocol says."
        return InputError(file, _place(fault.place), fault.why, remedy)
    place = _place((*fault.place, fault.key))
    if fault.key == "format":
        remedy = f"Write format = {FORMAT}, the only one there is."
        return InputError(file, place, "the format is not given", remedy)
    if fault.key == "load":
        remedy = f"Add one of {', '.join(HeldLoads.model_fields)}."
        return InputError(file, place, "it does not say which load varies", remedy)
    example = _REMEDIES.get(fault.key, "...")
    return InputError(
        file, place, "it is missing", f"Write {fault.key} = {example} or other numbers."
    )


def _place(place: Place) -> str:
    """A place as a person would name it.

    Examples
    --------
    >>> _place(("ramps", 1, "values", 0))
    '[[ramps]] block 2, values'
    """
    steps = list(place)
    if len(steps) > 1 and steps[0] in BLOCKS and isinstance(steps[1], int):
        steps[:2] = [f"[[{steps[0]}]] block {steps[1] + 1}"]
    return ", ".join(x for x in steps if isinstance(x, str))
