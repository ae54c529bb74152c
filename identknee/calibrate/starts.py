"""Starts by name: the paper's four initial guesses, the subject's own values, or a file."""

import os
import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, RootModel

from identknee.calibrate.doubts import APART
from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.problem import Problem, typical_steps
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import Fault, declared, number, read_toml, validated
from identknee.runs.errors import InputError, suggestion
from identknee.runs.findings import Finding, Severity
from identknee.runs.outcome import Outcome
from identknee.runs.words import either

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


# Share of the objective, and objective: ends that are the same, also where a search stops early.
ALIKE, ROUNDING = 1e-3, 1e-9


@declared
class SecondSearch:
    """Where least squares from another start ended.

    Attributes
    ----------
    name
        Name of the start, as for `identknee.calibrate.starts.named_start`.
    first, second
        The doubtful fit, and the one from this start.
    """

    name: str
    first: Fit
    second: Fit

    @property
    def is_better(self) -> bool:
        """Whether the second search ended at a lower misfit."""
        first, second = self.first.objective, self.second.objective
        return self.second.outcome is not Outcome.START_FAILED and second < first - _alike(first)

    @property
    def finding(self) -> Finding:
        """Whether both agree, as a sentence."""
        first, second = self.first.objective, self.second.objective
        ended = f"a second search, least squares from {self.name}, ended"
        if self.second.outcome is Outcome.START_FAILED:
            return _on_starts(
                Severity.INFO, f"No second search: at {self.name} there is no prediction either."
            )
        objectives = f"(objective {second:.4g}, here {first:.4g})"
        if self.is_better:
            return _on_starts(
                Severity.ERROR,
                f"Starts disagree: {ended} at a lower misfit {objectives}, so this fit is not the "
                "best. identknee sweep tries many starts.",
            )
        if second > first + _alike(first):
            return _on_starts(
                Severity.WARNING,
                f"Starts disagree: {ended} at a higher misfit {objectives}. identknee sweep tries "
                "many starts.",
            )
        steps = typical_steps(self.first.parameters)
        if float(np.max(np.abs(self.second.theta - self.first.theta) / steps)) > APART:
            return _on_starts(
                Severity.WARNING,
                f"Starts disagree: {ended} at the same misfit with other parameters "
                f"({self._farthest()}). See: identknee profile",
            )
        return _on_starts(
            Severity.INFO,
            f"{ended[0].upper()}{ended[1:]} at the same parameters: the start is not the reason.",
        )

    def _farthest(self) -> str:
        parameters = self.first.parameters
        steps = typical_steps(parameters)
        i = int(np.argmax(np.abs(self.second.theta - self.first.theta) / steps))
        return either(parameters.names[i], self.first.theta[i], self.second.theta[i])


def _alike(objective: float) -> float:
    return ALIKE * objective + ROUNDING


def second_search(problem: Problem, first: Fit) -> SecondSearch:
    """Least squares from the first named start that is not the one of a fit.

    Parameters
    ----------
    problem
        That of the fit.
    first
        The fit; its fixed parameters and its priors are kept.
    """
    name, start = _other_start(first)
    second = fit(problem, start, seed=first.seed, fixed=first.fixed, priors=first.priors)
    return SecondSearch(name=name, first=first, second=second)


def _other_start(first: Fit) -> tuple[str, Array]:
    """A start by name with a free parameter elsewhere; the middle of the bounds failing that."""
    parameters = first.parameters
    free = parameters.with_fixed(first.fixed, first.start)
    for name in start_names():
        try:
            guess = named_start(name, parameters)
        except ValueError:
            # The guesses of the paper speak of four ligaments that a knee need not have.
            continue
        start = free.expand(free.restrict(np.clip(guess, parameters.lower, parameters.upper)))
        if not np.allclose(start, first.start):
            return name, start
    middle = 0.5 * (parameters.lower + parameters.upper)
    return "the middle of the bounds", free.expand(free.restrict(middle))


def _on_starts(severity: Severity, sentence: str) -> Finding:
    return Finding(severity=severity, sentence=sentence, where="starts")
