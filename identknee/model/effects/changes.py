"""Effects made of a function: on the setting of the mechanics, or on what is read of a pose."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from identknee.mechanics.equilibria import Lines
from identknee.model.effects.effect import Effect, MechanicalEffect, ObservationEffect, Tests
from identknee.model.parameters import FreeParameters, Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import declared, entry

Changed = Callable[[Setting, Array], Setting]
Read = Callable[[Array, Array, Tests], Array]


@declared
class SettingChange:
    """An effect on lines or flexion."""

    name: str = entry("Name of the cause")
    parameters: Parameters = entry("Its amplitudes")
    changed: Changed = entry(
        "The setting with the effect, from the setting without it and the amplitudes"
    )

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with the effect at amplitudes `values`."""
        return self.changed(setting, values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CopiesChange(SettingChange):
    """The same whose function also takes amplitudes (k, a) of each copy."""

    def change_copies(self, setting: Setting, values: Array) -> Setting:
        """The setting with the effect at amplitudes ``values[i]`` in copy i."""
        return self.changed(setting, values)


@declared
class ReadingError:
    """An effect that turns actual coordinates into those that are read."""

    name: str = entry("Name of the cause")
    parameters: Parameters = entry("Its amplitudes")
    read: Read = entry(
        "The coordinates read, from those that are actual (n, 5), amplitudes and tests"
    )

    def observe(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """The coordinates read, shape ``(n, 5)`` [mm, deg]."""
        return self.read(coordinates, values, tests)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CopiesError(ReadingError):
    """The same whose function also takes amplitudes (k, a) of k copies of the trials."""

    def observe_copies(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """The coordinates read in k copies of the trials, copy i with amplitudes ``values[i]``."""
        return self.read(coordinates, values, tests)


def remeasured(setting: Setting, lines: Lines, changed: BoolArray) -> Setting:
    """The setting with other lines, those `changed` (m,) as long as they are in the scanned pose.

    A ligament's reference length is measured between its insertions: where they are put elsewhere,
    or the way between them is another, so is what was measured.
    """
    lengths = np.where(changed, setting.lengths_at_start(lines), lines.reference_length)
    return replace(setting, lines=replace(lines, reference_length=lengths))


def held(effect: Effect, fixed: Mapping[str, float]) -> Effect:
    """The effect with some of its amplitudes, by their whole names, held at given values."""
    free = effect.parameters.with_fixed([*fixed], effect.parameters.vector(fixed))
    if isinstance(effect, MechanicalEffect):
        changed = partial(_change_held, effect, free)
        return SettingChange(name=effect.name, parameters=free.parameters, changed=changed)
    if isinstance(effect, ObservationEffect):
        read = partial(_read_held, effect, free)
        return ReadingError(name=effect.name, parameters=free.parameters, read=read)
    raise TypeError(f"{effect.name} changes neither the setting nor what is read")


def _change_held(
    effect: MechanicalEffect, free: FreeParameters, setting: Setting, values: Array
) -> Setting:
    return effect.change(setting, free.expand(values))


def _read_held(
    effect: ObservationEffect,
    free: FreeParameters,
    coordinates: Array,
    values: Array,
    tests: Tests,
) -> Array:
    return effect.observe(coordinates, free.expand(values), tests)
