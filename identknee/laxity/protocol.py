"""Which trials a laxity test has: the flexion angle and the loads of each."""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field

from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared, entry, name_axis
from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import PathLike
from identknee.runs.schema import (
    Fault,
    Part,
    Place,
    custom_message,
    number,
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
    custom_message("the list is empty", "Write at least one number."),
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
        HeldLoads, custom_message("this is no table", "Write held = { anterior_force_N = 30 }.")
    ] = HeldLoads()


class Trial(HeldLoads):
    """A ``[[trials]]``."""

    flexion_deg: Numbers
    name: Annotated[str, custom_message("the name {} is no text", "Put it in quotes.")] | None = (
        None
    )


_RAMPS, _TRIALS = (
    custom_message("these are no blocks", f"Start each with a line [[{x}]].") for x in BLOCKS
)


class ProtocolTables(Part):
    """The whole of a protocol's file."""

    format: Annotated[
        Literal[1],
        custom_message("the format is {}", f"Write format = {FORMAT}, the only one there is."),
    ]
    name: Annotated[str, custom_message("the name {} is no text", "Put it in quotes.")] | None = (
        None
    )
    description: Annotated[str, custom_message("{} is no text", "Put it in quotes.")] = ""
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
    """A place in the file, in words.

    Examples
    --------
    >>> _place(("ramps", 1, "values", 0))
    '[[ramps]] block 2, values'
    """
    steps = list(place)
    if len(steps) > 1 and steps[0] in BLOCKS and isinstance(steps[1], int):
        steps[:2] = [f"[[{steps[0]}]] block {steps[1] + 1}"]
    return ", ".join(x for x in steps if isinstance(x, str))


LOADS = (
    "internal_moment_Nm",
    "varus_moment_Nm",
    "anterior_force_N",
    "distraction_force_N",
    "lateral_force_N",
)
WAYS = (
    ("internal", "external", "moment"),
    ("varus", "valgus", "moment"),
    ("anterior", "posterior", "force"),
    ("distraction", "compression", "force"),
    ("lateral", "medial", "force"),
)
DIRECTIONS = tuple((f"{one} {kind}", f"{other} {kind}") for one, other, kind in WAYS)
"""Name of each load where it is positive and where it is negative."""
name_axis("load", LOADS)
FLEXION = "flexion_deg"
BUILT_IN = ("seed63", "table2", "drawer")
MOMENT_LIMIT_NM = 50.0
FORCE_LIMIT_N = 1000.0
FLEXION_LIMITS_DEG = (-10.0, 160.0)
# Enough for any test; more come of a list pasted by mistake, and would fill the memory.
MOST_TRIALS = 100_000


@declared
class Protocol:
    """Trials of a laxity test.

    Opposite loads are negative: external, valgus, posterior, compression, medial.

    Raises
    ------
    ValueError
        If two trials share a name, or an angle or a load is out of range.
    """

    name: str = entry("Name of the protocol")
    trials: tuple[str, ...] = array("Name of each trial", "trial", is_in_arrays=False)
    flexion_deg: Array = array("Flexion angle, from -10 to 160", "trial", unit="deg")
    loads: Array = array(
        "Internal and varus moment [N m], anterior, distraction and lateral force [N]",
        *("trial", "load"),
        unit="N or N m, as the load's name says",
    )

    def __post_init__(self) -> None:
        seen: set[str] = set()
        for trial, flexion, loads in zip(self.trials, self.flexion_deg, self.loads, strict=True):
            if fault := name_fault(trial):
                raise ValueError(f"trial {trial!r}: {fault[0]}. {fault[1]}")
            if trial in seen:
                raise ValueError(f"two trials are called {trial!r}. Give each its own name.")
            seen.add(trial)
            for column, value in zip((FLEXION, *LOADS), (flexion, *loads), strict=True):
                if fault := range_fault(column, float(value)):
                    raise ValueError(f"trial {trial!r}, {column}: {fault[0]}. {fault[1]}")

    @property
    def n(self) -> int:
        """How many trials there are."""
        return len(self.trials)

    @property
    def is_unloaded(self) -> BoolArray:
        """Whether all loads of a trial are zero, shape ``(n,)``."""
        return np.asarray(~self.loads.any(axis=1))

    def select(self, indices: ArrayLike) -> "Protocol":
        """The trials at `indices` (whole numbers, or a mask of n truth values), in that order.

        Raises
        ------
        ValueError
            If an index is out of range or given twice.
        """
        chosen = selected_rows(indices, self.n)
        return Protocol(
            name=self.name,
            trials=tuple(self.trials[i] for i in chosen),
            flexion_deg=self.flexion_deg[chosen],
            loads=self.loads[chosen],
        )

    def under(self, shares: Array) -> "Protocol":
        """The trials under shares (n,) of their loads; compression stays, as a rig holds it.

        Examples
        --------
        >>> protocol = load_protocol("drawer").select([0])
        >>> part = protocol.under(np.array([0.5]))
        >>> bool((part.loads == 0.5 * protocol.loads).all())
        True
        """
        loads = self.loads * shares[:, None]
        compression = LOADS.index("distraction_force_N")
        loads[:, compression] = np.minimum(self.loads[:, compression], loads[:, compression])
        return Protocol(
            name=self.name, trials=self.trials, flexion_deg=self.flexion_deg, loads=loads
        )


def concatenate(protocols: Sequence[Protocol], *, name: str | None = None) -> Protocol:
    """All trials of `protocols`, one after the other; a trial they share is kept once.

    Parameters
    ----------
    protocols
        At least one.
    name
        What to call the result; the names joined by ``+`` where None.

    Raises
    ------
    ValueError
        If two different trials have one name.

    Examples
    --------
    >>> both = concatenate([load_protocol("seed63"), load_protocol("drawer")])
    >>> both.name, both.n
    ('seed63+drawer', 69)
    """
    rows: dict[str, tuple[float, ...]] = {}
    for protocol in protocols:
        for trial, flexion, loads in zip(
            protocol.trials, protocol.flexion_deg, protocol.loads, strict=True
        ):
            row = (float(flexion), *map(float, loads))
            if rows.setdefault(trial, row) != row:
                raise ValueError(
                    f"two different trials are called {trial!r} ({protocol.name} has one). "
                    "Rename one of them."
                )
    return _protocol(name or "+".join(protocol.name for protocol in protocols), rows)


def load_protocol(name_or_path: str | os.PathLike[str]) -> Protocol:
    """Protocol that ships with the package (`BUILT_IN`), or of a user's TOML file.

    Such a file has ``format = 1``, perhaps a ``name`` and a ``description``, and any number of
    blocks of two kinds. ``[[ramps]]`` has ``load`` (one of `LOADS`), its ``values``, and
    ``flexion_deg`` (one angle or several): a trial is made of each value at each angle, with the
    constant loads of an optional ``held`` table added. A trial that comes up more than once, such
    as the unloaded one of each angle, is made once. ``[[trials]]`` has ``flexion_deg``, any of
    `LOADS` together, and perhaps a ``name``.

    Raises
    ------
    InputError
        If there is no such protocol, or the file breaks a rule above.

    Examples
    --------
    >>> protocol = load_protocol("seed63")
    >>> protocol.n, protocol.trials[0]
    (63, 'flexion0_varus-10Nm')
    """
    path = Path(name_or_path)
    if name_or_path in BUILT_IN:
        path = Path(__file__).parent / "protocols" / f"{name_or_path}.toml"
    elif not path.exists() and path.suffix == "":
        raise InputError(
            path,
            "",
            "there is no built-in protocol and no file of this name",
            f"{suggestion(str(path), BUILT_IN)} Or give the path of a TOML file.",
        )
    return _File(path).protocol(read_tables(path))


def trial_name(flexion_deg: float, loads: Sequence[float]) -> str:
    """Readable name of a trial, different for different angles or loads.

    Examples
    --------
    >>> trial_name(30, [0, -4, 0, 0, 0])
    'flexion30_varus-4Nm'
    """
    parts = [f"flexion{_shortest(flexion_deg)}"]
    for column, value in zip(LOADS, loads, strict=True):
        if value != 0:
            direction, _, unit = column.split("_")
            parts.append(f"{direction}{_shortest(value)}{unit}")
    return "_".join(parts if len(parts) > 1 else [*parts, "unloaded"])


def range_fault(column: str, value: float) -> tuple[str, str] | None:
    """What is wrong with an angle or a load of `column`, and its remedy; None if all is well."""
    if not math.isfinite(value):
        return f"{value} is not a finite number", "Give one."
    if column == FLEXION:
        low, high = FLEXION_LIMITS_DEG
        if low <= value <= high:
            return None
        why = f"a flexion of {value:g} deg lies outside {low:g} to {high:g} deg"
        return why, "Give the flexion angle in degrees, 0 in extension."
    if column.endswith("_Nm"):
        if abs(value) <= MOMENT_LIMIT_NM:
            return None
        why = f"a moment of {value:g} N·m is beyond {MOMENT_LIMIT_NM:g} N·m either way"
        return why, "If it is in N·mm, divide it by 1000."
    if abs(value) <= FORCE_LIMIT_N:
        return None
    why = f"a force of {value:g} N is beyond {FORCE_LIMIT_N:g} N either way"
    return why, "Check its unit: forces are given in N."


def name_fault(name: str) -> tuple[str, str] | None:
    """What is wrong with the name of a trial, and its remedy; None if all is well."""
    if not name.strip():
        return "the trial has no name", "Give every trial a name of its own."
    if name != name.strip() or not name.isprintable():
        why = "the name of a trial starts or ends with a space or holds a line break or tab"
        return why, "Use visible characters only."
    return None


def selected_rows(indices: ArrayLike, n: int) -> list[int]:
    """Row numbers from whole numbers or from a mask of `n` truth values.

    Raises
    ------
    ValueError
        If one is out of range.
    """
    given = np.asarray(indices)
    if given.dtype == np.bool_:
        if given.shape != (n,):
            raise ValueError(f"a mask of {n} truth values is needed, got shape {given.shape}")
        return [int(i) for i in np.flatnonzero(given)]
    chosen = [int(i) for i in given]
    for index in chosen:
        if not -n <= index < n:
            raise ValueError(f"there are {n} trials, counted from 0; there is no trial {index}")
    return chosen


class _File:
    """A protocol's file made into trials; knows its path for the messages."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def protocol(self, tables: ProtocolTables) -> Protocol:
        rows: dict[str, tuple[float, ...]] = {}
        for block, ramp in enumerate(tables.ramps, 1):
            rows.update(self._ramp(f"[[ramps]] block {block}", ramp))
        for block, trial in enumerate(tables.trials, 1):
            place = f"[[trials]] block {block}"
            name, row = self._trial(place, trial)
            if name in rows:
                self._refuse(place, f"the trial {name!r} is there already", "Give it another name.")
            rows[name] = row
        if not rows:
            self._refuse("", "there is no trial", "Add a [[ramps]] or [[trials]] block.")
        return _protocol(tables.name or self._path.stem, rows)

    def _ramp(self, place: str, ramp: Ramp) -> dict[str, tuple[float, ...]]:
        n = len(ramp.flexion_deg) * len(ramp.values)
        if n > MOST_TRIALS:
            why = f"it makes {n} trials, more than {MOST_TRIALS}"
            self._refuse(place, why, "Give fewer angles or values.")
        held = ramp.held.model_dump(exclude={ramp.load})
        if ramp.load in ramp.held.model_fields_set:
            why = f"{ramp.load} is the load that varies and held as well"
            self._refuse(f"{place}, held", why, "Leave it out.")
        self._check(f"{place}, held", **held)
        self._check(f"{place}, {FLEXION}", **{FLEXION: ramp.flexion_deg})
        self._check(f"{place}, values", **{ramp.load: ramp.values})
        rows = {}
        for flexion in ramp.flexion_deg:
            for value in ramp.values:
                loads = tuple({**held, ramp.load: value}[x] for x in LOADS)
                rows[trial_name(flexion, loads)] = (flexion, *loads)
        return rows

    def _trial(self, place: str, trial: Trial) -> tuple[str, tuple[float, ...]]:
        angles = trial.flexion_deg
        if len(angles) != 1:
            self._refuse(
                f"{place}, {FLEXION}",
                f"a trial has one angle, not {len(angles)}",
                "Write a block for each angle, or a [[ramps]] block.",
            )
        self._check(f"{place}, {FLEXION}", **{FLEXION: angles})
        loads = tuple(float(getattr(trial, x)) for x in LOADS)
        for column, value in zip(LOADS, loads, strict=True):
            self._check(f"{place}, {column}", **{column: value})
        name = trial_name(angles[0], loads) if trial.name is None else trial.name
        if fault := name_fault(name):
            self._refuse(f"{place}, name", *fault)
        return name, (angles[0], *loads)

    def _check(self, place: str, **values: float | list[float]) -> None:
        for column, given in values.items():
            for value in given if isinstance(given, list) else [given]:
                if fault := range_fault(column, value):
                    self._refuse(place, *fault)

    def _refuse(self, place: str, why: str, remedy: str) -> NoReturn:
        raise InputError(self._path, place, why, remedy)


def _protocol(name: str, rows: Mapping[str, tuple[float, ...]]) -> Protocol:
    table = np.array(list(rows.values()), dtype=np.float64).reshape(len(rows), 1 + len(LOADS))
    return Protocol(name=name, trials=tuple(rows), flexion_deg=table[:, 0], loads=table[:, 1:])


def _shortest(value: float) -> str:
    text = f"{value + 0.0:g}"
    return text if float(text) == value else repr(float(value))
