"""Starts by name: the paper's four initial guesses, the subject's own values, or a file."""

import math
import os
import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import check_readable

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
        lacking = list(dict.fromkeys(parameter.rpartition(".")[0] for parameter in missing))
        raise ValueError(
            f"the start {name} speaks of {', '.join(lacking)}, which this knee does not have; "
            "write a start of your own as a TOML file, such as\n"
            f"[{_an_owner(parameters)}]\nstiffness_kN = 9.5\nreference_strain_pct = 7.5"
        )
    return frozen(parameters.vector(values), parameters.n, name="the start")


def read_start(path: str | os.PathLike[str], parameters: Parameters) -> Array:
    """Theta from a TOML file, shape ``(n,)``; what the file leaves out keeps the subject's value.

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
    file = check_readable(path, FILE_LIMIT_MB)
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        remedy = 'Write it as in: [ACL] and below it "stiffness_kN = 9.5".'
        raise InputError(file, "", f"this is not TOML ({error})", remedy) from error
    values = {name: _checked(file, name, value, parameters) for name, value in _flat(table)}
    return frozen(parameters.vector(values), parameters.n, name="the start")


def _checked(file: Path, name: str, value: Any, parameters: Parameters) -> float:
    if name not in parameters.names:
        raise InputError(
            file, name, "there is no such parameter", suggestion(name, parameters.names)
        )
    i = parameters.index(name)
    low, high = parameters.lower[i], parameters.upper[i]
    unit = " " + name.rpartition("_")[2].replace("pct", "%") if "_" in name else ""
    allowed = f"Give a number from {low:g} to {high:g}{unit}."
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(file, name, f"{value!r} is not a finite number", allowed)
    if not low <= value <= high:
        raise InputError(file, name, f"{value:g}{unit} is out of bounds", allowed)
    return float(value)


def _published() -> dict[str, Any]:
    text = resources.files("identknee.calibrate").joinpath("starts.toml").read_text("utf-8")
    return tomllib.loads(text)


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _an_owner(parameters: Parameters) -> str:
    return parameters.names[0].rpartition(".")[0]
