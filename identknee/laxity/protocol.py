"""Protocols of laxity tests: flexion and loads of trials, dominant loads, pairs and candidates."""

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field

from identknee.laxity.experiments import INTACT, Experiment, cuts_of, state_words
from identknee.runs.declare import Array, BoolArray, IntArray, array, declared, entry, name_axis
from identknee.runs.errors import InputError, ValueRefused, suggestion
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
    float,
    number("{} is not a number", "Write numbers without quotes.", remedy_infinite="Give one."),
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
        raise refusal(f"there is no load {shown(value)}", remedy)
    return value


class HeldLoads(Part):
    """Loads by name."""

    internal_moment_Nm: Number = 0.0  # noqa: N815 - the unit
    varus_moment_Nm: Number = 0.0  # noqa: N815
    anterior_force_N: Number = 0.0  # noqa: N815
    distraction_force_N: Number = 0.0  # noqa: N815
    lateral_force_N: Number = 0.0  # noqa: N815


State = Annotated[str, custom_message("the state {} is not text", "Put it in quotes.")]


class Ramp(Part):
    """A ``[[ramps]]``."""

    state: State = INTACT
    load: Annotated[str, BeforeValidator(_is_load)]
    flexion_deg: Numbers
    values: Numbers
    held: Annotated[
        HeldLoads, custom_message("this is not a table", "Write held = { anterior_force_N = 30 }.")
    ] = HeldLoads()


class Trial(HeldLoads):
    """A ``[[trials]]``."""

    state: State = INTACT
    flexion_deg: Numbers
    name: Annotated[str, custom_message("the name {} is not text", "Put it in quotes.")] | None = (
        None
    )


_RAMPS, _TRIALS = (
    custom_message("a list of blocks is wanted", f"Start each with a line [[{x}]].") for x in BLOCKS
)


class ProtocolTables(Part):
    """The whole of a protocol's file."""

    format: Annotated[
        Literal[1],
        custom_message("the format is {}", f"Write format = {FORMAT}, the only one there is."),
    ]
    name: Annotated[str, custom_message("the name {} is not text", "Put it in quotes.")] | None = (
        None
    )
    description: Annotated[str, custom_message("{} is not text", "Put it in quotes.")] = ""
    ramps: Annotated[list[Annotated[Ramp, _RAMPS]], _RAMPS] = Field(default_factory=list)
    trials: Annotated[list[Annotated[Trial, _TRIALS]], _TRIALS] = Field(default_factory=list)


def read_tables(path: PathLike) -> ProtocolTables:
    """The whole of a protocol's file, against its schema.

    Raises
    ------
    InputError
        If it cannot be read, is not TOML or breaks the schema: it names the place and the remedy.
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
# Enough for any test; a list pasted by mistake may ask for more, which would fill the memory.
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
    state: tuple[str, ...] | None = entry(
        "State of the knee in each trial, such as `cut: ACL`; null where it is intact in all",
        default=None,
    )
    experiment: tuple[str, ...] | None = entry(
        "Experiment of each trial; null where all are of one", default=None
    )
    experiments: tuple[Experiment, ...] = entry(
        "The experiments, where there are several", default=()
    )

    def __post_init__(self) -> None:
        self._check_states()
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
        return replace(
            self,
            trials=tuple(self.trials[i] for i in chosen),
            flexion_deg=self.flexion_deg[chosen],
            loads=self.loads[chosen],
            state=None if self.state is None else tuple(self.state[i] for i in chosen),
            experiment=None
            if self.experiment is None
            else tuple(self.experiment[i] for i in chosen),
        )

    @property
    def states(self) -> tuple[str, ...]:
        """State of the knee in each trial, also where all are intact."""
        return (INTACT,) * self.n if self.state is None else self.state

    @property
    def experiment_names(self) -> tuple[str, ...]:
        """Experiment of each trial; empty names where all trials are of one."""
        return ("",) * self.n if self.experiment is None else self.experiment

    @property
    def series(self) -> IntArray:
        """Number of the experiment and state of each trial, shape ``(n,)``, in their order.

        Coordinates are counted from, and compared with, trials of one series alone.
        """
        pairs = list(zip(self.experiment_names, self.states, strict=True))
        number = {pair: i for i, pair in enumerate(dict.fromkeys(pairs))}
        return np.array([number[x] for x in pairs], dtype=np.int64)

    @property
    def mounting(self) -> IntArray:
        """Number of the mounting of each trial, shape ``(n,)``."""
        if self.experiment is None:
            return np.zeros(self.n, dtype=np.int64)
        names = list(dict.fromkeys(x.mounting for x in self.experiments))
        of = {x.name: names.index(x.mounting) for x in self.experiments}
        return np.array([of[x] for x in self.experiment], dtype=np.int64)

    def _check_states(self) -> None:
        """Write every state in one form, None where all are intact; refuse what does not fit."""
        if self.state is not None:
            if len(self.state) != self.n:
                raise ValueError(f"there are {self.n} trials and {len(self.state)} states")
            states = tuple(state_words(cuts_of(x)) for x in self.state)
            is_cut = any(x != INTACT for x in states)
            object.__setattr__(self, "state", states if is_cut else None)
        if self.experiment is None:
            return
        known = [x.name for x in self.experiments]
        if len(self.experiment) != self.n or not set(self.experiment) <= set(known):
            raise ValueError(
                f"every one of {self.n} trials needs an experiment of {', '.join(known)}"
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
        return replace(self, loads=loads)


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
    whole = protocols[0]
    for added in protocols[1:]:
        known = dict(zip(whole.trials, _trial_rows(whole), strict=True))
        is_new = np.array([x not in known for x in added.trials], dtype=bool)
        for trial, row in zip(added.trials, _trial_rows(added), strict=True):
            if known.get(trial, row) != row:
                raise ValueError(
                    f"two different trials are called {trial!r} ({added.name} has one). "
                    "Rename one of them."
                )
        whole = _appended(whole, added.select(is_new))
    return replace(whole, name=name or "+".join(x.name for x in protocols))


def _trial_rows(protocol: Protocol) -> list[tuple[Any, ...]]:
    """Flexion, loads, state and experiment of each trial."""
    numbers = np.column_stack([protocol.flexion_deg, protocol.loads]).tolist()
    rows = zip(numbers, protocol.states, protocol.experiment_names, strict=True)
    return [(*x, state, name) for x, state, name in rows]


def _appended(first: Protocol, second: Protocol) -> Protocol:
    known = {x.name: x for x in (*first.experiments, *second.experiments)}
    # Trials added to experiments are of the first of them.
    experiment = tuple(
        x or next(iter(known), "") for x in (*first.experiment_names, *second.experiment_names)
    )
    return Protocol(
        name=first.name,
        trials=(*first.trials, *second.trials),
        flexion_deg=np.concatenate([first.flexion_deg, second.flexion_deg]),
        loads=np.concatenate([first.loads, second.loads]),
        state=(*first.states, *second.states),
        experiment=experiment if known else None,
        experiments=tuple(known.values()),
    )


def load_protocol(name_or_path: str | os.PathLike[str]) -> Protocol:
    """Protocol that ships with the package (`BUILT_IN`), or of a user's TOML file.

    Such a file has ``format = 1``, perhaps a ``name`` and a ``description``, and any number of
    blocks of two kinds. ``[[ramps]]`` has ``load`` (one of `LOADS`), its ``values``, and
    ``flexion_deg`` (one angle or several): a trial is made of each value at each angle, with the
    constant loads of an optional ``held`` table added. A trial that comes up more than once, such
    as the unloaded one of each angle, is made once. ``[[trials]]`` has ``flexion_deg``, any of
    `LOADS` together, and perhaps a ``name``. Either may have a ``state`` of the knee, such as
    ``"cut: ACL"``.

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
    tables = read_tables(path)
    rows = _rows(path, tables)
    states, angles, loads = zip(*rows.values(), strict=True)
    return Protocol(
        name=tables.name or path.stem,
        trials=tuple(rows),
        flexion_deg=np.array(angles),
        loads=np.array(loads),
        state=states,
    )


def trial_name(flexion_deg: float, loads: Sequence[float], state: str = INTACT) -> str:
    """Readable name of a trial, different for different angles, loads or states of the knee.

    Examples
    --------
    >>> trial_name(30, [0, -4, 0, 0, 0])
    'flexion30_varus-4Nm'
    >>> trial_name(0, [0, 0, 0, 0, 0], "cut: ACL, MCL 50%")
    'flexion0_unloaded_cut_ACL_MCL_50%'
    """
    parts = [f"flexion{_shortest(flexion_deg)}"]
    for column, value in zip(LOADS, loads, strict=True):
        if value != 0:
            direction, _, unit = column.split("_")
            parts.append(f"{direction}{_shortest(value)}{unit}")
    parts = parts if len(parts) > 1 else [*parts, "unloaded"]
    return "_".join(parts if state == INTACT else [*parts, re.sub(r"[^\w%.]+", "_", state)])


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
        remedy = "Divide it by 1000 if it is in N·mm, by 100 if in N·cm, by 8.85 if in inch-pounds."
        return beyond("a moment", value, MOMENT_LIMIT_NM, "N·m", remedy)
    return beyond("a force", value, FORCE_LIMIT_N, "N", "Check its unit: forces are given in N.")


def beyond(what: str, value: float, limit: float, unit: str, remedy: str) -> tuple[str, str] | None:
    """That a value lies beyond a limit either way, and the remedy; None if it does not."""
    if abs(value) <= limit:
        return None
    return f"{what} of {value:g} {unit} is beyond {limit:g} {unit} either way", remedy


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


def _check(file: Path, place: str, **values: float | list[float]) -> None:
    for column, given in values.items():
        for value in given if isinstance(given, list) else [given]:
            if fault := range_fault(column, value):
                raise InputError(file, place, *fault)


def _rows(file: Path, tables: ProtocolTables) -> dict[str, tuple[str, float, Sequence[float]]]:
    """State, flexion and loads of each trial of a file, by its name."""
    rows: dict[str, tuple[str, float, Sequence[float]]] = {}
    for block, ramp in enumerate(tables.ramps, 1):
        place = f"[[ramps]] block {block}"
        n = len(ramp.flexion_deg) * len(ramp.values)
        if n > MOST_TRIALS:
            why = f"it makes {n} trials, more than {MOST_TRIALS}"
            raise InputError(file, place, why, "Give fewer angles or values.")
        held = ramp.held.model_dump(exclude={ramp.load})
        if ramp.load in ramp.held.model_fields_set:
            why = f"{ramp.load} is both varied and held"
            raise InputError(file, f"{place}, held", why, "Leave it out.")
        _check(file, f"{place}, held", **held)
        _check(file, f"{place}, {FLEXION}", **{FLEXION: ramp.flexion_deg})
        _check(file, f"{place}, values", **{ramp.load: ramp.values})
        state = _state(file, place, ramp.state)
        for flexion in ramp.flexion_deg:
            for value in ramp.values:
                loads = tuple({**held, ramp.load: value}[x] for x in LOADS)
                rows[trial_name(flexion, loads, state)] = (state, flexion, loads)
    for block, trial in enumerate(tables.trials, 1):
        place, angles = f"[[trials]] block {block}", trial.flexion_deg
        if len(angles) != 1:
            why = f"a trial has one angle, not {len(angles)}"
            remedy = "Write a block for each angle, or a [[ramps]] block."
            raise InputError(file, f"{place}, {FLEXION}", why, remedy)
        _check(file, f"{place}, {FLEXION}", **{FLEXION: angles})
        loads = tuple(float(getattr(trial, x)) for x in LOADS)
        for column, value in zip(LOADS, loads, strict=True):
            _check(file, f"{place}, {column}", **{column: value})
        state = _state(file, place, trial.state)
        name = trial_name(angles[0], loads, state) if trial.name is None else trial.name
        if fault := name_fault(name):
            raise InputError(file, f"{place}, name", *fault)
        if name in rows:
            why = f"the trial {name!r} is there already"
            raise InputError(file, place, why, "Give it another name.")
        rows[name] = (state, angles[0], loads)
    if not rows:
        raise InputError(file, "", "there is no trial", "Add a [[ramps]] or [[trials]] block.")
    return rows


def _state(file: Path, place: str, state: str) -> str:
    try:
        return state_words(cuts_of(state))
    except ValueRefused as error:
        raise InputError(file, f"{place}, state", error.why, error.advice) from None


def _shortest(value: float) -> str:
    text = f"{value + 0.0:g}"
    return text if float(text) == value else repr(float(value))


# Loads of a usual laxity test [N m, N], by which loads of different kinds are compared.
TYPICAL = np.array([5.0, 10.0, 100.0, 100.0, 100.0])
# Loads below this share of those are stray.
STRAY = 0.1
# Below this share of the largest load of its trial, a load is stray.
STRAY_BESIDE = 0.2
# Opposite loads may differ by this share of them, and their flexion angles by so much [deg].
ALIKE, SAME_FLEXION_DEG = 0.5, 5.0


@declared
class DominantLoads:
    """The dominant load of each trial."""

    axis: IntArray = array("Its place among the loads; -1 where there is none", "trial", dtype=int)
    size: Array = array(
        "Its size with its sign, less what all trials hold", "trial", unit="N or N m"
    )


def dominant_loads(protocol: Protocol) -> DominantLoads:
    """The load that each trial tests: the largest as a share of that in a usual test.

    A load that every trial has, such as compression, is counted from its median, unless the trials
    then have no load left. Loads below a tenth of those in a usual test are stray.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> found = dominant_loads(load_protocol("drawer"))
    >>> found.axis[:3].tolist(), found.size[:3].tolist()
    ([2, -1, 2], [-100.0, 0.0, 134.0])
    """
    loads = _changes(protocol)
    share = np.abs(loads) / TYPICAL
    if not np.any(share >= STRAY):
        # As in drawer one way alone, or in a single trial.
        loads = protocol.loads
        share = np.abs(loads) / TYPICAL
    axis = np.argmax(share, axis=1)
    rows = np.arange(protocol.n)
    is_stray = share[rows, axis] < STRAY
    return DominantLoads(
        axis=np.where(is_stray, -1, axis), size=np.where(is_stray, 0.0, loads[rows, axis])
    )


def nominal_loads(protocol: Protocol) -> Array:
    """The loads that distinguish the trials, shape ``(n, 5)``; stray and constant ones are zero.

    A load is stray if it is small in itself or beside the largest of its trial, unless it is the
    only one. A load that every trial has, such as compression, is counted from its median.
    """
    share = np.abs(_changes(protocol)) / TYPICAL
    alone = np.count_nonzero(share, axis=1, keepdims=True) == 1
    least = np.maximum(STRAY, STRAY_BESIDE * share.max(axis=1, keepdims=True))
    main_loads = np.where((share >= least) | (alone & (share > 0.0)), protocol.loads, 0.0)
    return main_loads if main_loads.any() else protocol.loads


def held_loads(protocol: Protocol) -> Array:
    """Loads that the rig holds in all trials: the median of each load that all have, ``(5,)``."""
    if not protocol.n:
        return np.zeros(len(LOADS))
    signs = np.sign(protocol.loads)
    is_held = np.all(signs == signs[:1], axis=0) & (signs[0] != 0.0)
    return np.where(is_held, np.median(protocol.loads, axis=0), 0.0)


def _changes(protocol: Protocol) -> Array:
    return protocol.loads - held_loads(protocol)


def nominal_flexion(protocol: Protocol) -> Array:
    """Nominal flexion of each trial [deg], shape ``(n,)``.

    Where most trials have an angle of their own, as in readings of a robot, angles that are close
    together are replaced by their rounded mean. Other angles are kept.
    """
    angles, place = np.unique(protocol.flexion_deg, return_inverse=True)
    if 2 * angles.size <= protocol.n:
        return protocol.flexion_deg
    cluster = np.cumsum(np.r_[0, np.diff(angles) > SAME_FLEXION_DEG])[place]
    sums = np.bincount(cluster, weights=protocol.flexion_deg)
    return np.asarray(np.round(sums / np.bincount(cluster))[cluster])


# More angles than this are shown together with those near them, in steps of so many degrees.
MOST_ANGLES, ANGLE_STEP_DEG = 50, 15.0


def shown_flexion(protocol: Protocol) -> Array:
    """The angle under which each trial is shown in every figure and map [deg], shape ``(n,)``.

    Angles that a rig reads a little apart are one, experiment by experiment. Where that leaves too
    many for a map or a legend it is the nearest of a few.
    """
    shown = np.array(protocol.flexion_deg)
    names = np.array(protocol.experiment_names)
    for name in np.unique(names):
        own = names == name
        shown[own] = nominal_flexion(protocol.select(own))
    steps = ANGLE_STEP_DEG * np.round(protocol.flexion_deg / ANGLE_STEP_DEG)
    # Of angles all along an arc each is near the next, and none is that of all.
    shown = np.where(np.abs(shown - protocol.flexion_deg) > 0.5 * ANGLE_STEP_DEG, steps, shown)
    return np.asarray(steps if np.unique(shown).size > MOST_ANGLES else shown)


def as_shown(protocol: Protocol) -> Protocol:
    """The protocol as figures show it: one angle for trials near it, stray loads left out."""
    return replace(protocol, flexion_deg=shown_flexion(protocol), loads=nominal_loads(protocol))


def opposite_pairs(protocol: Protocol) -> IntArray:
    """Pairs of trials under opposite loads at about the same flexion, shape ``(k, 2)``.

    The trial with the positive load stands first; each trial is in one pair at most, the most alike
    in flexion and size first.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> opposite_pairs(load_protocol("drawer"))[0].tolist()
    [2, 0]
    """
    found, flexion, series = dominant_loads(protocol), protocol.flexion_deg, protocol.series
    none = np.zeros(0, dtype=np.int64)
    alike = [(none, none, np.zeros(0))]
    for axis in np.unique(found.axis):
        above, below = (
            np.flatnonzero((found.axis == axis) & (sign * found.size > 0.0)) for sign in (1, -1)
        )
        apart = np.abs(flexion[above, None] - flexion[below])
        unlike = np.abs(found.size[above, None] + found.size[below]) / np.abs(found.size[below])
        is_alike = (apart <= SAME_FLEXION_DEG) & (unlike <= ALIKE)
        i, j = np.nonzero(is_alike & (series[above, None] == series[below]))
        distance = apart[i, j] / SAME_FLEXION_DEG + unlike[i, j] / ALIKE
        alike.append((above[i], below[j], distance))
    first, second, distance = (np.concatenate(x) for x in zip(*alike, strict=True))
    order = np.lexsort((second, first, distance))
    taken: set[int] = set()
    pairs = []
    for i, j in zip(first[order].tolist(), second[order].tolist(), strict=True):
        if not taken & {i, j}:
            taken |= {i, j}
            pairs.append((i, j))
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


SAME_ANGLE_DEG = 0.5
"""Trials whose flexion angles differ by no more [deg] share their unloaded pose: a rig set to 30
seldom reads 30.0."""
ABSOLUTE, UNLOADED, OPPOSITE = "absolute", "unloaded", "opposite"
ZEROS = (ABSOLUTE, UNLOADED, OPPOSITE)


def from_zero(values: Array, protocol: Protocol, zero: str) -> Array:
    """`values` less their mean over the trials that they are counted from.

    Parameters
    ----------
    values
        Anything with a row a trial, shape ``(n, ...)``: coordinates, or their Jacobian.
    protocol
        The trials.
    zero
        ``"absolute"``, ``"unloaded"``, ``"opposite"`` or the name of a trial.

    Raises
    ------
    ValueError
        If a trial that others are counted from is missing.
    """
    if zero == ABSOLUTE:
        return values
    zeros = [values[rows].mean(axis=0) for rows in zero_trials(protocol, zero)]
    return np.asarray(values - np.array(zeros).reshape(values.shape), dtype=np.float64)


def zero_trials(protocol: Protocol, zero: str) -> tuple[IntArray, ...]:
    """Indices of the reference trials of each trial, one array per trial.

    A trial without an opposite one is counted from itself: its change says nothing.

    Raises
    ------
    ValueError
        If a flexion angle has no unloaded trial, or no trial is called so.
    """
    if zero == UNLOADED:
        return unloaded_trials(protocol)
    if zero == OPPOSITE:
        from_which = np.arange(protocol.n)
        for pair in opposite_pairs(protocol):
            from_which[pair] = pair[::-1]
        return tuple(from_which[:, None])
    if zero not in protocol.trials:
        raise ValueError(
            f"no trial of {protocol.name!r} is called {zero}, from which the others are counted. "
            "Keep it in the table."
        )
    return tuple(np.full((protocol.n, 1), protocol.trials.index(zero)))


def unloaded_trials(protocol: Protocol) -> tuple[IntArray, ...]:
    """Indices of the unloaded trials at the flexion angle of each trial, one array a trial.

    They are of the same experiment and state of the knee.

    Raises
    ------
    ValueError
        If a flexion angle has no unloaded trial.
    """
    unloaded, series = np.flatnonzero(protocol.is_unloaded), protocol.series
    found = []
    for trial, flexion in enumerate(protocol.flexion_deg):
        near = np.abs(protocol.flexion_deg[unloaded] - flexion) <= SAME_ANGLE_DEG
        near &= series[unloaded] == series[trial]
        if not near.any():
            of = "" if series.max() == 0 else f" in the series of {protocol.trials[trial]}"
            raise ValueError(
                f"no trial of {protocol.name!r} is unloaded at {flexion:g} deg flexion{of}. "
                "Add one with all loads zero at that angle."
            )
        found.append(unloaded[near].astype(np.int64))
    return tuple(found)


def zero_of_added_trials(zero: str) -> str:
    """What trials to be added to a table are counted from: where it is not absolute, unloaded."""
    return ABSOLUTE if zero == ABSOLUTE else UNLOADED


def zero_fault(zero: str, protocol: Protocol, coordinates: Array) -> tuple[str, str] | None:
    """Why coordinates cannot be counted from there, and the remedy; None if they can.

    Parameters
    ----------
    zero
        As in `from_zero`.
    protocol, coordinates
        The trials, and their coordinates, NaN where not measured, shape ``(n, 5)``.
    """
    measured = ~np.isnan(coordinates)
    if zero == OPPOSITE:
        pairs = opposite_pairs(protocol)
        alone = np.array(measured.any(axis=1))
        alone[pairs.ravel()] = False
        if alone.any():
            trial = protocol.trials[int(np.argmax(alone))]
            return (
                f"{trial} has coordinates, and no trial at its flexion angle has the opposite load",
                "Add that trial with blank cells, or leave the cells of this one blank",
            )
        twice = [pair for pair in pairs.tolist() if measured[pair].all(axis=0).any()]
        if twice:
            first, second = (protocol.trials[i] for i in twice[0])
            why = f"{first} and {second} both have coordinates, which would count their difference"
            remedy = "Give it in the row of one of them, and leave the cells of the other blank"
            return f"{why} twice", remedy
        return None
    if zero in ZEROS:
        return None
    if zero not in protocol.trials:
        return (
            f"the zero {zero!r} is unknown and not the name of a trial",
            "Write unloaded, opposite or the name of a trial, or leave the line out",
        )
    own = coordinates[protocol.trials.index(zero)]
    if np.any(own[~np.isnan(own)] != 0.0):
        return (
            f"{zero} is the zero of the table and has coordinates other than 0",
            "Leave its cells blank",
        )
    return None


FLEXION_DEG = tuple(range(0, 121, 15))
# Loads that rigs and examiners apply: drawer, varus/valgus and internal/external tests one at a
# time, on a compressed or distracted knee, and in pairs.
SINGLE: tuple[Mapping[str, float], ...] = (
    {},
    *({"internal_moment_Nm": x} for x in (-10.0, -5.0, 5.0, 10.0)),
    *({"varus_moment_Nm": x} for x in (-10.0, 10.0)),
    *({"anterior_force_N": x} for x in (-100.0, 134.0)),
    *({"distraction_force_N": x} for x in (-250.0, 100.0)),
)
COMBINED: tuple[Mapping[str, float], ...] = (
    *({"internal_moment_Nm": x, "varus_moment_Nm": y} for x in (-5.0, 5.0) for y in (-10.0, 10.0)),
    *(
        {"internal_moment_Nm": x, "anterior_force_N": y}
        for x in (-5.0, 5.0)
        for y in (-100.0, 134.0)
    ),
    *({"internal_moment_Nm": x, "distraction_force_N": -250.0} for x in (-5.0, 5.0)),
    *({"anterior_force_N": x, "distraction_force_N": -250.0} for x in (-100.0, 134.0)),
)


def candidate_trials(made: Protocol, flexion_deg: Sequence[float] = FLEXION_DEG) -> Protocol:
    """Trials that might be added to those made: single loads, combined loads and repeats.

    At each flexion angle the unloaded knee, internal and external moments of 5 and 10 N·m, varus
    and valgus of 10 N·m, anterior 134 N, posterior 100 N, compression 250 N, distraction 100 N, and
    pairs of them; and every trial made already, once more.

    No rig repeats a trial with its stray loads and its decimals of flexion. Such a trial is offered
    as it was meant, see `nominal_trials`. A load that the rig holds in all trials, such as
    compression, is in all candidates that have no other load along that axis.

    Parameters
    ----------
    made
        The trials made. Candidates are of the experiment and state in which the knee was left. One
        with the angle and the loads of a trial made there is its repeat and bears its name.
    flexion_deg
        Angles of the new ones [deg].

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> candidates = candidate_trials(load_protocol("seed63"), [0, 90])
    >>> candidates.n, candidates.trials[63]
    (104, 'flexion0_internal-5Nm')
    """
    is_exact, flexion, meant = nominal_trials(made)
    # The knee was left in the state with the most cuts.
    last = max(range(made.n), key=lambda i: (len(cuts_of(made.states[i])), i))
    is_repeat = is_exact & (made.series == made.series[last])
    rows = {
        _key(made.flexion_deg[i], made.loads[i]): (
            made.trials[i],
            float(made.flexion_deg[i]),
            made.loads[i],
        )
        for i in np.flatnonzero(is_repeat).tolist()
    }
    meant = np.where(is_exact[:, None], made.loads, meant)
    held = nominal_held_loads(made)
    usual = [
        (float(angle), np.array([loads.get(x, y) for x, y in zip(LOADS, held, strict=True)]))
        for angle in flexion_deg
        for loads in (*SINGLE, *COMBINED)
    ]
    taken = set(made.trials)
    for angle, values in (
        *zip(flexion[~is_repeat].tolist(), meant[~is_repeat], strict=True),
        *usual,
    ):
        name = trial_name(angle, values.tolist())
        # A trial made under this name may have other loads.
        while name in taken and _key(angle, values) not in rows:
            name += "_new"
        rows.setdefault(_key(angle, values), (name, angle, values))
        taken.add(name)
    names, angles, values_of = zip(*rows.values(), strict=True)
    return Protocol(
        name=f"candidates for {made.name}",
        trials=names,
        flexion_deg=np.array(angles),
        loads=np.array(values_of),
        state=None if made.state is None else (made.state[last],) * len(names),
        experiment=None if made.experiment is None else (made.experiment[last],) * len(names),
        experiments=made.experiments,
    )


# A load within this share of one in `SINGLE` was meant to be that one.
AS_USUAL = 0.05


def nominal_trials(made: Protocol) -> tuple[BoolArray, Array, Array]:
    """The trials as they were meant: which are so already, flexion [deg] and loads (n, 5).

    A trial is meant to have its dominant load alone, beside what the rig holds in all trials. The
    load is the largest in that direction of any trial, to two digits or as in a usual test, and
    flexion is nominal, in whole degrees. A trial that has no stray load, and shares its flexion
    with other trials, is kept.
    """
    changes, dominant = _changes(made), dominant_loads(made)
    flexion = nominal_flexion(made)
    share = np.abs(changes) / TYPICAL
    least = np.maximum(STRAY, STRAY_BESIDE * share.max(axis=1, keepdims=True))
    is_stray = (changes != 0.0) & (share < least)
    # A load that is the only one is what the trial is about, however small.
    is_alone = np.count_nonzero(changes, axis=1) == 1
    is_exact = np.asarray((~is_stray.any(axis=1) | is_alone) & (flexion == made.flexion_deg))
    loads = np.tile(nominal_held_loads(made), (made.n, 1))
    for i in np.flatnonzero(dominant.axis >= 0):
        axis, sign = int(dominant.axis[i]), np.sign(dominant.size[i])
        alike = (dominant.axis == axis) & (np.sign(dominant.size) == sign)
        loads[i, axis] = _nominal_load(axis, sign * (sign * made.loads[alike, axis]).max())
    return is_exact, np.where(is_exact, flexion, np.round(flexion)), loads


# A load is held if it is within STEADY of its median, as a share of it, in IN_MOST of the trials.
STEADY, IN_MOST = 0.3, 0.8


def nominal_held_loads(made: Protocol) -> list[float]:
    """What the rig holds in all trials beside the load of each, to two digits or as usual."""
    held, changes = held_loads(made), _changes(made)
    is_near = np.abs(changes) <= STEADY * np.abs(held)
    is_steady = np.asarray(is_near.mean(axis=0) >= IN_MOST)
    is_beside = bool(np.any(np.abs(changes[:, ~is_steady]) / TYPICAL[~is_steady] >= STRAY))
    return [
        _nominal_load(i, float(x)) if x and is_steady[i] and is_beside else 0.0
        for i, x in enumerate(held)
    ]


def _nominal_load(axis: int, value: float) -> float:
    """A load as it was meant: the nearest of usual tests, or else two digits of it."""
    usual = [x[LOADS[axis]] for x in SINGLE if LOADS[axis] in x]
    nearest = min(usual, key=lambda x: abs(x - value), default=0.0)
    if nearest and abs(nearest - value) <= AS_USUAL * abs(nearest):
        return nearest
    return float(f"{value:.2g}")


def unique_names(names: Sequence[str], taken: Sequence[str]) -> tuple[str, ...]:
    """The names, with a number added to those that are taken or repeated.

    Examples
    --------
    >>> unique_names(["a", "b", "a"], taken=["b"])
    ('a', 'b_repeat2', 'a_repeat2')
    """
    used = set(taken)
    given = []
    for name in names:
        new, number = name, 1
        while new in used:
            number += 1
            new = f"{name}_repeat{number}"
        used.add(new)
        given.append(new)
    return tuple(given)


def _key(angle: float, loads: np.ndarray) -> tuple[float, ...]:
    return (float(angle), *(loads + 0.0).tolist())
