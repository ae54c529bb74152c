"""Arguments of a call from Python as a verb takes them: tables in memory, single names, numbers."""

import inspect
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

from identknee.calibrate.fit import StartLike
from identknee.laxity.data_frame import NAME as FRAME
from identknee.laxity.data_frame import Frame, is_frame
from identknee.laxity.experiment_tables import is_experiments
from identknee.laxity.named_tables import TABLES
from identknee.laxity.protocol import BUILT_IN, Protocol
from identknee.laxity.table import TABLE_FILES, Laxity, read_laxity
from identknee.runs.errors import ValueRefused
from identknee.subject.examples import named_subject
from identknee.subject.folder import FILE
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.values import noise_words

SUBJECT, DATA, PROTOCOL = "subject", "data", "protocol"
SUBJECT_FILES = (".toml", ".osim")
# The types that sizes of noise may have, and no other option has together.
NOISE = frozenset({str, float, tuple[float, float]})
# Those of a start.
START = frozenset(get_args(StartLike))
ORDER = "give the subject first and the laxity table second"


def read_arguments(
    parameters: Mapping[str, inspect.Parameter], arguments: Mapping[str, Any]
) -> dict[str, Any]:
    """The arguments of a verb: data frames read, one name as a list of one, noise with its units.

    Parameters
    ----------
    parameters
        Those of the verb, annotated with their options.
    arguments
        What was given for each.

    Raises
    ------
    ValueError
        If subject and data have changed places, or either is of another kind.
    """
    _check_places(arguments)
    return {x: _as_taken(x, parameters[x].annotation, given) for x, given in arguments.items()}


def _as_taken(name: str, annotation: Any, given: Any) -> Any:
    """One argument."""
    kinds = _kinds(annotation)
    if name == DATA and isinstance(given, list | tuple):
        tables = [_as_taken(name, annotation, x) for x in given]
        return tables[0] if len(tables) == 1 else _numbered(tables) or None
    if kinds >= START:
        return _start(given)
    if is_frame(given) and (name == DATA or Frame in kinds):
        return read_laxity(given, is_measured=name == DATA)
    if Sequence[str] in kinds and str not in kinds:
        return _names(given)
    return noise_words(given) if kinds >= NOISE else given


def _numbered(tables: Sequence[Any]) -> list[Any]:
    """The tables, data frames with a number in their names, which are the same."""
    named, found = 0, []
    for x in tables:
        if isinstance(x, Laxity) and x.protocol.name == FRAME:
            named += 1
            x = replace(x, protocol=replace(x.protocol, name=f"{FRAME}{named}"))
        found.append(x)
    return found


def _start(given: Any) -> Any:
    """Where fits start: values of an answer or of a pandas series as a dictionary."""
    if isinstance(given, Answer) and given.parameter_set is not None:
        errors = {x.name for x in given.nuisances}
        return {name: x for name, x in given.parameter_set.items() if name not in errors}
    if hasattr(given, "to_dict") and hasattr(given, "index"):
        return given.to_dict()
    if given is None or isinstance(given, str | os.PathLike | Mapping):
        return given
    raise ValueRefused(
        f"{_shown(given)} is no start",
        "give subject, IG1 to IG4, a file ending in .toml or a dictionary of values by parameter, "
        "such as {'ACL.stiffness_kN': 9.5}",
    )


def _kinds(annotation: Any) -> frozenset[Any]:
    """The types that an option may have."""
    plain = get_args(annotation)[0]
    return frozenset(get_args(plain) or (plain,))


def _names(given: Any) -> Any:
    """Names as a sequence: one name as one of them, an array or an index of them as a list."""
    if isinstance(given, str):
        return (given,)
    is_listed = given is None or isinstance(given, list | tuple | Mapping)
    return given if is_listed or not isinstance(given, Iterable) else [str(x) for x in given]


def _check_places(arguments: Mapping[str, Any]) -> None:
    """Refuse a table where the subject belongs, and a subject where the table does."""
    if SUBJECT not in arguments:
        return
    data = arguments.get(DATA)
    for one in data if isinstance(data, list | tuple) and data else [data]:
        _check_place(arguments, one)


def _check_place(arguments: Mapping[str, Any], data: Any) -> None:
    """The same for one of the tables."""
    subject = arguments[SUBJECT]
    if _is_protocol(subject):
        is_exchanged = _is_subject(arguments.get(PROTOCOL))
        raise ValueRefused(
            f"{_shown(subject)} is a protocol"
            + (
                ": subject and protocol have changed places"
                if is_exchanged
                else " where the subject belongs"
            ),
            "give the subject first, such as reference",
        )
    if _is_table(subject):
        if DATA in arguments and (data is None or _is_subject(data)):
            mistake = (
                "subject and data have changed places" if data is not None else "it is the data"
            )
            raise ValueRefused(f"{_shown(subject)} is a laxity table: {mistake}", ORDER)
        raise ValueRefused(
            f"{_shown(subject)} is a laxity table where the subject belongs",
            "give a subject folder, a Knee or a name such as reference",
        )
    if not isinstance(subject, Knee | str | os.PathLike):
        raise ValueRefused(
            f"{_shown(subject)} is no subject",
            "give a subject folder, a Knee or a name such as reference",
        )
    if data is not None and _is_subject(data):
        raise ValueRefused(f"{_shown(data)} is a subject where the laxity table belongs", ORDER)
    if data is not None and not (_is_table(data) or isinstance(data, str | os.PathLike)):
        raise ValueRefused(
            f"{_shown(data)} is no laxity table",
            "give a path, a Laxity, a pandas DataFrame or the name of a subject with a table",
        )


def _is_table(given: Any) -> bool:
    """Whether this can only be laxity."""
    if isinstance(given, str | os.PathLike):
        path = Path(given)
        is_table = path.suffix.lower() in TABLE_FILES and not path.is_dir()
        return is_table or is_experiments(path)
    return isinstance(given, Laxity) or is_frame(given)


def _is_protocol(given: Any) -> bool:
    """Whether this can only be trials to make."""
    if isinstance(given, str):
        return given in BUILT_IN and not Path(given).exists()
    return isinstance(given, Protocol)


def _is_subject(given: Any) -> bool:
    """Whether this can only be a subject."""
    if not isinstance(given, str | os.PathLike):
        return isinstance(given, Knee)
    if given in TABLES:
        return False
    path = Path(given)
    is_toml = path.suffix.lower() in SUBJECT_FILES and not is_experiments(path)
    is_file = is_toml or (path / FILE).is_file()
    return is_file or named_subject(given) is not None


def _shown(given: Any) -> str:
    if isinstance(given, str | os.PathLike):
        return os.fspath(given)
    if is_frame(given):
        return "the DataFrame"
    return f"the {type(given).__name__}"
