"""What an effect is: a physical cause that changes what a knee does or what is measured of it."""

from collections.abc import Sequence
from typing import Protocol, TypeGuard, runtime_checkable

import numpy as np

from identknee.model.parameters import Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array, IntArray
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

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with the effect at amplitudes `values`, shape ``(n,)``."""
        ...


@runtime_checkable
class SelfContainedEffect(MechanicalEffect, Protocol):
    """A mechanical effect on lines of its own that no other effect changes."""

    def gradient_columns(
        self, setting: Setting, values: Array, flexion: Array, poses: Array
    ) -> Array:
        """Derivatives of the energy's gradient by the amplitudes at fixed poses, ``(n, 5, a)``."""
        ...


@runtime_checkable
class CopiesEffect(MechanicalEffect, Protocol):
    """A mechanical effect that may have other amplitudes in each of several copies of a setting.

    Its derivatives are had faster then.
    """

    def change_copies(self, setting: Setting, values: Array) -> Setting:
        """The setting with the effect at amplitudes ``values[i]`` in copy i, values ``(k, a)``."""
        ...


@runtime_checkable
class ObservationEffect(Effect, Protocol):
    """An effect on what is measured of a pose, not on the pose."""

    def observe(self, coordinates: Array, values: Array, tests: "Tests") -> Array:
        """What is measured, shape ``(n, 5)``, where the coordinates (n, 5) are as given."""
        ...


@runtime_checkable
class CopiesObservation(ObservationEffect, Protocol):
    """An effect on what is measured that may have other amplitudes in each copy of all trials."""

    def observe_copies(self, coordinates: Array, values: Array, tests: "Tests") -> Array:
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
    """Whether an effect knows the derivatives of its lines itself."""
    return hasattr(effect, "gradient_columns")


def is_changed_in_copies(effect: Effect) -> TypeGuard[CopiesEffect]:
    """Whether an effect may have other amplitudes in each copy of a setting."""
    return hasattr(effect, "change_copies")


def is_read_in_copies(effect: Effect) -> TypeGuard[CopiesObservation]:
    """Whether an effect may have other amplitudes in each copy of all trials."""
    return hasattr(effect, "observe_copies")


@declared
class Tests:
    """The trials as they were run."""

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

    def repeated(self, n: int) -> "Tests":
        """The same trials `n` times, one after the other."""
        return Tests(
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
