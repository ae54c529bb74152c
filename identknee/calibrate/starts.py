"""Starts by name: the paper's four initial guesses, the subject's own values, or a file."""

import os
import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, RootModel

from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.errors import InputError, suggestion
from identknee.runs.schema import Fault, number, read_toml, validated

SUBJECT = "subject"
FILE_LIMIT_MB = 1


def start_names() -> tuple[str, ...]:
    """Names that `named_start` knows.

    Examples
    --------
    >>> start_names()
    ('subject', 'IG1', 'IG2', 'IG3', 'IG4')
    """
    return (SUBJECT, *_published())


def load_start(name_or_path: str | os.PathLike[str], parameters: Parameters) -> Array:
    """Theta of a named start, or of the file whose path ends in ``.toml``, shape ``(n,)``.

    Raises
    ------
    ValueError
        As in `named_start`; `InputError` as in `read_start`.
    """
    if Path(name_or_path).suffix == ".toml":
        return read_start(name_or_path, parameters)
    return named_start(os.fspath(name_or_path), parameters)


def named_start(name: str, parameters: Parameters) -> Array:
    """Theta of a named start, shape ``(n,)``.

    Parameters
    ----------
    name
        ``"subject"`` for the subject's own values, or ``"IG1"`` to ``"IG4"`` for the initial
        guesses of the paper (Table 1), which speak of an ACL, PCL, LCL and MCL. All other
        parameters keep the subject's values.
    parameters
        The parameters of the model.

    Raises
    ------
    ValueError
        If there is no such start, or the model lacks a parameter the start speaks of.
    """
    if name == SUBJECT:
        return parameters.start
    published = _published()
    if name not in published:
        raise ValueError(
            f"there is no start {name!r}; the starts are {', '.join(start_names())} "
            "or the path of a file ending in .toml"
        )
    values = dict(_flat(published[name]))
    missing = [parameter for parameter in values if parameter not in parameters.names]
    if missing:
        owner = parameters.names[0].rpartition(".")[0]
        lacking = list(dict.fromkeys(parameter.rpartition(".")[0] for parameter in missing))
        raise ValueError(
            f"the start {name} speaks of {', '.join(lacking)}, which this knee does not have; "
            "write a start of your own as a TOML file, such as\n"
            f"[{owner}]\nstiffness_kN = 9.5\nreference_strain_pct = 7.5"
        )
    return frozen(parameters.vector(values), parameters.n, name="the start")


def read_start(path: str | os.PathLike[str], parameters: Parameters) -> Array:
    """Theta from a TOML file, shape ``(n,)``; omitted parameters keep the subject's value.

    The file has a table for each ligament, such as::

        [ACL]
        stiffness_kN = 9.5
        reference_strain_pct = 7.5

    Raises
    ------
    InputError
        If the file cannot be read, or has a name that is no parameter's, or a value that is not a
        number within the parameter's bounds.
    """
    file = Path(path)
    values = dict(_flat(read_toml(file, FILE_LIMIT_MB)))
    for name in values:
        if name not in parameters.names:
            raise InputError(
                file, name[:100], "there is no such parameter", suggestion(name, parameters.names)
            )
    start = validated(StartValues, values, lambda fault: _wrong(file, fault, parameters)).root
    for name, value in start.items():
        i = parameters.index(name)
        if not parameters.lower[i] <= value <= parameters.upper[i]:
            why = f"{value:g}{_unit(name)} is out of bounds"
            raise InputError(file, name, why, _allowed(name, parameters))
    return frozen(parameters.vector(start), parameters.n, name="the start")


class StartValues(RootModel[dict[str, Annotated[float, number("{} is not a finite number")]]]):
    """The values of a file of starts by the parameter's name."""

    model_config = ConfigDict(strict=True)


def _wrong(file: Path, fault: Fault, parameters: Parameters) -> InputError:
    name = str(fault.place[0])
    return InputError(file, name, fault.why, _allowed(name, parameters))


def _allowed(name: str, parameters: Parameters) -> str:
    i = parameters.index(name)
    return f"Give a number from {parameters.lower[i]:g} to {parameters.upper[i]:g}{_unit(name)}."


def _unit(name: str) -> str:
    return " " + name.rpartition("_")[2].replace("pct", "%") if "_" in name else ""


def _published() -> dict[str, Any]:
    text = resources.files("identknee.calibrate").joinpath("starts.toml").read_text("utf-8")
    return tomllib.loads(text)


def _flat(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    # Not by recursion: a dotted key of a file may be deeper than that goes.
    waiting = [*table.items()][::-1]
    while waiting:
        name, value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [(f"{name}.{key}", x) for key, x in [*value.items()][::-1]]
        else:
            yield name, value
