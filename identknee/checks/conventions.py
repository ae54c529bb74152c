"""Conventions that people break in laxity tables, and the change that puts each right."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from identknee.laxity.experiments import Cut, cuts_of, state_words
from identknee.laxity.protocol import ABSOLUTE, FLEXION, LOADS, Protocol, unloaded_trials
from identknee.laxity.table import COORDINATES, Laxity
from identknee.laxity.translations import COMPONENTS, DEFINITIONS, Translations, to_components
from identknee.runs.arrays import IntArray

# Names of both kinds of columns, coordinates first.
COLUMNS = (*COORDINATES, *LOADS)
_LENGTHS = tuple(x for x in COORDINATES if x.endswith("_mm"))
_ANGLES = tuple(x for x in COORDINATES if x.endswith("_deg"))
_MOMENTS = tuple(x for x in LOADS if x.endswith("_Nm"))
_FORCES = tuple(x for x in LOADS if x.endswith("_N"))
# Lateral and medial, varus and valgus, internal and external change places on the other side.
_SIDED = ("lateral_shift_mm", "varus_deg", "internal_deg")
_SIDED_LOADS = ("internal_moment_Nm", "varus_moment_Nm", "lateral_force_N")
_UNITS = (
    (_LENGTHS, 1000.0, "m", "mm"),
    (_LENGTHS, 10.0, "cm", "mm"),
    (_LENGTHS, 25.4, "inches", "mm"),
    (_ANGLES, 180.0 / np.pi, "radians", "degrees"),
    (_MOMENTS, 0.001, "N·mm", "N·m"),
    (_MOMENTS, 0.01, "N·cm", "N·m"),
    (_MOMENTS, 0.112985, "inch-pounds", "N·m"),
    (_FORCES, 1000.0, "kN", "N"),
    (_FORCES, 4.44822, "pounds", "N"),
    (_FORCES, 9.80665, "kilograms", "N"),
)
# A smaller standard deviation than any instrument's must be in the unit that is to be changed.
LEAST_SD = 0.02
# Poses of unloaded trials closer to zero than this [mm, deg] were set to zero.
ZEROED = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Convention:
    """A change of a laxity table that would put one broken convention right.

    Attributes
    ----------
    what
        What it does, as the subject of a sentence.
    order
        Which of `COLUMNS` each column takes its values from, shape ``(10,)``.
    factors
        What they are multiplied by, shape ``(10,)``.
    flexion
        What flexion is multiplied by.
    zero
        What coordinates are counted from; None for what the table says.
    translations
        Definition that the translations have; components are what they should be.
    states
        State of each trial; None for what the table says.
    """

    what: str
    order: tuple[int, ...] = tuple(range(len(COLUMNS)))
    factors: tuple[float, ...] = (1.0,) * len(COLUMNS)
    flexion: float = 1.0
    zero: str | None = None
    translations: Translations = COMPONENTS
    states: tuple[str, ...] | None = None

    def applied(self, laxity: Laxity) -> Laxity | None:
        """The table put right; None where it would be the same or break a rule of tables.

        Standard deviations keep their size where the unit changes, but for those too small to be
        in the unit that the table should have.
        """
        n = len(COORDINATES)
        order, factors = np.array(self.order), np.array(self.factors)
        protocol = laxity.protocol
        loads = protocol.loads[:, order[n:] - n] * factors[n:]
        coordinates = laxity.coordinates[:, order[:n]] * factors[:n]
        if self.translations != COMPONENTS:
            if laxity.zero != ABSOLUTE or not laxity.is_measured.all():
                return None
            coordinates = to_components(self.translations, protocol.flexion_deg, coordinates)
        zero = laxity.zero if self.zero is None else self.zero
        flexion = protocol.flexion_deg * self.flexion
        states = protocol.state if self.states is None else self.states
        same = (
            np.array_equal(loads, protocol.loads)
            and np.array_equal(coordinates, laxity.coordinates, equal_nan=True)
            and np.array_equal(flexion, protocol.flexion_deg)
            and states == protocol.state
        )
        # Columns of which one was not measured were not exchanged.
        moved = np.isnan(coordinates) != np.isnan(laxity.coordinates)
        if (same and zero == laxity.zero) or moved.any():
            return None
        sd = laxity.sd
        if sd is not None:
            own = sd[:, order[:n]]
            sd = np.where(own < LEAST_SD, np.abs(factors[:n]) * own, own)
        try:
            return replace(
                laxity,
                protocol=replace(protocol, flexion_deg=flexion, loads=loads, state=states),
                coordinates=coordinates,
                sd=sd,
                zero=zero,
            )
        except ValueError:
            return None


def conventions_of(laxity: Laxity, structures: Sequence[str] = ()) -> tuple[Convention, ...]:
    """The changes that would put right what people get wrong in a table such as this.

    Signs of columns, of whole motions and of all loads; units; the other side of the body; columns
    exchanged; definitions of translations; what coordinates are counted from; and, in a table with
    ligaments cut, states of the knee.

    Parameters
    ----------
    laxity
        The table.
    structures
        Ligaments and groups of the knee that may have been cut.
    """
    return (
        *_of_columns(),
        *_of_translations(),
        *_zeros(laxity),
        *_of_states(laxity.protocol, structures),
    )


def _of_columns() -> Iterator[Convention]:
    """Signs, sides, units and exchanges."""
    for name in COLUMNS:
        yield Convention(what=f"negating {name}", factors=_negated((name,)))
    yield Convention(
        what="negating all coordinates (motion of the femur in the tibia)",
        factors=_negated(COORDINATES),
    )
    yield Convention(what="negating all lengths", factors=_negated(_LENGTHS))
    yield Convention(what="negating both angles", factors=_negated(_ANGLES))
    yield Convention(what="negating all loads (loads on the femur)", factors=_negated(LOADS))
    yield Convention(what="negating both moments", factors=_negated(_MOMENTS))
    yield Convention(what=f"negating {FLEXION}", flexion=-1.0)
    for what, names in (
        ("coordinates and loads", (*_SIDED, *_SIDED_LOADS)),
        ("coordinates", _SIDED),
        ("loads", _SIDED_LOADS),
    ):
        said = f"taking {what} for those of the other side (left for right)"
        yield Convention(what=said, factors=_negated(names))
    kinds = {_LENGTHS: "lengths", _ANGLES: "angles", _MOMENTS: "moments", _FORCES: "forces"}
    for columns, factor, unit, wanted in _UNITS:
        said = f"taking {kinds[columns]} for {unit} and converting them to {wanted}"
        yield Convention(what=said, factors=_scaled(columns, factor))
    single = [(x, unit, factor) for x in _LENGTHS for unit, factor in (("m", 1000.0), ("cm", 10.0))]
    single += [(x, "radians", 180.0 / np.pi) for x in _ANGLES]
    for name, unit, factor in single:
        yield Convention(what=f"taking {name} for {unit}", factors=_scaled((name,), factor))
    yield Convention(what=f"taking {FLEXION} for radians", flexion=180.0 / np.pi)
    for kind in (_LENGTHS, _ANGLES, _MOMENTS, _FORCES):
        for one, other in combinations(kind, 2):
            order = list(range(len(COLUMNS)))
            i, j = COLUMNS.index(one), COLUMNS.index(other)
            order[i], order[j] = j, i
            yield Convention(what=f"exchanging {one} and {other}", order=tuple(order))


def _of_translations() -> Iterator[Convention]:
    """Other definitions of translations."""
    names = {
        "projections": "projections on the axes of Grood and Suntay",
        "femur": "translations along the axes of the femur",
        "tibia": "translations along the axes of the tibia",
    }
    for definition in DEFINITIONS:
        if definition != COMPONENTS:
            what = f"reading translations as {names[definition]} (# translations: {definition})"
            yield Convention(what=what, translations=definition)


def _zeros(laxity: Laxity) -> Iterator[Convention]:
    if laxity.zero == "unloaded":
        yield Convention(
            what="taking coordinates for absolute ones (without zero: unloaded)", zero="absolute"
        )
        return
    if laxity.zero != "absolute":
        return
    unloaded = laxity.coordinates[laxity.protocol.is_unloaded]
    known = np.abs(unloaded[~np.isnan(unloaded)])
    if not known.size or np.median(known) > ZEROED:
        return
    try:
        unloaded_trials(laxity.protocol)
    except ValueError:
        return
    yield Convention(
        what="counting coordinates from the unloaded pose of each flexion angle (zero: unloaded)",
        zero="unloaded",
    )


def _of_states(protocol: Protocol, structures: Sequence[str]) -> Iterator[Convention]:
    """A cut that was not made, another structure cut, and the labels of two states exchanged.

    The fraction of a partial cut is estimated, so that it needs no other label.
    """
    if protocol.state is None:
        return
    series, states = protocol.series, protocol.state
    first = np.unique(series, return_index=True)[1].tolist()
    labels = [states[i] for i in first]
    whole = [k for k, label in enumerate(labels) if not any(x.is_partial for x in cuts_of(label))]

    def said(k: int) -> str:
        of = "" if protocol.experiment is None else f" of {protocol.experiment[first[k]]}"
        return f'"{labels[k]}"{of if labels.count(labels[k]) > 1 else ""}'

    for k in whole:
        for state in _other_states(cuts_of(labels[k]), structures):
            yield Convention(
                what=f'taking the trials of the state {said(k)} for "{state}"',
                states=_relabelled(states, series, {k: state}),
            )
    for j, k in combinations(whole, 2):
        if labels[j] != labels[k]:
            yield Convention(
                what=f"exchanging the states {said(j)} and {said(k)}",
                states=_relabelled(states, series, {j: labels[k], k: labels[j]}),
            )


def _other_states(cuts: Sequence[Cut], structures: Sequence[str]) -> Iterator[str]:
    """States with one cut not made, or made in another structure."""
    taken = {x.ligament for x in cuts}
    for x in cuts:
        rest = [y for y in cuts if y is not x]
        yield state_words(rest)
        for other in structures:
            made = [*rest, Cut(ligament=other, fraction=1.0)]
            if other not in taken and {y.ligament for y in made} != set(structures):
                yield state_words(made)


def _relabelled(
    states: Sequence[str], series: IntArray, labels: Mapping[int, str]
) -> tuple[str, ...]:
    return tuple(labels.get(int(k), x) for k, x in zip(series, states, strict=True))


def _negated(names: Sequence[str]) -> tuple[float, ...]:
    return _scaled(names, -1.0)


def _scaled(names: Sequence[str], factor: float) -> tuple[float, ...]:
    return tuple(factor if x in names else 1.0 for x in COLUMNS)
