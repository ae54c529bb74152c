"""Effects: physical causes that change the mechanics of a knee or its measurement.

Mechanics inputs are smooth closed-form functions of the amplitudes and are differentiated
numerically. Replicas of the inputs, each with one amplitude perturbed, pass through the later
effects together, as one batch. Their changes of the lines are a table of differences, and the
derivatives of the gradient by the entries of the table are computed once for all amplitudes.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar, Protocol, TypeGuard, TypeVar, cast, runtime_checkable

import numpy as np

from identknee.mechanics.contact_points import contact_motion_columns
from identknee.mechanics.equilibria import LINE_COLUMNS, N_OF_LAW, N_OF_MENISCI, LineLigaments
from identknee.mechanics.ligament_tensions import line_gradients
from identknee.mechanics.memory import Equilibria
from identknee.model.mechanics_inputs import (
    MechanicsInputs,
    motions,
    repeated,
    to_measured,
    with_replicas,
)
from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.declare import Array, BoolArray, IntArray, declared, entry


class Effect(Protocol):
    """A cause by name, with its amplitudes as parameters; zero amplitudes change nothing.

    An effect also has either `change` (`MechanicalEffect`) or `observe` (`ObservationEffect`).
    """

    @property
    def name(self) -> str:
        """Name of the cause: the first part of its parameters' names."""
        ...

    @property
    def parameters(self) -> Parameters:
        """Its amplitudes, with bounds and priors; the last words of their names are the units."""
        ...


@runtime_checkable
class MechanicalEffect(Effect, Protocol):
    """An effect on loads, flexion, lines or contact."""

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the effect at amplitudes `values`, shape ``(n,)``."""
        ...


@runtime_checkable
class SelfContainedEffect(MechanicalEffect, Protocol):
    """A mechanical effect on lines of its own that no other effect changes."""

    def gradient_columns(
        self, setting: MechanicsInputs, values: Array, flexion: Array, poses: Array
    ) -> Array:
        """Derivatives of the energy's gradient by the amplitudes at fixed poses, ``(n, 5, a)``."""
        ...


@runtime_checkable
class ObservationEffect(Effect, Protocol):
    """An effect on the measurement of a pose, not on the pose."""

    def observe(self, coordinates: Array, values: Array, tests: "TrialRecord") -> Array:
        """Measured coordinates, shape ``(n, 5)``, for the true coordinates (n, 5)."""
        ...


@runtime_checkable
class FramesEffect(MechanicalEffect, Protocol):
    """A mechanical effect on the frames between which poses are measured, and on nothing else."""

    def placements(self, values: Array) -> tuple[Array, Array]:
        """Axes and origins of frames at k rows of amplitudes, ``(k, 2, 3, 3)``, ``(k, 2, 3)``."""
        ...


def moves_frames(effect: Effect) -> TypeGuard[FramesEffect]:
    """Whether an effect moves the frames between which poses are measured."""
    return hasattr(effect, "placements")


def is_self_contained(effect: Effect) -> TypeGuard[SelfContainedEffect]:
    """Whether an effect computes the derivatives of its own lines."""
    return hasattr(effect, "gradient_columns")


def differs_by_replica(effect: Effect) -> bool:
    """Whether replicas of inputs or trials may each have amplitudes of their own, ``(k, a)``.

    One call then gives the derivatives by all amplitudes.
    """
    return bool(getattr(effect, "differs_by_replica", False))


@declared
class TrialRecord:
    """The trials as they were made, with order and phase."""

    flexion_deg: Array = entry("Flexion as stated")
    loads: Array = entry(
        "Loads as stated, with the columns of `identknee.laxity.protocol.Protocol`"
    )
    order: IntArray | None = entry(
        "When each trial was run, counted from 1; None where it was not recorded", default=None
    )
    phase: tuple[str, ...] | None = entry(
        '``"loading"``, ``"unloading"`` or ``""`` of each trial; None where not recorded',
        default=None,
    )

    def repeated(self, n: int) -> "TrialRecord":
        """`n` replicas of the trials, one after the other."""
        return TrialRecord(
            flexion_deg=np.tile(self.flexion_deg, n),
            loads=np.tile(self.loads, (n, 1)),
            order=None if self.order is None else np.tile(self.order, n),
            phase=None if self.phase is None else n * self.phase,
        )


def amplitudes(
    cause: str,
    names: Sequence[str],
    prior_sd: Sequence[float],
    *,
    lower: Sequence[float] | None = None,
    upper: Sequence[float],
    center: Sequence[float] | None = None,
) -> Parameters:
    """Parameters of an effect, each named ``cause.name``.

    Parameters
    ----------
    cause
        Name of the effect.
    names
        Names of the amplitudes, each ending in its unit.
    prior_sd
        Prior standard deviations in those units.
    lower, upper
        Ends of the plausible range; `lower` is minus `upper` where None.
    center
        Middle of the prior, zero where None.
    """
    n = len(names)
    low = [-x for x in upper] if lower is None else lower
    return Parameters(
        names=tuple(f"{cause}.{name}" for name in names),
        center=np.zeros(n) if center is None else np.array(center, float),
        lower=np.array(low, float),
        upper=np.array(upper, float),
        prior_sd=np.array(prior_sd, float),
        is_log=np.zeros(n, bool),
    )


Changed = Callable[[MechanicsInputs, Array], MechanicsInputs]
Read = Callable[[Array, Array, TrialRecord], Array]
Made = TypeVar("Made", bound=Effect)


def effect_of(
    kind: Callable[..., Made],
    name: str,
    names: Sequence[str],
    prior_sd: Sequence[float],
    *,
    lower: Sequence[float] | None = None,
    upper: Sequence[float],
    **how: Any,
) -> Made:
    """An effect of a class such as `InputsChange`; `how` has the other fields of that class.

    The remaining arguments are those of `amplitudes`.
    """
    made = amplitudes(name, names, prior_sd, lower=lower, upper=upper)
    return kind(name=name, parameters=made, **how)


BY_REPLICA = (
    "Whether replicas may each have amplitudes of their own, shape ``(k, a)``: the function then "
    "takes k of them, one after the other"
)


@declared
class InputsChange:
    """An effect on lines or flexion."""

    name: str = entry("Name of the cause")
    parameters: Parameters = entry("Its amplitudes")
    changed: Changed = entry(
        "The setting with the effect, from the setting without it and the amplitudes"
    )
    differs_by_replica: bool = entry(BY_REPLICA, default=False)

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the effect at amplitudes `values`."""
        return self.changed(setting, values)


@declared
class ReadingError:
    """An effect that turns actual coordinates into those that are read."""

    name: str = entry("Name of the cause")
    parameters: Parameters = entry("Its amplitudes")
    read: Read = entry(
        "The coordinates read, from those that are actual (n, 5), amplitudes and tests"
    )
    differs_by_replica: bool = entry(BY_REPLICA, default=False)

    def observe(self, coordinates: Array, values: Array, tests: TrialRecord) -> Array:
        """The coordinates read, shape ``(n, 5)`` [mm, deg]."""
        return self.read(coordinates, values, tests)


@declared
class PartOfEffect:
    """Some of the amplitudes of an effect as a cause of its own; the others stay at zero."""

    whole: InputsChange = entry("The effect of all amplitudes")
    moved: IntArray = entry("Where its amplitudes stand among those")
    parameters: Parameters = entry("Its amplitudes")
    differs_by_replica: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """Name of the cause, the same for every part."""
        return self.whole.name

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the effect."""
        expanded = np.zeros((*values.shape[:-1], self.whole.parameters.n))
        expanded[..., self.moved] = values
        return self.whole.change(setting, expanded)


def with_remeasured_lengths(
    setting: MechanicsInputs, lines: LineLigaments, changed: BoolArray
) -> MechanicsInputs:
    """The inputs with other lines, `changed` ones (m,) with their length in the scanned pose.

    A ligament's reference length is measured along its course in the scan, so it changes with its
    insertions and with that course.
    """
    lengths = np.where(changed, setting.lengths_at_start(lines), lines.reference_length)
    return replace(setting, lines=replace(lines, reference_length=lengths))


# Separates the scope of an effect (a rig, a mounting, a state or a partial cut) from its name.
OF = "/"


def scope_of(effect: Effect) -> str:
    """The rig, mounting or partial cut that an effect belongs to; empty for the whole knee."""
    scope, of, _ = effect.name.rpartition(OF)
    return scope if of else ""


def is_error_of_rig(effect: Effect) -> bool:
    """Whether an effect is a nuisance of one rig, mounting or state, not of the whole knee."""
    return bool(scope_of(effect)) and not effect.parameters.is_of_interest.any()


def scoped(effect: Effect, scope: str) -> Effect:
    """The effect as that of one rig or mounting: its name is ``scope/name``."""
    return renamed(effect, f"{scope}{OF}{effect.name}")


def renamed(effect: Effect, name: str) -> Effect:
    """The effect under another name, which the names of its amplitudes begin with."""
    if name == effect.name:
        return effect
    made: Any = replace(cast(Any, effect), name=name)
    if not moves_frames(effect):
        names = tuple(f"{name}.{x.rpartition('.')[2]}" for x in effect.parameters.names)
        made = replace(made, parameters=replace(effect.parameters, names=names))
    return cast(Effect, made)


def with_fixed_amplitudes(effect: Effect, fixed: Mapping[str, float]) -> Effect:
    """The effect with some of its amplitudes, by their full names, fixed at given values."""
    free = effect.parameters.with_fixed([*fixed], effect.parameters.vector(fixed))
    if isinstance(effect, MechanicalEffect):
        changed = partial(_at_fixed, effect.change, free)
        return InputsChange(name=effect.name, parameters=free.parameters, changed=changed)
    if isinstance(effect, ObservationEffect):
        read = partial(_at_fixed, effect.observe, free)
        return ReadingError(name=effect.name, parameters=free.parameters, read=read)
    raise TypeError(f"the effect {effect.name} has neither `change` nor `observe`")


def _at_fixed(
    act: Callable[..., Any], free: FreeParameters, on: Any, values: Array, *at: Any
) -> Any:
    """The result of `act` on inputs or readings, with the fixed amplitudes beside `values`."""
    return act(on, free.expand(values), *at)


Placed = tuple[MechanicalEffect, slice]
# Relative size below which a difference is rounding.
SMALLEST_DIFFERENCE = 1e-11


def gradient_columns(
    effects: Sequence[Placed],
    settings: Sequence[MechanicsInputs],
    values: Array,
    steps: Array,
    found: Equilibria,
    nodes: IntArray,
) -> Array:
    """Derivatives of the gradient by the amplitudes at the poses found, shape ``(n, 5, a)``.

    Parameters
    ----------
    effects
        The effects, and where their amplitudes stand among `values`.
    settings
        The setting without effects at the nodes of the load paths, then with one more each time.
    values, steps
        All amplitudes, and a small change of each, shape ``(a,)``.
    found
        The equilibria at the nodes, made under a stated contact law.
    nodes
        The node of each trial, shape ``(n,)``.
    """
    flexion, poses = settings[-1].flexion[nodes], found.poses[nodes]
    columns = np.zeros((len(nodes), 5, len(values)))
    copies, moves, frames = _perturbed(effects, settings, values, steps)
    for turns, shifts, part in frames:
        surfaces = contact_motion_columns(found.contact_sums[nodes], flexion, poses)
        columns[:, :, part] = surfaces @ motions(turns, shifts).T / (2.0 * steps[part])
    for (effect, part), before in zip(effects, settings, strict=False):
        if is_self_contained(effect):
            framed = replace(before, frames=settings[-1].frames)
            columns[:, :, part] = effect.gradient_columns(framed, values[part], flexion, poses)
    changes = _gradient_differences(_table(settings[-1]), moves, flexion, poses)
    changes += copies.by_nodes(found, nodes)
    return np.asarray(columns + changes / (2.0 * steps))


# A quantity of lines such as their tension, from the lines, flexion (n,), poses (n, 5), stiffness
# and reference strain.
OfLines = Callable[[LineLigaments, Array, Array, Array, Array], Array]


def _perturbed(
    effects: Sequence[Placed], settings: Sequence[MechanicsInputs], values: Array, steps: Array
) -> tuple["_Replicas", Array, list[tuple[Array, Array, slice]]]:
    """Changes of the inputs by small changes of the amplitudes, down and up.

    Returns
    -------
    copies
        Replicas of the inputs with one amplitude changed each.
    moves
        Differences of the table of lines, shape ``(a, m, N_COLUMNS)``; without those of
        self-contained effects.
    frames
        Axes and origins of measured frames, and the amplitudes that they belong to.
    """
    copies = _Replicas(len(values))
    table = _table(settings[-1])
    moves, frames = np.zeros((len(values), *table.shape)), []
    for (effect, part), before, after in zip(effects, settings, settings[1:], strict=False):
        if is_self_contained(effect):
            continue
        copies.change(effect, values[part], after)
        each = central_difference_values(values[part], steps[part])
        if moves_frames(effect):
            turns, shifts = effect.placements(each)
            lines = settings[-1].lines
            for bone, ends in enumerate((lines.femoral, lines.tibial)):
                moved = to_measured(ends, turns[:, bone], shifts[:, bone])
                moves[part, :, 3 * bone : 3 * bone + 3] = moved[1::2] - moved[::2]
                own = lines.with_obstacles_of(bone)
                if own.size:
                    centre = np.asarray(lines.obstacle_centre)[own]
                    axis = np.asarray(lines.obstacle_axis)[own]
                    moved = to_measured(centre, turns[:, bone], shifts[:, bone])
                    moves[part, own, 6:9] = moved[1::2] - moved[::2]
                    moved = axis @ turns[:, bone]
                    moves[part, own, 9:12] = moved[1::2] - moved[::2]
            frames.append((turns, shifts, part))
        else:
            copies.add(effect, before, after, each, first=part.start)
    moves += copies.moves(len(table))
    return copies, moves, frames


def _own_moves(
    effects: Sequence[Placed], settings: Sequence[MechanicsInputs], values: Array, steps: Array
) -> Array:
    """Differences of the table of lines by the amplitudes of self-contained effects."""
    last = settings[-1]
    moves = np.zeros((len(values), len(last.stiffness), N_COLUMNS))
    for (effect, part), before, after in zip(effects, settings, settings[1:], strict=False):
        if is_self_contained(effect):
            own = slice(len(before.stiffness), len(after.stiffness))
            each = central_difference_values(values[part], steps[part])
            made = [_table(replace(effect.change(before, x), frames=last.frames)) for x in each]
            tables = np.array([x[own] for x in made]).reshape(
                -1, 2, own.stop - own.start, N_COLUMNS
            )
            moves[part, own] = tables[:, 1] - tables[:, 0]
    return moves


def central_difference_values(values: Array, steps: Array) -> Array:
    """Values (a,) for central differences: each a step smaller, then larger, ``(2 a, a)``."""
    moves = np.repeat(np.diag(steps), 2, axis=0)
    moves[::2] *= -1.0
    return np.asarray(values + moves)


class _Replicas:
    """Replicas 2 k and 2 k + 1 of the inputs, with amplitude k perturbed down and up.

    All replicas are in one `MechanicsInputs`: first the unperturbed inputs, as copy -1, then the
    lines and nodes that an amplitude changes. They share one contact law and the menisci, to which
    effects add: to the logarithm of the modulus, to the exponent and to the values of the menisci.
    The sums are kept apart here.
    """

    def __init__(self, n_values: int) -> None:
        self._n_values = n_values
        self._all: MechanicsInputs | None = None
        self._of_nodes: list[int] = []
        self._laws = np.zeros((2, n_values))
        self._menisci = np.zeros((N_OF_MENISCI, n_values))

    def change(self, effect: MechanicalEffect, values: Array, after: MechanicsInputs) -> None:
        """Apply to all replicas an effect that turned the inputs into `after`."""
        if self._all is None:
            return
        if moves_frames(effect):
            self._all = replace(self._all, frames=after.frames)
        else:
            self._all = effect.change(self._all, values)

    def add(
        self,
        effect: MechanicalEffect,
        before: MechanicsInputs,
        after: MechanicsInputs,
        each: Array,
        *,
        first: int,
    ) -> None:
        """Add replicas for the differences by the amplitudes of `effect`.

        `each` has them in turn smaller and larger; `first` is the place of the first among all.
        """
        if not len(each):
            return
        copies = range(2 * first, 2 * first + len(each))
        if differs_by_replica(effect):
            before = repeated(before, len(each))
            own = effect.change(before, each)
            made = [replace(own, copy=2 * first + own.copy)]
        else:
            made = [effect.change(before, x) for x in each]
            for k, (low, high) in enumerate(zip(made[::2], made[1::2], strict=True), start=first):
                self._laws[0, k] = np.log(high.law.modulus / low.law.modulus)
                self._laws[1, k] = high.law.exponent - low.law.exponent
                if high.menisci is not None and low.menisci is not None:
                    self._menisci[:, k] = high.menisci - low.menisci
        others = made[0]
        has_lines = any(
            getattr(others, x) is not getattr(before, x)
            for x in ("lines", "stiffness", "reference_strain")
        )
        has_nodes = others.loads is not before.loads or others.flexion is not before.flexion
        if not (has_lines or has_nodes):
            return
        if has_nodes:
            self._of_nodes += copies
        if has_lines and not differs_by_replica(effect):
            made = [x.as_replica(i) for x, i in zip(made, copies, strict=True)]
        whole = after.as_replica(-1) if self._all is None else self._all
        self._all = with_replicas(whole, made, lines=has_lines, nodes=has_nodes)

    def by_nodes(self, found: Equilibria, nodes: IntArray) -> Array:
        """Change of the gradient by loads, flexion, contact law and menisci, ``(n, 5, a)``."""
        # The sensitivities are -H^-1 times the columns that are wanted here.
        laws = found.sensitivities[nodes][:, :, -2:] @ self._laws
        if self._menisci.any():
            own = slice(-N_OF_MENISCI - N_OF_LAW, -N_OF_LAW)
            laws += found.sensitivities[nodes][:, :, own] @ self._menisci
        changes = np.asarray(-found.hessians[nodes] @ laws)
        if self._all is None or not self._of_nodes:
            return changes
        n_nodes = len(found.poses)
        loads = self._all.loads.reshape(-1, n_nodes, 5)[1:, nodes]
        flexion = self._all.flexion.reshape(-1, n_nodes)[1:, nodes]
        by_flexion = (flexion[1::2] - flexion[::2])[:, :, None] * found.gradient_by_flexion[nodes]
        moved = np.array(self._of_nodes[::2]) // 2
        changes[:, :, moved] += np.moveaxis(loads[::2] - loads[1::2] + by_flexion, 0, 2)
        return changes

    def flexion(self, n_nodes: int) -> Array:
        """Differences of the flexion of each node [rad], shape ``(a, n_nodes)``."""
        differences = np.zeros((self._n_values, n_nodes))
        if self._all is not None and self._of_nodes:
            flexion = self._all.flexion.reshape(-1, n_nodes)[1:]
            differences[np.array(self._of_nodes[::2]) // 2] = flexion[1::2] - flexion[::2]
        return differences

    def moves(self, n_lines: int) -> Array:
        """Differences of the table of lines, each amplitude's second copy less its first."""
        moves = np.zeros((self._n_values, n_lines, N_COLUMNS))
        if self._all is None:
            return moves
        order = np.argsort(self._all.copy, kind="stable")
        order = order[np.searchsorted(self._all.copy[order], 0) :]
        copy, table = self._all.copy[order], _table(self._all)[order]
        low, high = copy % 2 == 0, copy % 2 == 1
        # A copy has the first lines of the inputs: lines that a later effect adds are in no copy.
        line = np.arange(len(order)) - np.searchsorted(copy, copy)
        moves[copy[low] // 2, line[low]] = table[high] - table[low]
        return moves


def _gradient_differences(table: Array, moves: Array, flexion: Array, poses: Array) -> Array:
    """Change of the gradient by small `moves` of a table of lines, ``(n, 5, a)``."""
    line, entry, step, lines, laws = _moved_lines(table, moves)
    less, more = np.split(line_gradients(lines, flexion, poses, *laws), 2, axis=1)
    share = moves[:, line, entry] / (2.0 * step)
    return np.asarray(np.swapaxes(share @ (more - less), 1, 2))


def _moved_lines(
    table: Array, moves: Array
) -> tuple[IntArray, IntArray, Array, LineLigaments, tuple[Array, Array]]:
    """Lines with one entry of the table each moved down, then up, as far as `moves` go.

    Returns
    -------
    line, entry
        Which line each of the k is, and which entry of its row is moved, shape ``(k,)``.
    step
        How far, the farthest that any amplitude moves it, shape ``(k,)``.
    lines, laws
        The ``2 k`` lines, their stiffness and reference strain.
    """
    steps = np.abs(moves).max(axis=0, initial=0.0)
    line, entry = np.nonzero(steps > SMALLEST_DIFFERENCE * (1.0 + np.abs(table)))
    low, high = table[line], table[line]
    step, place = steps[line, entry], (np.arange(len(line)), entry)
    low[place] -= step
    high[place] += step
    both = np.concatenate([low, high])
    lines = LineLigaments.of_table(both[:, :STIFFNESS_COLUMN])
    return line, entry, step, lines, (both[:, STIFFNESS_COLUMN], both[:, STIFFNESS_COLUMN + 1])


# The column of the stiffness in the table of lines, and the number of columns.
STIFFNESS_COLUMN = LINE_COLUMNS
N_COLUMNS = STIFFNESS_COLUMN + 2


def _table(setting: MechanicsInputs) -> Array:
    """All quantities that the gradient of each line depends on, shape ``(m, N_COLUMNS)``."""
    laws = (setting.stiffness, setting.reference_strain)
    return np.column_stack([setting.measured_lines.table(), *laws])


# Step of an amplitude as a share of its range. Effects are smooth functions in closed form, so the
# error of a central difference is about the square of this.
STEP = 1e-6
COORDINATE_STEP = 1e-4  # mm, deg
FLEXION_STEP = 1e-5  # rad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EffectStack:
    """The effects of a model, and the indices of their amplitudes in one vector.

    Attributes
    ----------
    effects
        In the order in which they act.
    """

    effects: tuple[Effect, ...]
    _mechanical: tuple[tuple[MechanicalEffect, slice], ...] = field(init=False, repr=False)
    _observed: tuple[tuple[ObservationEffect, slice], ...] = field(init=False, repr=False)
    _steps: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        ends = np.cumsum([0, *(x.parameters.n for x in self.effects)]).tolist()
        parts = [slice(*x) for x in pairwise(ends)]
        placed = list(zip(self.effects, parts, strict=True))
        mechanical = tuple((x, part) for x, part in placed if isinstance(x, MechanicalEffect))
        observed = tuple((x, part) for x, part in placed if isinstance(x, ObservationEffect))
        ranges = [x.parameters.upper - x.parameters.lower for x in self.effects]
        object.__setattr__(self, "_steps", STEP * np.concatenate([np.zeros(0), *ranges]))
        object.__setattr__(self, "_mechanical", mechanical)
        object.__setattr__(self, "_observed", observed)

    @property
    def parameters(self) -> Parameters | None:
        """Amplitudes of all effects; None where there is none."""
        return joined([x.parameters for x in self.effects]) if self.effects else None

    def changes(self, setting: MechanicsInputs, values: Array) -> list[MechanicsInputs]:
        """The inputs, then with one more effect each time, all at amplitudes `values`."""
        settings = [setting]
        for effect, part in self._mechanical:
            settings.append(effect.change(settings[-1], values[part]))
        return settings

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with all effects at amplitudes `values`."""
        return self.changes(setting, values)[-1]

    def observe(self, coordinates: Array, values: Array, tests: TrialRecord) -> Array:
        """Measured coordinates for the true ones, shape ``(n, 5)``."""
        for effect, part in self._observed:
            coordinates = effect.observe(coordinates, values[part], tests)
        return coordinates

    def pose_columns(
        self,
        settings: Sequence[MechanicsInputs],
        values: Array,
        found: Equilibria,
        nodes: IntArray,
        is_at_rest: BoolArray,
    ) -> Array:
        """Derivatives of the poses by the amplitudes, shape ``(n, 5, a)``; NaN without a pose.

        Parameters
        ----------
        settings
            Those of `changes`, at the nodes of the load paths.
        values
            Amplitudes, shape ``(a,)``.
        found
            The equilibria at the nodes, made under a stated contact law.
        nodes
            The node of each trial, shape ``(n,)``.
        is_at_rest
            Whether the knee is in equilibrium at each node, alone or held by a spring.
        """
        columns = -gradient_columns(self._mechanical, settings, values, self._steps, found, nodes)
        # Where no equilibrium was found, and no spring holds the knee, the Hessian may be singular.
        has_pose = is_at_rest[nodes]
        columns[~has_pose] = np.nan
        # For 5 by 5 matrices `inv` takes a third of the time of `solve`.
        columns[has_pose] = np.linalg.inv(found.hessians[nodes][has_pose]) @ columns[has_pose]
        return columns

    def observed_slopes(
        self, coordinates: Array, values: Array, tests: TrialRecord
    ) -> tuple[Array, Array]:
        """Derivatives of the measured coordinates by the true ones and by the amplitudes.

        Shapes ``(n, 5, 5)`` and ``(n, 5, a)``.
        """
        if not self._observed:
            by_coordinate = np.broadcast_to(np.eye(5), (len(coordinates), 5, 5))
            return by_coordinate, np.zeros((len(coordinates), 5, len(values)))
        # All perturbed readings are stacked, so that each later effect is called once.
        n, moved = len(coordinates), [*range(5)]
        steps = np.r_[np.full(5, COORDINATE_STEP), self._steps]
        stack = (coordinates + central_difference_values(np.zeros(5), steps[:5])[:, None]).reshape(
            -1, 5
        )
        for effect, part in self._observed:
            stack = effect.observe(stack, values[part], tests.repeated(len(stack) // n))
            each = central_difference_values(values[part], self._steps[part])
            k = len(each)
            if k and differs_by_replica(effect):
                read = [effect.observe(np.tile(coordinates, (k, 1)), each, tests.repeated(k))]
            else:
                read = [effect.observe(coordinates, x, tests) for x in each]
            stack = np.concatenate([stack, *read])
            coordinates = effect.observe(coordinates, values[part], tests)
            moved += range(5 + part.start, 5 + part.stop)
        low, high = np.moveaxis(stack.reshape(-1, 2, n, 5), 1, 0)
        slopes = np.zeros((n, 5, 5 + len(values)))
        slopes[:, :, moved] = np.moveaxis(high - low, 0, 2) / (2.0 * steps[moved])
        return slopes[:, :, :5], slopes[:, :, 5:]

    def line_changes(
        self,
        settings: Sequence[MechanicsInputs],
        values: Array,
        poses: Array,
        nodes: IntArray,
        quantity: OfLines,
    ) -> tuple[Array, Array]:
        """Derivatives of a quantity of the lines by the amplitudes, at given poses.

        Parameters
        ----------
        settings, values, nodes
            As for `pose_columns`.
        poses
            Pose of each trial, shape ``(n, 5)``.
        quantity
            The quantity of m lines, a closed-form function, shape ``(n, m, k)``.

        Returns
        -------
        changes
            Derivatives of the quantity, shape ``(n, m, k, a)``.
        stiffness
            Derivatives of the stiffness of each line [N], shape ``(m, a)``.
        """
        effects, steps, last = self._mechanical, self._steps, settings[-1]
        flexion, table = last.flexion[nodes], _table(last)
        copies, moves, _ = _perturbed(effects, settings, values, steps)
        moves = moves + _own_moves(effects, settings, values, steps)
        line, entry, step, lines, laws = _moved_lines(table, moves)
        less, more = np.split(quantity(lines, flexion, poses, *laws), 2, axis=1)
        share = moves[:, line, entry] / (2.0 * step)
        turned = copies.flexion(len(last.flexion))[:, nodes]
        own_laws = last.stiffness, last.reference_strain
        low, high = (
            quantity(last.measured_lines, flexion + x, poses, *own_laws)
            for x in (-FLEXION_STEP, FLEXION_STEP)
        )
        by_flexion = (high - low) / (2.0 * FLEXION_STEP)
        changes = by_flexion[..., None] * turned.T[:, None, None]
        for i in range(len(table)):
            own = line == i
            changes[:, i] += np.swapaxes(more - less, 1, 2)[:, :, own] @ share[:, own].T
        return changes / (2.0 * steps), moves[:, :, STIFFNESS_COLUMN].T / (2.0 * steps)

    def contact_pairs(
        self, settings: Sequence[MechanicsInputs], values: Array
    ) -> Iterator[tuple[int, float, MechanicsInputs, MechanicsInputs]]:
        """Inputs at an amplitude a little smaller and larger, of effects that change the contact.

        These change frames, flexion, the contact law or the menisci; the other effects are left
        out. Each pair comes with the index of the amplitude and the difference between the two.
        """
        acting = [
            (effect, part, before)
            for (effect, part), (before, after) in zip(
                self._mechanical, pairwise(settings), strict=True
            )
            if after.frames is not before.frames
            or after.flexion is not before.flexion
            or after.law is not before.law
            or after.menisci is not before.menisci
        ]
        for i, (effect, part, before) in enumerate(acting):
            each = central_difference_values(values[part], self._steps[part])
            ends = []
            for changed in each:
                setting = effect.change(before, changed)
                for later, own, _ in acting[i + 1 :]:
                    setting = later.change(setting, values[own])
                ends.append(setting)
            for k, (low, high) in enumerate(zip(ends[::2], ends[1::2], strict=True)):
                place = part.start + k
                yield place, float(2.0 * self._steps[place]), low, high

    def added_lines(self, settings: Sequence[MechanicsInputs]) -> tuple[str, ...]:
        """The effect that added each line which belongs to no ligament, in their order."""
        counts = [int((x.owner < 0).sum()) for x in settings]
        return tuple(
            effect.name
            for (effect, _), (before, after) in zip(self._mechanical, pairwise(counts), strict=True)
            for _ in range(after - before)
        )


def joined(parts: Sequence[Parameters]) -> Parameters:
    """Parameters of several parts, one after the other."""
    return Parameters(
        names=tuple(name for x in parts for name in x.names),
        center=np.concatenate([x.center for x in parts]),
        lower=np.concatenate([x.lower for x in parts]),
        upper=np.concatenate([x.upper for x in parts]),
        prior_sd=np.concatenate([x.prior_sd for x in parts]),
        is_log=np.concatenate([x.is_log for x in parts]),
        is_nuisance=np.concatenate([~x.is_of_interest for x in parts]),
        own=None if all(x.own is None for x in parts) else np.concatenate([x.start for x in parts]),
    )
