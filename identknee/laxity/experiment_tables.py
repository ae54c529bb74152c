"""Several tables of one knee as one laxity: files side by side, or those of an experiments.toml."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from identknee.laxity.data_frame import Frame
from identknee.laxity.experiments import INTACT, LOAD_CELL, Experiment, cuts_of, state_words
from identknee.laxity.forces import (
    Superposition,
    check_paths,
    joined_forces,
    joined_superpositions,
    read_superposition,
    with_named_paths,
)
from identknee.laxity.named_tables import TABLES
from identknee.laxity.noise import noise_sizes
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity, read_laxity
from identknee.runs.declare import Array
from identknee.runs.errors import InputError, ValueRefused
from identknee.runs.files import PathLike
from identknee.runs.schema import Fault, Part, custom_message, number, read_toml, validated

LaxityLike = Laxity | Frame | PathLike
RIG, TOML = "rig", ".toml"
# What of `identknee.subject.knee.Uncertainty` belongs to a rig.
OF_RIG = ("registration_deg", "registration_mm", "load_axes_deg", "load_gain")
LARGEST_MB = 10
Text = Annotated[str, custom_message("{} is not text", "Put it in quotes.")]


class ExperimentTable(Part):
    """An ``[[experiments]]``."""

    name: Text
    table: Text | None = None
    superposition: Text | None = None
    reads: Text | None = None
    rig: Text = RIG
    remounted: Annotated[
        bool, custom_message("{} is not a truth value", "Write true or false.")
    ] = False
    state: Text = INTACT
    side: Text = ""


class RigTable(Part):
    """A ``[rigs.NAME]``."""

    noise: Text | None = None
    uncertainty: dict[str, Annotated[float, number()]] = Field(default_factory=dict)


class ExperimentsFile(Part):
    """The whole of an experiments.toml."""

    experiments: Annotated[
        list[ExperimentTable],
        Field(min_length=1),
        custom_message("there is no experiment", "Start each with a line [[experiments]]."),
    ]
    rigs: dict[str, RigTable] = Field(default_factory=dict)


def read_experiments(given: LaxityLike | Sequence[LaxityLike]) -> Laxity:
    """The laxity of one table, of several, or of the experiments that a TOML file lists.

    Several tables are experiments made by one rig in one mounting. They are named after their
    files, or after the folders of files of one name. An
    ``experiments.toml`` says more: of each experiment its ``table``, ``rig``, ``state`` and whether
    the knee was ``remounted``, or its table of in-situ forces (``superposition``, ``reads``); of
    each rig its ``noise`` and ``uncertainty``.

    Raises
    ------
    InputError
        If a file breaks a rule.
    ValueError
        If the tables do not fit together.
    """
    if isinstance(given, Laxity):
        return given
    if isinstance(given, str | os.PathLike):
        path = Path(given)
        return _of_file(path) if path.suffix.lower() == TOML else read_laxity(given)
    if not isinstance(given, Sequence):
        return read_laxity(given)
    tables = [x if isinstance(x, Laxity) else read_laxity(x) for x in given]
    if len(tables) == 1:
        return tables[0]
    names = _names(given, [x.protocol.name for x in tables])
    if twice := next((x for x in names if names.count(x) > 1), ""):
        raise ValueRefused(f"two tables are called {twice}", "rename one of the files")
    experiments = [Experiment(name=x, rig=RIG, mounting=f"{RIG}-1") for x in names]
    return joined(list(zip(experiments, tables, strict=True)))


def _names(given: Sequence[object], names: Sequence[str]) -> list[str]:
    """Names of tables: those of folders for files of one name."""
    return [
        Path(x).resolve().parent.name
        if names.count(name) > 1 and isinstance(x, str | os.PathLike)
        else name
        for x, name in zip(given, names, strict=True)
    ]


def is_experiments(path: Path) -> bool:
    """Whether a TOML file lists experiments; otherwise it describes a subject."""
    if path.suffix.lower() != TOML or not path.is_file():
        return False
    return "[[experiments]]" in path.read_text(encoding="utf-8", errors="replace")


def _of_file(path: Path) -> Laxity:
    stated = validated(ExperimentsFile, read_toml(path, LARGEST_MB), lambda x: _error(path, x))
    _check_kinds(path, stated.experiments)
    known = {x.rig for x in stated.experiments}
    for name, rig in stated.rigs.items():
        place = f"[rigs.{name}]"
        if name not in known:
            why = "no experiment was made with this rig"
            raise InputError(path, place, why, f"Rigs of the experiments: {', '.join(known)}.")
        for part in rig.uncertainty:
            if part not in (*OF_RIG, *LOAD_CELL):
                why = f"{part} does not belong to a rig"
                known_parts = ", ".join((*OF_RIG, *LOAD_CELL))
                remedy = f"Its parts are {known_parts}; state the others with the subject."
                raise InputError(path, f"{place} uncertainty", why, remedy)
    noises = {name: _noise_of(path, name, rig.noise) for name, rig in stated.rigs.items()}
    mounted: dict[str, int] = {}
    tables = []
    for i, x in enumerate(stated.experiments, 1):
        place = f"[[experiments]] block {i}"
        if x.table is None:
            continue
        if x.remounted or x.rig not in mounted:
            mounted[x.rig] = mounted.get(x.rig, 0) + 1
        rig = stated.rigs.get(x.rig, RigTable())
        try:
            experiment = Experiment(
                name=x.name,
                rig=x.rig,
                mounting=f"{x.rig}-{mounted[x.rig]}",
                uncertainty=rig.uncertainty,
                side=x.side,
            )
            # A named table is none of the folder's.
            source = x.table if x.table in TABLES else path.parent / x.table
            table = _in_state(read_laxity(source), x.state)
            tables.append((experiment, _with_noise(table, noises.get(x.rig))))
        except ValueRefused as error:
            raise InputError(path, place, error.why, error.advice) from None
    try:
        whole = joined(tables)
    except ValueRefused as error:
        raise InputError(path, "", error.why, error.advice) from None
    parts = []
    for i, x in enumerate(stated.experiments, 1):
        if x.superposition is None:
            continue
        try:
            found = read_superposition(path.parent / x.superposition, x.reads or "")
            parts.append(_of_rig(with_named_paths(found, whole.protocol), whole.protocol, x.rig))
            whole = replace(whole, superposition=joined_superpositions(parts))
        except ValueRefused as error:
            place = f"[[experiments]] block {i}"
            raise InputError(path, place, error.why, error.advice) from None
    return whole


def _check_kinds(path: Path, experiments: Sequence[ExperimentTable]) -> None:
    """Refuse experiments without a table or with two, and keys of the other kind of experiment."""
    for i, x in enumerate(experiments, 1):
        why = remedy = ""
        if (x.table is None) == (x.superposition is None):
            why = "an experiment has either a table or a superposition"
            remedy = 'Write table = "FILE.csv" or superposition = "FILE.csv".'
        elif x.table is not None and x.reads is not None:
            why, remedy = "what a cell reads belongs to a superposition", "Remove reads."
        elif x.superposition is not None and (x.remounted or x.state != INTACT):
            why = "a superposition has the states of its rows, and is made where the path was"
            remedy = "Remove state and remounted."
        if why:
            raise InputError(path, f"[[experiments]] block {i}", why, remedy)
    if all(x.table is None for x in experiments):
        why = "no experiment has a table with the paths that were replayed"
        raise InputError(path, "", why, 'Add one with table = "FILE.csv".')


def _of_rig(superposition: Superposition, protocol: Protocol, rig: str) -> Superposition:
    """The in-situ forces, refused where the path of one was made in another rig."""
    check_paths(superposition, protocol)
    rigs = {x.name: x.rig for x in protocol.experiments}
    of = dict(zip(protocol.trials, protocol.experiment or (), strict=True))
    for row, trial in enumerate(superposition.trials):
        if (own := rigs[of[trial]]) != rig:
            raise ValueRefused(
                f"{superposition.words(row)}: the path was made in the rig {own}, and is said to "
                f"be replayed in {rig}",
                f"write rig = {own!r}",
            )
    return superposition


def _error(path: Path, fault: Fault) -> InputError:
    steps = [x for x in (*fault.place, fault.key) if x != ""]
    if len(steps) > 1 and steps[0] == "experiments":
        steps[:2] = [f"[[experiments]] block {int(steps[1]) + 1}"]
    elif len(steps) > 1 and steps[0] == "rigs":
        steps[:2] = [f"[rigs.{steps[1]}]"]
    place = ", ".join(map(str, steps))
    if fault.is_unknown:
        return InputError(path, place, "this word is unknown here", "Remove it.")
    return InputError(path, place, fault.why or "it is missing", fault.remedy or "Add it.")


def _in_state(laxity: Laxity, state: str) -> Laxity:
    """The table with the state that its experiment has."""
    words, own = state_words(cuts_of(state)), laxity.protocol.state
    if words == INTACT:
        return laxity
    if own is not None and set(own) != {words}:
        other = next(x for x in own if x != words)
        raise ValueRefused(
            f"the experiment is in the state {words!r}, and its table says {other!r}",
            "state it in one place",
        )
    return replace(laxity, protocol=replace(laxity.protocol, state=(words,) * laxity.n))


def _noise_of(path: Path, rig: str, noise: str | None) -> Array | None:
    """The noise that a rig states for each coordinate, shape ``(5,)``."""
    if noise is None:
        return None
    sizes = np.empty(5)
    try:
        sizes[TRANSLATIONS], sizes[ROTATIONS] = noise_sizes(noise, "noise")
    except ValueError as error:
        raise InputError(path, f"[rigs.{rig}]", str(error), "") from None
    return sizes


def _with_noise(laxity: Laxity, sizes: Array | None) -> Laxity:
    """The table with the noise of its rig, where it states none itself."""
    if sizes is None or laxity.sd is not None:
        return laxity
    return replace(laxity, sd=np.where(laxity.is_measured, sizes, np.nan))


def joined(tables: Sequence[tuple[Experiment, Laxity]]) -> Laxity:
    """One laxity of all trials of several experiments.

    Trials keep their names unless two experiments have one of the same name: then all are called
    ``experiment/trial``.

    Raises
    ------
    ValueError
        If two experiments have one name, tables count coordinates from different zeros or have
        different correlations of errors, or only some of them state their noise.
    """
    experiments = tuple(x for x, _ in tables)
    names = [x.name for x in experiments]
    if twice := next((x for x in names if names.count(x) > 1), ""):
        raise ValueRefused(f"two experiments are called {twice}", "give each its own name")
    sided = [x for x in experiments if x.side]
    if other := next((x for x in sided if x.side != sided[0].side), None):
        raise ValueRefused(
            f"{sided[0].name} is of a {sided[0].side} knee, and {other.name} of a {other.side} one",
            "fit the two sides each alone: they are two knees",
        )
    laxities = [x for _, x in tables]
    zero = _common([x.zero for x in laxities], names, "count coordinates from", "convert one")
    if zero not in ("absolute", "unloaded", "opposite"):
        raise ValueRefused(
            f"the tables count coordinates from a trial, {zero}",
            "with several tables write zero: unloaded or opposite",
        )
    correlation = _common(
        [x.within_trial_correlation for x in laxities],
        names,
        "state within-trial correlations of",
        "state one for all",
    )
    without = [n for n, x in zip(names, laxities, strict=True) if x.sd is None]
    if without and len(without) < len(names):
        raise ValueRefused(
            f"{', '.join(without)} states no noise, and other tables do",
            "state that of all, in columns sd_ or as the noise of a rig",
        )
    has_phase = any(x.phase is not None for x in laxities)
    protocol = _joined_protocol(experiments, [x.protocol for x in laxities])
    return Laxity(
        protocol=protocol,
        coordinates=np.concatenate([x.coordinates for x in laxities]),
        sd=None if without else np.concatenate([_sd(x) for x in laxities]),
        within_trial_correlation=correlation,
        phase=tuple(p for x in laxities for p in x.phase or ("",) * x.n) if has_phase else None,
        comments=tuple(dict.fromkeys(c for x in laxities for c in x.comments)),
        zero=zero,
        forces=joined_forces([x.forces for x in laxities], [x.n for x in laxities]),
        superposition=_joined_superposition(laxities, protocol),
        is_definition_stated=all(x.is_definition_stated for x in laxities),
        findings=tuple(f for x in laxities for f in x.findings),
    )


def _joined_superposition(laxities: Sequence[Laxity], protocol: Protocol) -> Superposition | None:
    """The in-situ forces of all tables, under the names that their trials have in the whole."""
    names, parts = list(protocol.trials), []
    for x in laxities:
        whole = dict(zip(x.protocol.trials, names[: x.n], strict=True))
        names = names[x.n :]
        if x.superposition is not None:
            trials = tuple(whole[name] for name in x.superposition.trials)
            parts.append(replace(x.superposition, trials=trials))
    return joined_superpositions(parts)


def _joined_protocol(experiments: Sequence[Experiment], protocols: Sequence[Protocol]) -> Protocol:
    trials = [t for x in protocols for t in x.trials]
    if len(set(trials)) < len(trials):
        pairs = zip(experiments, protocols, strict=True)
        trials = [f"{x.name}/{t}" for x, y in pairs for t in y.trials]
    return Protocol(
        name="+".join(x.name for x in experiments),
        trials=tuple(trials),
        flexion_deg=np.concatenate([x.flexion_deg for x in protocols]),
        loads=np.concatenate([x.loads for x in protocols]),
        state=tuple(s for x in protocols for s in x.states),
        experiment=tuple(
            x.name for x, y in zip(experiments, protocols, strict=True) for _ in y.trials
        ),
        experiments=tuple(experiments),
    )


def _common(values: Sequence[Any], names: Sequence[str], what: str, remedy: str) -> Any:
    """The value that all tables share."""
    pairs = zip(values, names, strict=True)
    if other := next(((x, n) for x, n in pairs if x != values[0]), None):
        raise ValueRefused(f"{names[0]} and {other[1]} {what} {values[0]} and {other[0]}", remedy)
    return values[0]


def _sd(laxity: Laxity) -> Array:
    return np.full((laxity.n, 5), np.nan) if laxity.sd is None else laxity.sd
