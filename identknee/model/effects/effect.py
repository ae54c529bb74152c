"""Effects: physical causes that change the mechanics of a knee or its measurement."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, TypeGuard, runtime_checkable

import numpy as np

from identknee.mechanics.equilibria import LineLigaments
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import declared, entry


class Effect(Protocol):
    """A cause by name, with its amplitudes as parameters; zero amplitudes change nothing.

    It also has either `change` (`MechanicalEffect`) or `observe` (`ObservationEffect`).
    """

    @property
    def name(self) -> str:
        """Name of the cause: the first part of its parameters' names."""
        ...

    @property
    def parameters(self) -> Parameters:
        """Its amplitudes, with bounds, prior and unit; their centre is no effect."""
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
class ReplicaEffect(MechanicalEffect, Protocol):
    """A mechanical effect whose amplitudes may differ between replicas of the inputs.

    Its derivatives are had faster then.
    """

    def change_copies(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the effect at amplitudes ``values[i]`` in replica i, ``(k, a)``."""
        ...


@runtime_checkable
class ObservationEffect(Effect, Protocol):
    """An effect on the measurement of a pose, not on the pose."""

    def observe(self, coordinates: Array, values: Array, tests: "TrialRecord") -> Array:
        """Measured coordinates, shape ``(n, 5)``, for the true coordinates (n, 5)."""
        ...


@runtime_checkable
class ReplicaObservation(ObservationEffect, Protocol):
    """An effect on the measurement whose amplitudes may differ between replicas of the trials."""

    def observe_copies(self, coordinates: Array, values: Array, tests: "TrialRecord") -> Array:
        """What is measured in k copies of the trials, copy i with amplitudes ``values[i]``."""
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


def changes_replicas(effect: Effect) -> TypeGuard[ReplicaEffect]:
    """Whether the amplitudes of an effect may differ between replicas of the inputs."""
    return hasattr(effect, "change_copies")


def reads_replicas(effect: Effect) -> TypeGuard[ReplicaObservation]:
    """Whether the amplitudes of an effect may differ between replicas of the trials."""
    return hasattr(effect, "observe_copies")


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
        """The same trials `n` times, one after the other."""
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
    """Parameters ``cause.name`` of an effect.

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


@declared
class InputsChange:
    """An effect on lines or flexion."""

    name: str = entry("Name of the cause")
    parameters: Parameters = entry("Its amplitudes")
    changed: Changed = entry(
        "The setting with the effect, from the setting without it and the amplitudes"
    )

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the effect at amplitudes `values`."""
        return self.changed(setting, values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReplicaInputsChange(InputsChange):
    """The same, vectorised over amplitudes (k, a) of k replicas."""

    def change_copies(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the effect at amplitudes ``values[i]`` in replica i."""
        return self.changed(setting, values)


@declared
class ReadingError:
    """An effect that turns actual coordinates into those that are read."""

    name: str = entry("Name of the cause")
    parameters: Parameters = entry("Its amplitudes")
    read: Read = entry(
        "The coordinates read, from those that are actual (n, 5), amplitudes and tests"
    )

    def observe(self, coordinates: Array, values: Array, tests: TrialRecord) -> Array:
        """The coordinates read, shape ``(n, 5)`` [mm, deg]."""
        return self.read(coordinates, values, tests)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReplicaReadingError(ReadingError):
    """The same, vectorised over amplitudes (k, a) of k replicas of the trials."""

    def observe_copies(self, coordinates: Array, values: Array, tests: TrialRecord) -> Array:
        """The coordinates read in k copies of the trials, copy i with amplitudes ``values[i]``."""
        return self.read(coordinates, values, tests)


def with_remeasured_lengths(
    setting: MechanicsInputs, lines: LineLigaments, changed: BoolArray
) -> MechanicsInputs:
    """The inputs with other lines, `changed` ones (m,) with their length in the scanned pose.

    A ligament's reference length is measured between its insertions: where they are put elsewhere,
    or the way between them is another, so is what was measured.
    """
    lengths = np.where(changed, setting.lengths_at_start(lines), lines.reference_length)
    return replace(setting, lines=replace(lines, reference_length=lengths))


def with_fixed_amplitudes(effect: Effect, fixed: Mapping[str, float]) -> Effect:
    """The effect with some of its amplitudes, by their full names, fixed at given values."""
    free = effect.parameters.with_fixed([*fixed], effect.parameters.vector(fixed))
    if isinstance(effect, MechanicalEffect):
        changed = partial(_change_held, effect, free)
        return InputsChange(name=effect.name, parameters=free.parameters, changed=changed)
    if isinstance(effect, ObservationEffect):
        read = partial(_read_held, effect, free)
        return ReadingError(name=effect.name, parameters=free.parameters, read=read)
    raise TypeError(f"{effect.name} changes neither the setting nor what is read")


def _change_held(
    effect: MechanicalEffect, free: FreeParameters, setting: MechanicsInputs, values: Array
) -> MechanicsInputs:
    return effect.change(setting, free.expand(values))


def _read_held(
    effect: ObservationEffect,
    free: FreeParameters,
    coordinates: Array,
    values: Array,
    tests: TrialRecord,
) -> Array:
    return effect.observe(coordinates, free.expand(values), tests)


# The first ending that fits counts.
UNITS = {
    "N_per_mm": "N/mm",
    "N_per_Nm": "N/N·m",
    "deg_per_Nm": "deg/N·m",
    "kN": "kN",
    "Nm": "N·m",
    "mm": "mm",
    "deg": "deg",
    "pct": "%",
    "N": "N",
}
PLAIN = "1"


def unit_of(parameter: str) -> str:
    """Unit of a parameter; ``"1"`` for a plain number.

    Examples
    --------
    >>> unit_of("rig_compliance_IE.compliance_deg_per_Nm"), unit_of("moment_gain_IE.gain")
    ('deg/N·m', '1')
    """
    last = parameter.rpartition(".")[2]
    return next((unit for end, unit in UNITS.items() if f"_{last}".endswith(f"_{end}")), PLAIN)
