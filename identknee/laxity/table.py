"""Laxity tables: reading, writing and comparing them, and adding noise."""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identknee.laxity.data_frame import Frame, is_frame
from identknee.laxity.experiments import cuts_of, state_words
from identknee.laxity.forces import (
    SD,
    MeasuredForces,
    Superposition,
    check_paths,
    column_of,
    force_columns,
    is_beyond_noise,
    quantity_of,
    write_superposition,
)
from identknee.laxity.gaps import gap_findings
from identknee.laxity.named_tables import TABLES, laxity_file
from identknee.laxity.protocol import (
    ABSOLUTE,
    BUILT_IN,
    FLEXION,
    LOADS,
    OPPOSITE,
    UNLOADED,
    Protocol,
    beyond,
    from_zero,
    load_protocol,
    name_fault,
    range_fault,
    selected_rows,
    unloaded_trials,
    zero_fault,
)
from identknee.laxity.spreadsheets import A_DATE, A_GAP, is_code, is_day, is_in_radians
from identknee.laxity.table_file import (
    STATEMENT,
    SUFFIXES,
    TIME,
    CellFile,
    TableRow,
    angles,
    coordinate_turns,
    correlation_fault,
    flexion_turns,
    is_from_straight,
    is_held,
    is_negative,
    levels,
    mean_curves,
    statements,
    written,
)
from identknee.laxity.translations import (
    COMPONENTS,
    Translations,
    from_components,
    sd_from_components,
    sd_of_components,
    to_components,
)
from identknee.runs.declare import (
    OF_COORDINATE,
    Array,
    BoolArray,
    IntArray,
    array,
    declared,
    entry,
    name_axis,
)
from identknee.runs.errors import InputError, ValueRefused, suggestion
from identknee.runs.files import PathLike, write_atomically
from identknee.runs.findings import Finding, finding

COORDINATES = (
    "lateral_shift_mm",
    "anterior_drawer_mm",
    "distraction_mm",
    "varus_deg",
    "internal_deg",
)
name_axis("coordinate", COORDINATES)
TRANSLATIONS = slice(0, 3)
ROTATIONS = slice(3, 5)
PHASES = ("loading", "unloading")
LARGEST_ORDER = 10**9
OPPOSITE_LOADS = {
    "external_moment_Nm": "internal_moment_Nm",
    "valgus_moment_Nm": "varus_moment_Nm",
    "posterior_force_N": "anterior_force_N",
    "compression_force_N": "distraction_force_N",
    "medial_force_N": "lateral_force_N",
}
"""Columns of loads of the opposite sign, and the column that each is the negative of."""
# The coordinate along which each load acts.
WORKS_ON = (
    "internal_deg",
    "varus_deg",
    "anterior_drawer_mm",
    "distraction_mm",
    "lateral_shift_mm",
)
OPPOSITE_COORDINATES = {
    "medial_shift_mm": "lateral_shift_mm",
    "posterior_drawer_mm": "anterior_drawer_mm",
    "valgus_deg": "varus_deg",
    "external_deg": "internal_deg",
}
"""Columns of coordinates of the opposite sign, and the column that each is the negative of."""
OPPOSITES = {**OPPOSITE_LOADS, **OPPOSITE_COORDINATES}
# Read as radians, angles beyond this are larger than any joint turns: the file holds degrees.
MOST_TURNED_DEG = 400.0
# Coordinates beyond these are in other units or about other axes.
ANGLE_LIMIT_DEG, LENGTH_LIMIT_MM = 180.0, 200.0

_SD = tuple(f"sd_{column}" for column in COORDINATES)
_ALONG = tuple(COORDINATES.index(x) for x in WORKS_ON)
_COLUMNS = ("trial", FLEXION, *LOADS, *COORDINATES, *_SD, "order", "phase", "state")


@declared
class Laxity:
    """Pose of the tibia in each trial of a protocol, measured or simulated.

    A coordinate states the standard deviation of its errors for all its measured trials or, with
    NaN, for none.

    Raises
    ------
    ValueError
        If shapes differ, or a value breaks a rule.
    """

    protocol: Protocol = entry("The trials", group="constant_data")
    coordinates: Array = array(
        "Lateral shift, anterior drawer, distraction, varus, internal rotation; NaN where not "
        "measured",
        *("trial", "coordinate"),
        unit=OF_COORDINATE,
    )
    sd: Array | None = array(
        "Standard deviation of their errors; None where none is stated",
        *("trial", "coordinate"),
        unit=OF_COORDINATE,
        default=None,
    )
    within_trial_correlation: float = entry(
        "Correlation that the five errors of a trial share, above -0.25 and below 1",
        unit="1",
        default=0.0,
    )
    order: IntArray | None = array(
        "When each trial was made; None where unknown", "trial", dtype=int, default=None
    )
    phase: tuple[str, ...] | None = entry(
        "loading, unloading or neither (empty) for each trial; None where unknown", default=None
    )
    comments: tuple[str, ...] = entry("Free text that goes with the table", default=())
    zero: str = entry(
        "absolute for Grood-Suntay coordinates, unloaded where they are changes from the unloaded "
        "pose of the same flexion angle, opposite where they are changes from the trial with the "
        "opposite load, and the name of a trial where they are changes from that one",
        default="absolute",
    )
    forces: MeasuredForces | None = entry(
        "Forces that were measured beside the pose; None without any",
        group="measured_forces",
        default=None,
    )
    superposition: Superposition | None = entry(
        "In-situ forces of structures that were cut, from replayed paths; None without any",
        group="superposition",
        default=None,
    )
    is_definition_stated: bool = entry(
        "Whether it is known that the translations are components, or were made so; False of a "
        "file that does not say it",
        is_in_json=False,
        default=True,
    )
    findings: tuple[Finding, ...] = entry(
        "Findings: what reading a file did to its numbers; answers have them among their own",
        is_in_json=False,
        default=(),
    )

    def __post_init__(self) -> None:
        coordinates = self.coordinates
        if np.isinf(coordinates).any():
            raise ValueError("coordinates must be finite, or NaN where not measured")
        object.__setattr__(self, "sd", _checked_sd(self.sd, coordinates))
        if fault := correlation_fault(self.within_trial_correlation):
            raise ValueError(". ".join(fault))
        if self.phase is not None:
            object.__setattr__(self, "phase", tuple(self.phase))
            if len(self.phase) != self.n or not set(self.phase) <= {*PHASES, ""}:
                raise ValueError(f"phase must hold {self.n} of {PHASES} or '', got {self.phase}")
        object.__setattr__(self, "comments", tuple(line.strip() for line in self.comments))
        for line in self.comments:
            if STATEMENT.fullmatch(line) or "\n" in line or "\r" in line:
                raise ValueError(f"a comment is one line and states no setting, got {line!r}")
        if fault := zero_fault(self.zero, self.protocol, self.coordinates):
            raise ValueError(". ".join(fault))
        if self.superposition is not None:
            check_paths(self.superposition, self.protocol)

    @property
    def n(self) -> int:
        """How many trials there are."""
        return self.protocol.n

    @property
    def is_measured(self) -> BoolArray:
        """Whether a coordinate has a value, shape ``(n, 5)``."""
        return ~np.isnan(self.coordinates)

    @property
    def n_values(self) -> int:
        """How many coordinates and forces, also in-situ forces, were measured."""
        n = 0 if self.forces is None else int(self.forces.is_measured.sum())
        m = 0 if self.superposition is None else self.superposition.n_values
        return int(self.is_measured.sum()) + n + m

    @property
    def has_forces(self) -> bool:
        """Whether forces were measured: in trials, or from replayed paths."""
        return self.forces is not None or self.superposition is not None

    def without_forces(self) -> "Laxity":
        """The coordinates alone."""
        return replace(self, forces=None, superposition=None) if self.has_forces else self

    def without(self, lost: BoolArray) -> "Laxity":
        """The laxity with the values of the trials `lost` (n,) left blank."""
        if not lost.any():
            return self
        return replace(
            self,
            coordinates=np.where(lost[:, None], np.nan, self.coordinates),
            forces=None if self.forces is None else self.forces.without(lost),
            superposition=self._superposition_of(np.flatnonzero(~lost)),
        )

    def select(self, indices: ArrayLike) -> "Laxity":
        """The trials at `indices` (whole numbers, or a mask of n truth values), in that order.

        Raises
        ------
        ValueError
            If an index is out of range or given twice.
        """
        chosen = selected_rows(indices, self.n)
        return Laxity(
            protocol=self.protocol.select(chosen),
            coordinates=self.coordinates[chosen],
            sd=None if self.sd is None else self.sd[chosen],
            within_trial_correlation=self.within_trial_correlation,
            order=None if self.order is None else self.order[chosen],
            phase=None if self.phase is None else tuple(self.phase[i] for i in chosen),
            comments=self.comments,
            zero=self.zero,
            forces=None if self.forces is None else self.forces.select(chosen),
            superposition=self._superposition_of(chosen),
            is_definition_stated=self.is_definition_stated,
            findings=self.findings,
        )

    def _superposition_of(self, trials: ArrayLike) -> Superposition | None:
        """The in-situ forces of the trials at these places."""
        if self.superposition is None:
            return None
        return self.superposition.of_trials(self.protocol.trials[i] for i in np.asarray(trials))


def read_laxity(path: PathLike | Frame, *, is_measured: bool = True) -> Laxity:
    """Laxity of a CSV file with one row a trial, or of a named subject such as ``"s192803"``.

    A pandas ``DataFrame`` is read by the same rules: NaN is a blank, a named index is a column, and
    ``attrs`` hold what comment lines state, as in ``frame.attrs["zero"] = "unloaded"``.

    Columns are ``trial``, ``flexion_deg``, any of `LOADS` (zero where missing) or of the opposite
    ones in `OPPOSITES`, such as ``valgus_moment_Nm``, any of `COORDINATES`, ``sd_`` and the
    name of a coordinate, ``order``, ``phase`` and ``state`` of the knee: ``intact``, ``cut: ACL``,
    ``cut: ACL, dMCL`` or, for half of it, ``cut: ACL 50%``; and forces that were measured, such as
    ``ACL_tension_N`` or ``contact_medial_N``, each with its ``sd_``. Blanks were not measured.
    Cells are separated by commas; where the header has semicolons or tabs instead, by those, and
    then numbers may have decimal commas. A first column without a name that counts rows, a row of
    units that are those of the columns, and UTF-16 are fine. Comment lines start with ``#``; some
    state something:
    ``# within_trial_correlation: 0.3``, ``# zero:`` with ``unloaded``, ``opposite`` or the name
    of a trial, and ``# translations:`` with ``components`` (of Grood and Suntay), ``projections``
    (on the same axes), ``femur`` or ``tibia`` (axes of a bone). The protocol is called after the
    file. A name stands for the table that comes with
    identknee even where a file is called so:
    write ``"./s192803"``, or give a `pathlib.Path`, for the file. A table of trials that are to be
    predicted need not have coordinates: say so with `is_measured`.

    Raises
    ------
    InputError
        If the file breaks a rule; the message names the row (the line number in the file), the
        column and what to do.
    """
    check_is_table(path)
    is_named = isinstance(path, str) and path in TABLES
    with CellFile.open(path if is_frame(path) else laxity_file(path)) as file:
        file.read_renamed_columns()
        file.read_opposite_columns(OPPOSITES)
        is_series = TIME in file.columns
        names, table, extra = _curves(file) if is_series else _trials(file, is_measured=is_measured)
    loads, coordinates = 1 + len(LOADS), 1 + len(LOADS) + len(COORDINATES)
    protocol = Protocol(
        name=file.path.stem,
        trials=names,
        flexion_deg=table[:, 0],
        loads=table[:, 1:loads],
        state=extra.pop("state", None),
    )
    measured = table[:, loads:coordinates]
    said = statements(file, protocol, measured)
    gaps = () if is_series else gap_findings(protocol, measured, said.zero, _ALONG)
    sd = table[:, coordinates:]
    if said.translations != COMPONENTS:
        _check_needed(file.path, protocol, measured, said.translations)
        flexion, stated = protocol.flexion_deg, ~np.isnan(sd)
        if stated[:, TRANSLATIONS].any():
            sd = sd_of_components(said.translations, flexion, measured, sd)
        measured = to_components(said.translations, flexion, measured)
    return Laxity(
        protocol=protocol,
        coordinates=measured,
        sd=sd,
        within_trial_correlation=said.correlation,
        comments=said.comments,
        zero=said.zero,
        is_definition_stated=said.is_definition_stated or is_named,
        findings=(*file.findings, *gaps),
        **extra,
    )


def check_is_table(given: object) -> None:
    """Refuse an object that cannot be read as a laxity table.

    Raises
    ------
    ValueRefused
        The message names the kinds that can.
    """
    if not (isinstance(given, str | os.PathLike) or is_frame(given)):
        raise ValueRefused(
            f"the {type(given).__name__} is not a laxity table",
            "give a path, a Laxity, a pandas DataFrame or the name of a subject with a table",
        )


def _check_needed(
    path: Path, protocol: Protocol, coordinates: Array, definition: Translations
) -> None:
    """Refuse a row whose components depend on a value that was not measured."""
    made = to_components(definition, protocol.flexion_deg, coordinates)
    known = ~np.isnan(coordinates)
    angles = known[:, 4] if definition == "tibia" else np.ones(protocol.n, bool)
    has_angles = known[:, 3] & angles
    lost = (known[:, TRANSLATIONS] & np.isnan(made[:, TRANSLATIONS])).any(axis=1)
    lost |= known[:, TRANSLATIONS].any(axis=1) & ~has_angles
    if lost.any():
        trial = protocol.trials[int(np.flatnonzero(lost)[0])]
        raise InputError(
            path,
            f"trial {trial}",
            f"translations as {definition} depend on one another and on the angles, and some of "
            "them are blank",
            "Fill in varus, internal rotation and all translations, or leave all of these blank.",
        )


def write_laxity(
    laxity: Laxity, path: PathLike, *, translations: Translations = COMPONENTS
) -> Path:
    """Path of a CSV file that now holds `laxity`, and that `read_laxity` reads back equal.

    Numbers are the shortest that read back bit for bit; the protocol's name is not written. In-situ
    forces of replayed paths have a table of their own: that of ``a.csv`` is ``a_insitu.csv`` beside
    it, for the line ``superposition`` of an experiments file.

    Parameters
    ----------
    laxity
        What to write.
    path
        Where.
    translations
        Definition of the translations in the file; `laxity` has components. Others read back equal
        but for rounding.

    Raises
    ------
    InputError
        If the file cannot be written.
    ValueError
        If another definition is wanted of coordinates that are not absolute.
    """
    if translations != COMPONENTS:
        if laxity.zero != ABSOLUTE:
            raise ValueError(
                f"translations as {translations} can be written only of absolute coordinates, and "
                f"these count from {laxity.zero}; leave out --translations"
            )
        flexion, sd = laxity.protocol.flexion_deg, laxity.sd
        laxity = replace(
            laxity,
            coordinates=from_components(translations, flexion, laxity.coordinates),
            sd=None
            if sd is None
            else sd_from_components(translations, flexion, laxity.coordinates, sd),
        )
    lines = [f"# {comment}".rstrip() for comment in laxity.comments]
    if laxity.within_trial_correlation != 0:
        lines.append(f"# within_trial_correlation: {float(laxity.within_trial_correlation)!r}")
    if laxity.zero != ABSOLUTE:
        lines.append(f"# zero: {laxity.zero}")
    if translations != COMPONENTS:
        lines.append(f"# translations: {translations}")
    protocol = laxity.protocol
    header = ["trial", FLEXION, *LOADS, *COORDINATES]
    blocks = [protocol.flexion_deg[:, None], protocol.loads, laxity.coordinates]
    if laxity.sd is not None:
        stated = [j for j in range(len(COORDINATES)) if not np.isnan(laxity.sd[:, j]).all()]
        header += [_SD[j] for j in stated]
        blocks.append(laxity.sd[:, stated])
    if laxity.forces is not None:
        columns = [column_of(x) for x in laxity.forces.names]
        header += [*columns, *(f"{SD}{x}" for x in columns)]
        blocks += [laxity.forces.values, laxity.forces.sd]
    rows = [
        [trial, *("" if math.isnan(x) else repr(x) for x in values)]
        for trial, values in zip(protocol.trials, np.hstack(blocks).tolist(), strict=True)
    ]
    others = {"order": laxity.order, "phase": laxity.phase, "state": protocol.state}
    for name, extra in others.items():
        if extra is not None:
            header.append(name)
            for row, value in zip(rows, extra, strict=True):
                row.append(str(value))
    lines += [written(cells) for cells in (header, *rows)]
    if laxity.superposition is not None:
        own = Path(path)
        write_superposition(laxity.superposition, own.with_name(f"{own.stem}_insitu{own.suffix}"))
    return write_atomically(path, "\n".join(lines) + "\n")


def _trials(file: CellFile, *, is_measured: bool) -> tuple[tuple[str, ...], Array, dict[str, Any]]:
    """Names of trials, their numbers, and what else is known of them, from one row a trial."""
    forces = force_columns(file.columns)
    sds = tuple(f"{SD}{x}" for x in forces)
    file.check_columns((*_COLUMNS, *OPPOSITES, *forces, *sds), ("trial", FLEXION, *sds))
    if is_measured:
        _check_coordinates(file)
    names: dict[str, int] = {}
    numbers: list[tuple[float, ...]] = []
    order: list[int] = []
    phase: list[str] = []
    states: list[str] = []
    measured: list[tuple[list[float], list[float]]] = []
    rows = list(file.rows())
    _turn_angles(file, rows)
    for row in rows:
        name = row.text("trial")
        if fault := name_fault(name):
            row.refuse("trial", *fault)
        if name in names:
            row.refuse(
                "trial",
                f"{name!r} already names the trial of {file.place(names[name])}",
                "Give each trial its own name; replicates of one load are welcome.",
            )
        names[name] = row.line
        numbers.append((*_setting(row), *_measured(row)))
        measured.append(_forces(row, forces))
        if "order" in file.columns:
            value = row.required("order")
            if value != int(value) or abs(value) > LARGEST_ORDER:
                why = f"{value:g} is not a whole number"
                row.refuse("order", why, "Count the trials 1, 2, 3 and so on.")
            order.append(int(value))
        if "state" in file.columns:
            states.append(_state(row))
        if "phase" in file.columns:
            phase.append(row.text("phase").lower())
            if phase[-1] not in {*PHASES, ""}:
                why = f"the phase {phase[-1]!r} is unknown"
                row.refuse("phase", why, "Write loading or unloading, or leave it blank.")
    if not names:
        raise InputError(
            file.path, "", "there is no trial below the header", "Add one row per trial."
        )
    extra: dict[str, Any] = {
        "order": np.array(order) if order else None,
        "phase": tuple(phase) or None,
    }
    if forces:
        values, sd = np.array(measured).transpose(1, 0, 2)
        own = tuple(map(quantity_of, forces))
        extra["forces"] = MeasuredForces(names=own, values=values, sd=sd)
    return tuple(names), np.array(numbers), extra | {"state": tuple(states) or None}


def _forces(row: TableRow, columns: Sequence[str]) -> tuple[list[float], list[float]]:
    """Forces of a trial and their standard deviations; NaN where blank."""
    values, spreads = [], []
    for column in columns:
        value = row.number(column, "this force was not measured")
        spread = row.number(f"{SD}{column}", "its force is blank too")
        if value is not None and not (spread is not None and spread > 0.0):
            why = f"{column} is measured and has no standard deviation greater than 0"
            row.refuse(f"{SD}{column}", why, "Give it in N.")
        if value is not None and is_beyond_noise(value, spread or 0.0):
            why = (
                f"the force is {value:g} N, further below 0 than its noise of {spread:g} N explains"
            )
            row.refuse(column, why, "Give how hard it pulls or presses.")
        values.append(math.nan if value is None else value)
        spreads.append(math.nan if spread is None else spread)
    return values, spreads


def _state(row: TableRow) -> str:
    """The state of the knee in a trial; intact where it is blank."""
    try:
        return state_words(cuts_of(row.text("state")))
    except ValueRefused as error:
        row.refuse("state", error.why, error.advice)


def _curves(file: CellFile) -> tuple[tuple[str, ...], Array, dict[str, Any]]:
    """Trials from a time series: points of the mean loading curve of each ramp."""
    file.check_columns((TIME, "trial", FLEXION, *LOADS, *COORDINATES, *OPPOSITES), (FLEXION,))
    _check_coordinates(file)
    ramps: list[str] = []
    samples: list[tuple[float, ...]] = []
    cells = list(file.rows())
    _turn_angles(file, cells)
    for row in cells:
        ramps.append(row.text("trial") or file.path.stem)
        samples.append((row.required(TIME), *_setting(row), *_measured(row)[: len(COORDINATES)]))
    if not samples:
        raise InputError(file.path, "", "there is no sample below the header", "Add some.")
    made = np.array(samples)
    names, rows = mean_curves(file.path, ramps, made, levels(file), angles(file))
    groups = {x: made[[i for i, y in enumerate(ramps) if y == x]] for x in dict.fromkeys(ramps)}
    for ramp, own in groups.items():
        if is_held(own):
            span = (float(own[:, 1].min()), float(own[:, 1].max()))
            values = {"ramp": ramp, "from_deg": span[0], "to_deg": span[1]}
            file.findings.append(finding("flexed-under-load", ramp, values))
    return names, rows, {}


def _check_counting(file: CellFile, rows: Sequence[TableRow], values: Array) -> None:
    """Refuse flexion counted in another way, such as from 180 deg, and say what reads it."""
    own = file.sources.get(FLEXION, (FLEXION, 1.0, 0.0))[0]
    ways = (
        (is_from_straight, np.nanargmax, "counts from a straight knee at 180 deg", f"180 - {own}"),
        (is_negative, np.nanargmin, "grows towards negative angles", f"-1 * {own}"),
    )
    for is_so, place, how, line in ways:
        if is_so(values):
            row = rows[int(place(values))]
            why = f"flexion {how}, here {row.number(FLEXION):g}"
            row.refuse(FLEXION, why, f"Write as a line of the file: # column: {FLEXION} = {line}")
    # Of other tables `identknee.checks.broken_convention` asks it, with a fit.
    if file.path.suffix.lower() in SUFFIXES and is_in_radians(values):
        row = rows[int(np.nanargmax(values))]
        why = f"flexion is in radians, here {row.number(FLEXION):g}, where a line says degrees"
        row.refuse(FLEXION, why, "Write inDegrees=no above endheader.")


def _turn_angles(file: CellFile, rows: Sequence[TableRow]) -> None:
    """Add to angles the whole turns that cut them off, and refuse flexion from a straight knee."""
    for column in (FLEXION, *(x for x in COORDINATES if x.endswith("_deg"))):
        if column not in file.columns:
            continue
        values = np.array([_known(row, column) for row in rows])
        stated = file.in_radians.get(column)
        if stated and values.size and np.nanmax(np.abs(values)) > MOST_TURNED_DEG:
            why = f"{stated}, and in radians these are too large"
            file.refuse(1, column, why, "Write inDegrees=yes above endheader if they are degrees.")
        if column == FLEXION:
            _check_counting(file, rows, values)
        turns = (flexion_turns if column == FLEXION else coordinate_turns)(values)
        if turned := np.flatnonzero(turns).tolist():
            file.turns |= {(rows[i].line, column): turns[i] for i in turned}
            first = turned[0]
            values_said = {
                "n": len(turned),
                "column": column,
                "given_deg": float(values[first]),
                "read_deg": float(values[first] + turns[first]),
            }
            file.findings.append(finding("angle-turned", column, values_said))


def _known(row: TableRow, column: str) -> float:
    """A number; NaN where the cell is blank or is refused later, when the row is read."""
    try:
        value = row.number(column)
    except InputError:
        return math.nan
    return math.nan if value is None else value


def _checked_sd(sd: Array | None, coordinates: Array) -> Array | None:
    if sd is None or np.isnan(sd).all():
        return None
    if not (np.isnan(sd) | ((sd > 0) & (sd < np.inf))).all():
        raise ValueError("a standard deviation must be greater than 0 and finite, or NaN")
    for column, values, measured in zip(COORDINATES, sd.T, coordinates.T, strict=True):
        needed = np.isnan(values) & ~np.isnan(measured)
        if needed.any() and not np.isnan(values).all():
            raise ValueError(
                f"{column} has a standard deviation in some trials only: give all or none"
            )
    return sd


def _check_coordinates(file: CellFile) -> None:
    if not any(column in file.columns for column in COORDINATES):
        file.refuse(
            file.header_line,
            "",
            "no column holds a coordinate",
            f"Add one or more of {', '.join(COORDINATES)}.",
        )
    for column, sd in zip(COORDINATES, _SD, strict=True):
        if sd in file.columns and column not in file.columns:
            file.refuse(
                file.header_line,
                sd,
                f"there is no column {column} for this standard deviation",
                "Add it or remove this one.",
            )


def _setting(row: TableRow) -> list[float]:
    values = []
    for column in (FLEXION, *LOADS):
        value = row.required(column) if column in row.file.columns else 0.0
        if fault := range_fault(column, value):
            row.refuse(column, *fault)
        values.append(value)
    return values


def _measured(row: TableRow) -> list[float]:
    """Coordinates, then standard deviations."""
    coordinates, spreads = [], []
    for column, sd in zip(COORDINATES, _SD, strict=True):
        value = row.number(column, "nothing was measured")
        is_turned = (row.line, column) in row.file.turns
        if value is not None and not is_turned and (fault := _coordinate_fault(column, value)):
            row.refuse(column, *fault)
        spread = row.number(sd, "its coordinate is blank too")
        if spread is not None and spread <= 0:
            row.refuse(
                sd,
                f"the standard deviation is {spread:g}",
                "It must be greater than 0; remove the column if it is unknown.",
            )
        if spread is None and value is not None and sd in row.file.columns:
            row.refuse(
                sd,
                f"{column} is measured but its standard deviation is blank",
                "Give it in every such row, or remove the column.",
            )
        coordinates.append(math.nan if value is None else value)
        spreads.append(math.nan if spread is None else spread)
    return coordinates + spreads


def _coordinate_fault(column: str, value: float) -> tuple[str, str] | None:
    """Why no knee has this coordinate, and the remedy; None if one may."""
    if column.endswith("_deg"):
        remedy = "Give angles in degrees, 0 where the axes of both bones agree."
        remedy = A_DATE if is_day(value) else A_GAP if is_code(value) else remedy
        return beyond("an angle", value, ANGLE_LIMIT_DEG, "deg", remedy)
    remedy = "Give lengths in mm, from the femoral to the tibial origin."
    remedy = A_DATE if is_day(value) else A_GAP if is_code(value) else remedy
    return beyond("a translation", value, LENGTH_LIMIT_MM, "mm", remedy)


def relative_to_unloaded(laxity: Laxity) -> Laxity:
    """The laxity as changes from the unloaded pose of each flexion angle.

    Replicates of the unloaded trial are averaged over those that measured the coordinate; where
    none did, the change is not measured either. A standard deviation of a loaded trial becomes that
    of the difference; unloaded trials keep their own. Laxity that is relative to the unloaded pose
    already is returned as it is.

    Raises
    ------
    ValueError
        If a flexion angle has no unloaded trial, or coordinates are changes from the trial with the
        opposite load, which do not tell where the unloaded pose is.
    """
    if laxity.zero == UNLOADED:
        return laxity
    if laxity.zero == OPPOSITE:
        raise ValueError(
            "changes from the trial with the opposite load do not tell where the unloaded pose is; "
            "give absolute coordinates"
        )
    measured = laxity.is_measured
    zeros = np.empty(laxity.coordinates.shape)
    variances = np.empty(laxity.coordinates.shape)
    filled = np.where(measured, laxity.coordinates, 0.0)
    squares = np.zeros_like(filled) if laxity.sd is None else np.where(measured, laxity.sd**2, 0.0)
    for row, unloaded in enumerate(unloaded_trials(laxity.protocol)):
        count = measured[unloaded].sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            zeros[row] = filled[unloaded].sum(axis=0) / count
            variances[row] = squares[unloaded].sum(axis=0) / count**2
    sd = laxity.sd
    if sd is not None:
        added = np.where(laxity.protocol.is_unloaded[:, None] | np.isnan(variances), 0.0, variances)
        sd = np.sqrt(sd**2 + added)
    return replace(laxity, coordinates=laxity.coordinates - zeros, sd=sd, zero=UNLOADED)


@declared
class LaxityError:
    """Root-mean-square differences of two laxities; NaN where nothing was compared."""

    mm: float = entry("Error of the three translations", unit="mm")
    deg: float = entry("Error of varus and internal rotation", unit="deg")
    by_coordinate: Array = array(
        "Error of each coordinate", "coordinate", unit=OF_COORDINATE, group="errors"
    )
    flexion_deg: Array = array("Flexion angles, ascending", "flexion", unit="deg", group="errors")
    by_flexion: Array = array(
        "Error at each flexion angle",
        *("flexion", "coordinate"),
        unit=OF_COORDINATE,
        group="errors",
    )
    n_compared: int = entry("Measured values with a prediction", unit="1")
    n_missing: int = entry(
        "Measured values without one; they are left out, which makes the errors too small", unit="1"
    )


def laxity_rmse(simulated: Laxity, measured: Laxity) -> LaxityError:
    """Root-mean-square difference over all that was measured.

    Absolute coordinates of `simulated` are first counted from the zero of `measured`.

    Raises
    ------
    ValueError
        If the trials differ, or `simulated` counts from other poses than `measured`.
    """
    if simulated.protocol.trials != measured.protocol.trials:
        raise ValueError(
            "the two laxities have different trials. Simulate the protocol of the measured one."
        )
    if simulated.zero not in (ABSOLUTE, measured.zero):
        raise ValueError(
            f"the simulated laxity has the zero {simulated.zero} and the measured one "
            f"{measured.zero}. Give the simulated one in absolute coordinates."
        )
    shown = simulated.coordinates
    if measured.zero == UNLOADED:
        shown = relative_to_unloaded(simulated).coordinates
    elif simulated.zero == ABSOLUTE:
        shown = from_zero(shown, simulated.protocol, measured.zero)
    squares = (shown - measured.coordinates) ** 2
    compared = ~np.isnan(squares)
    flexion = np.unique(measured.protocol.flexion_deg)
    rows = [measured.protocol.flexion_deg == angle for angle in flexion]
    return LaxityError(
        mm=root_mean(squares[:, TRANSLATIONS]),
        deg=root_mean(squares[:, ROTATIONS]),
        by_coordinate=np.array([root_mean(column) for column in squares.T]),
        flexion_deg=flexion,
        by_flexion=np.array([[root_mean(x) for x in squares[row].T] for row in rows]).reshape(
            len(rows), len(COORDINATES)
        ),
        n_compared=int(compared.sum()),
        n_missing=int((measured.is_measured & np.isnan(shown)).sum()),
    )


def root_mean(squares: Array) -> float:
    """Root of the mean of the squares that are not NaN; NaN where there is none."""
    values = squares[~np.isnan(squares)]
    return float(np.sqrt(values.mean())) if values.size else float("nan")


def add_noise(
    laxity: Laxity,
    *,
    sd_mm: float,
    sd_deg: float,
    seed: int | np.random.SeedSequence,
    correlation: float = 0.0,
    student_degrees: float | None = None,
) -> Laxity:
    """`laxity` with random errors added and their size stated.

    The errors of a trial are ``sd * (L z)`` with ``L L' = (1 - r) I + r`` (Cholesky) and five
    independent standard draws ``z``, so that standard deviations and correlation are exact for
    either distribution; trials are independent. Coordinates not measured stay so, and do not change
    the errors of the others.

    Parameters
    ----------
    laxity
        Without noise so far.
    sd_mm, sd_deg
        Standard deviation of translations [mm] and rotations [deg], > 0.
    seed
        Whole number or seed sequence; the same seed gives the same errors.
    correlation
        What the five errors of a trial share, above -0.25 and below 1.
    student_degrees
        Degrees of freedom, > 2, of a Student t distribution scaled to the standard deviations: the
        fewer, the heavier its tails. Normal where None.

    Raises
    ------
    ValueError
        If a setting is out of range or `laxity` states a noise already.
    """
    for name, value in (("sd_mm", sd_mm), ("sd_deg", sd_deg)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name} must be greater than 0 and finite, got {value:g}")
    if fault := correlation_fault(correlation):
        raise ValueError(". ".join(fault))
    if student_degrees is not None and not 2 < student_degrees < np.inf:
        raise ValueError(
            f"student_degrees must be greater than 2 for a finite spread, got {student_degrees:g}"
        )
    if laxity.sd is not None:
        raise ValueError("the laxity has standard deviations already: add noise once only")
    n_coordinates = len(COORDINATES)
    sd = np.empty((laxity.n, n_coordinates))
    sd[:, TRANSLATIONS], sd[:, ROTATIONS] = sd_mm, sd_deg
    shared = np.full((n_coordinates, n_coordinates), correlation)
    np.fill_diagonal(shared, 1.0)
    generator = np.random.default_rng(seed)
    if student_degrees is None:
        draws = generator.standard_normal(sd.shape)
    else:
        scale = np.sqrt((student_degrees - 2) / student_degrees)
        draws = scale * generator.standard_t(student_degrees, sd.shape)
    # Fixed loops instead of a matrix product, whose last bit depends on the machine's library.
    errors = np.einsum("ij,nj->ni", np.linalg.cholesky(shared), draws)
    return replace(
        laxity,
        coordinates=laxity.coordinates + sd * errors,
        sd=sd,
        within_trial_correlation=correlation,
    )


TABLE_FILES = (".csv", *SUFFIXES)

# `Laxity` is not listed, because verbs take it as data in their types; it is read like a frame.
TrialsLike = Protocol | Frame | PathLike
"""A protocol, the name or file of one, or a laxity table whose trials are meant."""


def read_tests(given: TrialsLike | Laxity) -> Protocol | Laxity:
    """The trials of a protocol or table, as a laxity table if they come from one.

    Parameters
    ----------
    given
        A protocol, the name of one (``"seed63"``), its TOML file, a laxity table (CSV, `Laxity` or
        pandas ``DataFrame``), or the name of a subject that comes with measured laxity
        (``"s192803"``). The table need not hold any measured value.

    Raises
    ------
    InputError
        If there is nothing of this name, or the file breaks a rule.
    """
    if isinstance(given, Protocol | Laxity):
        return given
    if is_frame(given):
        return read_laxity(given, is_measured=False)
    path = Path(given)
    if given in TABLES or path.suffix.lower() in TABLE_FILES:
        return read_laxity(given, is_measured=False)
    if given not in BUILT_IN and path.suffix == "" and not path.exists():
        raise InputError(
            path,
            "",
            "there is no protocol and no file of this name",
            f"{suggestion(str(path), (*BUILT_IN, *TABLES))} "
            "Or give a protocol (TOML) or a laxity table (CSV).",
        )
    return load_protocol(given)


def read_trials(given: TrialsLike | Laxity) -> Protocol:
    """The trials of a protocol or table; see `read_tests`.

    Examples
    --------
    >>> read_trials("drawer").n, read_trials("s192803").n
    (9, 25)
    """
    tests = read_tests(given)
    return tests.protocol if isinstance(tests, Laxity) else tests


def example_laxity(name: str) -> Laxity:
    """The measured laxity of a named subject, which comes with identknee.

    Parameters
    ----------
    name
        ``"s192803"``: 25 end points of a robotic knee simulator; ``"s192803_bundles"``, the same
        specimen, has the same table.

    Raises
    ------
    ValueError
        If there is no such table; the message lists them.

    Examples
    --------
    >>> example_laxity("s192803").n
    25
    """
    if name not in TABLES:
        raise ValueError(f"no laxity of {name!r} comes with identknee. {suggestion(name, TABLES)}")
    return read_laxity(name)
