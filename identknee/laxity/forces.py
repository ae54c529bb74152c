"""Forces measured beside the pose: of structures in trials, and in situ by superposition.

For superposition a robot replays the path of a trial before and after a cut. The pose is the same,
so the change of the load on the tibia is the wrench that the structure exerted on it.

References
----------
.. [1] Fujie et al. (1995), J. Biomech. Eng. 117(1), 1-7. https://doi.org/10.1115/1.2792266
.. [2] Sakane et al. (1997), J. Orthop. Res. 15(2), 285-293.
       https://doi.org/10.1002/jor.1100150219
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from identknee.laxity.experiments import Cut, cuts_of, state_words
from identknee.laxity.protocol import Protocol
from identknee.laxity.table_file import CellFile, TableRow, written
from identknee.runs.declare import Array, BoolArray, array, declared, entry, name_axis
from identknee.runs.errors import ValueRefused, suggestion
from identknee.runs.files import PathLike, write_atomically

_COLUMN = re.compile(r"(?P<ligament>.+)_tension_N|contact_(?P<side>medial|lateral)_N")
SD = "sd_"
# The reading of a slack ligament scatters around 0. Below minus this many standard deviations it is
# not noise.
MOST_BELOW_ZERO = 4.0


@declared
class MeasuredForces:
    """Forces in the n trials of a table, each with a standard deviation.

    Raises
    ------
    ValueError
        If a force has no standard deviation above 0, or is further below zero than noise explains.
    """

    names: tuple[str, ...] = array(
        "Name of the predicted quantity, such as `ACL.tension_N`", "force", is_in_arrays=False
    )
    values: Array = array("Forces; NaN where not measured", "trial", "force", unit="N")
    sd: Array = array("Standard deviation of their errors", "trial", "force", unit="N")

    def __post_init__(self) -> None:
        measured = self.is_measured
        sd = self.sd[measured]
        if not (np.isfinite(sd).all() and (sd > 0.0).all()):
            raise ValueError("every measured force needs a standard deviation greater than 0")
        if np.any(is_beyond_noise(self.values[measured], sd)):
            raise ValueError(
                f"a measured force is more than {MOST_BELOW_ZERO:g} standard deviations below 0: "
                "give how hard a structure pulls or presses [N]"
            )

    @property
    def is_measured(self) -> BoolArray:
        """Whether a force has a value, shape ``(n, k)``."""
        return np.isfinite(self.values)

    def select(self, rows: ArrayLike) -> "MeasuredForces":
        """Those of some trials, by their places or a mask."""
        chosen = np.asarray(rows)
        return replace(self, values=self.values[chosen], sd=self.sd[chosen])

    def without(self, lost: BoolArray) -> "MeasuredForces":
        """Those with the trials `lost` (n,) blank."""
        return replace(self, values=np.where(lost[:, None], np.nan, self.values))


def is_beyond_noise(value: ArrayLike, sd: ArrayLike) -> BoolArray:
    """Whether a force is so far below zero that noise of that size does not explain it.

    Examples
    --------
    >>> is_beyond_noise([-3.0, -30.0], 5.0).tolist()
    [False, True]
    """
    return np.asarray(np.asarray(value) < -MOST_BELOW_ZERO * np.asarray(sd))


def quantity_of(column: str) -> str:
    """The quantity that a column of forces holds; empty for another column.

    Examples
    --------
    >>> quantity_of("ACL_tension_N"), quantity_of("contact_medial_N"), quantity_of("varus_deg")
    ('ACL.tension_N', 'contact.medial_N', '')
    """
    found = _COLUMN.fullmatch(column)
    if found is None or column.startswith(SD):
        return ""
    return f"{found['ligament']}.tension_N" if found["ligament"] else f"contact.{found['side']}_N"


def column_of(quantity: str) -> str:
    """The column that holds a quantity.

    Examples
    --------
    >>> column_of("ACL.tension_N"), column_of("contact.medial_N")
    ('ACL_tension_N', 'contact_medial_N')
    """
    return quantity.replace(".", "_")


def force_columns(columns: Iterable[str]) -> tuple[str, ...]:
    """Those of forces among the columns of a table."""
    return tuple(x for x in columns if quantity_of(x))


def joined_forces(
    forces: Sequence[MeasuredForces | None], sizes: Sequence[int]
) -> MeasuredForces | None:
    """The forces of several tables of so many trials each, one after the other."""
    names = tuple(dict.fromkeys(name for x in forces if x is not None for name in x.names))
    if not names:
        return None
    values, sd = (np.full((sum(sizes), len(names)), np.nan) for _ in range(2))
    first = 0
    for x, n in zip(forces, sizes, strict=True):
        if x is not None:
            columns = [names.index(name) for name in x.names]
            values[first : first + n, columns], sd[first : first + n, columns] = x.values, x.sd
        first += n
    return MeasuredForces(names=names, values=values, sd=sd)


WRENCH = (
    "force_x_N",
    "force_y_N",
    "force_z_N",
    "moment_x_Nm",
    "moment_y_Nm",
    "moment_z_Nm",
)
name_axis("wrench_component", WRENCH)
RESULTANT = "insitu_N"
name_axis("superposition_value", (*WRENCH, RESULTANT))
POSE_SD = ("pose_sd_mm", "pose_sd_deg")
READS, ON_TIBIA, REACTION = "reads", "load on tibia", "reaction"
_RESULTANT = re.compile(rf"(?P<ligament>.+)_{RESULTANT}")
_READS = re.compile(rf"{READS}\s*:\s*(.*)", re.IGNORECASE)
SAY_READS = (
    f'write the comment line "# {READS}: {ON_TIBIA}" or "# {READS}: {REACTION}", or {READS} = '
    f'"{ON_TIBIA}" in the experiments file'
)


@declared
class Superposition:
    """Forces of structures that were cut, from replayed paths; one structure and trial a row.

    Each is the load on the tibia after the cut less that before: the wrench of the structure on
    the tibia, in tibial axes (x anterior, y superior, z lateral), moments about the tibial origin;
    or the size of its force alone.

    Raises
    ------
    ValueError
        If a state does not follow from the one before by the cut of the row, a value has no
        standard deviation above 0, a row has both components and their resultant, or the rows of a
        trial repeat each other.
    """

    trials: tuple[str, ...] = entry("Trial whose path was replayed, of each row")
    cut: tuple[str, ...] = entry("Ligament, bundle or group that was cut in between, of each row")
    before: tuple[str, ...] = entry("State of the knee before, of each row")
    after: tuple[str, ...] = entry("State of the knee after, of each row")
    values: Array = array(
        "Components of the wrench of the structure, and the size of its force; NaN where not "
        "measured",
        *("row", "superposition_value"),
        unit="N or N m, as the name says",
    )
    sd: Array = array(
        "Standard deviation of their errors, of both readings together",
        *("row", "superposition_value"),
        unit="N or N m, as the name says",
    )
    pose_sd: Array = array(
        "Standard deviation of the replayed pose along and about each axis of the tibia",
        *("row", "2"),
        unit="mm, then deg",
    )
    covariance: Array | None = entry(
        "Covariance of all measured values, row by row, errors of the poses included, shape "
        "``(values, values)``; None where those are not known yet",
        is_in_json=False,
        default=None,
    )

    def __post_init__(self) -> None:
        for name in ("before", "after"):
            states = tuple(state_words(cuts_of(x)) for x in getattr(self, name))
            object.__setattr__(self, name, states)
        for i, (cut, before, after) in enumerate(
            zip(self.cut, self.before, self.after, strict=True)
        ):
            if any(x.ligament == cut and not x.is_partial for x in cuts_of(before)):
                raise ValueRefused(
                    f"{self.words(i)}: it is cut already in the state {before!r} before",
                    "give the states of the knee before and after the cut",
                )
            if state_with(before, cut) != after:
                raise ValueRefused(
                    f"{self.words(i)}: the state {after!r} does not follow from {before!r} by "
                    f"cutting {cut}",
                    f"write {state_with(before, cut)!r}, or one row for each cut",
                )
        measured = self.is_measured
        if not (np.isfinite(self.sd[measured]).all() and (self.sd[measured] > 0.0).all()):
            raise ValueError("every in-situ force needs a standard deviation greater than 0")
        if not (np.isfinite(self.pose_sd).all() and (self.pose_sd >= 0.0).all()):
            raise ValueError("the standard deviation of a replayed pose is 0 or more")
        if np.any(self.values[:, -1] < 0.0):
            raise ValueError(
                "the size of an in-situ force is negative: give its components instead"
            )
        both = measured[:, -1] & measured[:, :-1].any(axis=1)
        if both.any():
            raise ValueRefused(
                f"{self.words(int(np.argmax(both)))}: there are components and their resultant",
                "give the components alone, which say more",
            )
        self._check_rows_differ()

    @property
    def n(self) -> int:
        """How many rows there are."""
        return len(self.trials)

    @property
    def is_measured(self) -> BoolArray:
        """Which values were measured, shape ``(n, 7)``."""
        return np.isfinite(self.values)

    @property
    def n_values(self) -> int:
        """How many values were measured."""
        return int(self.is_measured.sum())

    def words(self, row: int) -> str:
        """What a row is called, such as ``ACL in flexion30``."""
        return f"{self.cut[row]} in {self.trials[row]}"

    def select(self, rows: Sequence[int] | BoolArray) -> "Superposition":
        """Some of the rows, by their places or a mask."""
        chosen = np.arange(self.n)[np.asarray(rows)].tolist()
        row = np.nonzero(self.is_measured)[0]
        kept = np.concatenate([np.flatnonzero(row == i) for i in chosen])
        covariance = None if self.covariance is None else self.covariance[np.ix_(kept, kept)]
        return Superposition(
            trials=tuple(self.trials[i] for i in chosen),
            cut=tuple(self.cut[i] for i in chosen),
            before=tuple(self.before[i] for i in chosen),
            after=tuple(self.after[i] for i in chosen),
            values=self.values[chosen],
            sd=self.sd[chosen],
            pose_sd=self.pose_sd[chosen],
            covariance=covariance,
        )

    def of_trials(self, names: Iterable[str]) -> "Superposition | None":
        """The rows of some trials; None where there is none."""
        known = set(names)
        kept = np.array([x in known for x in self.trials], bool)
        return self.select(kept) if kept.any() else None

    def shares(self) -> Array:
        """Share of its variance that a row has in common with others, shape ``(n, n)``.

        A row is the difference of two readings, of equal variance. Consecutive cuts share the
        reading between them, with opposite signs; rows of different trials share none.
        """
        signs = self._readings()
        return np.asarray(0.5 * signs @ signs.T)

    def _readings(self) -> Array:
        """Sign with which each reading stands in each row, shape ``(n, readings)``."""
        pairs = [
            ((trial, before), (trial, after))
            for trial, before, after in zip(self.trials, self.before, self.after, strict=True)
        ]
        known = {x: i for i, x in enumerate(dict.fromkeys(x for pair in pairs for x in pair))}
        signs = np.zeros((self.n, len(known)))
        for row, (before, after) in enumerate(pairs):
            signs[row, known[before]], signs[row, known[after]] = -1.0, 1.0
        return signs

    def _check_rows_differ(self) -> None:
        """Refuse rows that are linear combinations of earlier ones."""
        signs = self._readings()
        for i in range(1, self.n):
            if np.linalg.matrix_rank(signs[: i + 1]) == i:
                raise ValueRefused(
                    f"{self.words(i)}: this difference of readings follows from rows above",
                    "leave it out, or give the mean of repeated tests",
                )


def state_with(before: str, cut: str) -> str:
    """The state after one more cut.

    Examples
    --------
    >>> state_with("cut: PCL", "ACL")
    'cut: ACL, PCL'
    """
    kept = [x for x in cuts_of(before) if x.ligament != cut]
    return state_words([*kept, Cut(ligament=cut, fraction=1.0)])


def read_superposition(path: PathLike, reads: str = "") -> Superposition:
    """In-situ forces of a CSV file, one structure and trial a row.

    Columns are ``trial``, the path that was replayed; ``cut``, what was cut in between; ``before``
    and ``after``, the states of the knee; and the wrench of the structure on the tibia (`WRENCH`),
    or the size of its force alone, such as ``ACL_insitu_N``, each with its ``sd_``.
    ``pose_sd_mm`` and ``pose_sd_deg`` are the errors of the replayed pose.

    Parameters
    ----------
    path
        The file.
    reads
        What the load cell reads, ``"load on tibia"`` or ``"reaction"``, where the file has no line
        ``# reads:``.

    Raises
    ------
    InputError
        If the file breaks a rule.
    ValueError
        If components are given, and nothing says what the cell reads.
    """
    with CellFile.open(path) as file:
        file.read_renamed_columns()
        resultants = [x for x in file.columns if _RESULTANT.fullmatch(x) and not x.startswith(SD)]
        measured = (*WRENCH, *resultants)
        known = ("trial", "cut", "before", "after", *measured, *(f"{SD}{x}" for x in measured))
        file.check_columns((*known, *POSE_SD), ("trial", "cut", "before", "after"))
        rows = [_row(row, resultants) for row in file.rows()]
        if not rows:
            file.refuse(file.header_line, "", "there is no row below the header", "Add one a cut.")
        sign = _sign(file, reads, rows)
    texts, values, sd, pose_sd = zip(*rows, strict=True)
    trials, cut, before, after = zip(*texts, strict=True)
    signs = np.r_[np.full(len(WRENCH), sign), 1.0]
    return Superposition(
        trials=trials,
        cut=cut,
        before=before,
        after=after,
        # Zero stays without a sign.
        values=0.0 + signs * np.array(values),
        sd=np.array(sd),
        pose_sd=np.array(pose_sd),
    )


_Row = tuple[tuple[str, str, str, str], list[float], list[float], list[float]]


def _row(row: TableRow, resultants: Sequence[str]) -> _Row:
    cut = row.text("cut")
    if not cut:
        row.refuse("cut", "the cell is blank", "Name the ligament, bundle or group that was cut.")
    for name in ("before", "after"):
        try:
            cuts_of(row.text(name))
        except ValueRefused as error:
            row.refuse(name, error.why, error.advice)
    pairs = [_value(row, x) for x in WRENCH]
    own = f"{cut}_{RESULTANT}"
    for x in resultants:
        if x != own and row.number(x, f"{x} is of another structure") is not None:
            row.refuse(x, f"the row is one of {cut}", f"Write it into a column {own}.")
    pairs.append(_value(row, own))
    values, spreads = (list(column) for column in zip(*pairs, strict=True))
    pose_sd = [row.number(x, "the pose has no error") or 0.0 for x in POSE_SD]
    return (row.text("trial"), cut, row.text("before"), row.text("after")), values, spreads, pose_sd


def _value(row: TableRow, column: str) -> tuple[float, float]:
    value = row.number(column, "this was not measured")
    spread = row.number(f"{SD}{column}", "its force is blank too")
    if value is None:
        return math.nan, math.nan
    if spread is None or spread <= 0.0:
        why = f"{column} is measured and has no standard deviation greater than 0"
        row.refuse(f"{SD}{column}", why, "Give it in the same unit.")
    return value, spread


def _sign(file: CellFile, reads: str, rows: Sequence[_Row]) -> float:
    """1 where the load cell reads the load on the tibia, -1 where it reads its reaction."""
    said = reads.strip().lower()
    for line, text in file.comments:
        if found := _READS.fullmatch(text.rstrip(",; ")):
            own = found[1].strip().lower()
            if said and own != said:
                why = f"the table says {READS}: {own}, and the experiment {said}"
                file.refuse(line, "", why, "State it in one place.")
            said = own
    has_components = any(math.isfinite(x) for _, values, _, _ in rows for x in values[:-1])
    if said not in ("", ON_TIBIA, REACTION):
        raise ValueRefused(
            f"{file.path.name} says that the cell reads {said!r}. "
            f"{suggestion(said, (ON_TIBIA, REACTION))}",
            SAY_READS,
        )
    if has_components and not said:
        raise ValueRefused(
            f"{file.path.name} has a wrench and does not say whether the cell reads the load on "
            "the tibia or its reaction",
            SAY_READS,
        )
    return -1.0 if said == REACTION else 1.0


def write_superposition(superposition: Superposition, path: PathLike) -> Path:
    """Path of a CSV file that now holds in-situ forces, as `read_superposition` reads them."""
    x = superposition
    owners = dict.fromkeys(
        name for name, is_there in zip(x.cut, x.is_measured[:, -1], strict=True) if is_there
    )
    columns = [
        *(name for i, name in enumerate(WRENCH) if x.is_measured[:, i].any()),
        *(f"{name}_{RESULTANT}" for name in owners),
    ]
    header = ["trial", "cut", "before", "after", *columns, *(f"{SD}{y}" for y in columns), *POSE_SD]
    lines = [f"# {READS}: {ON_TIBIA}", written(header)]
    for i in range(x.n):
        cells = []
        for numbers in (x.values, x.sd):
            own = dict(zip((*WRENCH, f"{x.cut[i]}_{RESULTANT}"), numbers[i].tolist(), strict=True))
            found = [own.get(column, math.nan) for column in columns]
            cells += ["" if math.isnan(y) else repr(y) for y in found]
        texts = [x.trials[i], x.cut[i], x.before[i], x.after[i]]
        lines.append(written([*texts, *cells, *map(repr, x.pose_sd[i].tolist())]))
    return write_atomically(path, "\n".join(lines) + "\n")


def joined_superpositions(parts: Sequence[Superposition]) -> Superposition | None:
    """The rows of several tables, one after the other."""
    if not parts:
        return None
    return Superposition(
        trials=tuple(y for x in parts for y in x.trials),
        cut=tuple(y for x in parts for y in x.cut),
        before=tuple(y for x in parts for y in x.before),
        after=tuple(y for x in parts for y in x.after),
        values=np.concatenate([x.values for x in parts]),
        sd=np.concatenate([x.sd for x in parts]),
        pose_sd=np.concatenate([x.pose_sd for x in parts]),
    )


def check_paths(superposition: Superposition, protocol: Protocol) -> None:
    """Refuse in-situ forces of paths that no trial has, or that were made after a cut.

    Raises
    ------
    ValueError
        Naming the first.
    """
    places = {name: i for i, name in enumerate(protocol.trials)}
    for row, (trial, before) in enumerate(
        zip(superposition.trials, superposition.before, strict=True)
    ):
        if trial not in places:
            raise ValueRefused(
                f"{superposition.words(row)}: no table has this trial",
                "add a row for it, its coordinates blank if they were not measured",
            )
        state = protocol.states[places[trial]]
        if not _is_before(state, before):
            raise ValueRefused(
                f"{superposition.words(row)}: the path was made in the state {state!r}, which is "
                f"not before {before!r}",
                "name the trial whose path was replayed",
            )


def with_named_paths(superposition: Superposition, protocol: Protocol) -> Superposition:
    """In-situ forces with the names that trials of several experiments have.

    Where two experiments have a trial of one name, that in the state before the cut is meant, or
    else the only one that was made before.

    Raises
    ------
    ValueError
        If it is not clear which trial is meant.
    """
    pairs = zip(superposition.trials, superposition.before, strict=True)
    found = [_path(protocol, *pair) for pair in pairs]
    for row, names in enumerate(found):
        if len(names) > 1:
            raise ValueRefused(
                f"{superposition.words(row)}: {' and '.join(names)} may be the path",
                "write the name of the experiment with it",
            )
    trials = tuple(x[0] if x else own for x, own in zip(found, superposition.trials, strict=True))
    return replace(superposition, trials=trials)


def _path(protocol: Protocol, trial: str, before: str) -> list[str]:
    """The trials that a name may mean."""
    if trial in protocol.trials:
        return [trial]
    named = [i for i, x in enumerate(protocol.trials) if x.partition("/")[2] == trial]
    exact = [i for i in named if protocol.states[i] == before]
    earlier = [i for i in named if _is_before(protocol.states[i], before)]
    return [protocol.trials[i] for i in exact or earlier]


def _is_before(state: str, other: str) -> bool:
    """Whether all that is cut in a state is cut in another one too."""
    return {x.words for x in cuts_of(state)} <= {x.words for x in cuts_of(other)}
