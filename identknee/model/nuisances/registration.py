"""Registration: the frames in which poses were measured are not those of the geometry."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from identknee.mechanics.grood_suntay import coordinates_from_pose, pose_from_coordinates
from identknee.model.effects.effect import Tests, amplitudes
from identknee.model.effects.loads import INTERNAL, VARUS, X, Y, Z
from identknee.model.nuisances.loading import REACH
from identknee.model.parameters import Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array
from identknee.subject.uncertainty import BONES

MOMENTS, FORCES = [VARUS, INTERNAL], [X, Y, Z]
NAMES = [f"{bone}_{axis}_{unit}" for bone in BONES for unit in ("deg", "mm") for axis in "xyz"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """The pose of each bone's measured frame in the frame of its geometry.

    A rigid transform of each bone. It acts on the readings, on the axes and points of the loads and
    on flexion, which the rig prescribes between its own frames. Loads and flexion are turned as in
    a knee without varus and internal rotation.

    Attributes
    ----------
    sd_deg, sd_mm
        Prior standard deviations of the rotations and translations; 0 where there are none.
    name
        Name of the cause.
    parameters
        Rotations about [deg] and shifts along [mm] the axes of the geometry's frame.
    """

    sd_deg: float
    sd_mm: float
    name: str = "registration"
    parameters: Parameters = field(init=False, repr=False)
    _used: tuple[int, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        sds = np.array(2 * (3 * [self.sd_deg] + 3 * [self.sd_mm]))
        used = np.flatnonzero(sds).tolist()
        chosen = sds[used]
        made = amplitudes(
            self.name,
            [NAMES[i] for i in used],
            chosen.tolist(),
            upper=(REACH * chosen).tolist(),
        )
        object.__setattr__(self, "parameters", made.as_nuisances())
        object.__setattr__(self, "_used", tuple(used))

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with loads and flexion between the measured frames."""
        return self.change_copies(setting, values[None])

    def change_copies(self, setting: Setting, values: Array) -> Setting:
        """The same at amplitudes ``values[i]`` in copy i."""
        femur, tibia = self._frames(values, len(setting.loads))
        flexion = _flexion_between(femur.turn, tibia.turn, setting.flexion)
        in_measured_axes = setting.loads[:, FORCES]
        moments = np.column_stack([setting.loads[:, MOMENTS], np.zeros(len(setting.loads))])
        # The force acts at the measured origin of the tibia.
        moments += np.cross(tibia.turn.inv().apply(tibia.shift), in_measured_axes)
        turns = _about_z(flexion) * femur.turn * _about_z(-setting.flexion)
        loads = np.array(setting.loads)
        loads[:, FORCES] = turns.apply(in_measured_axes)
        loads[:, VARUS] = turns.apply(moments)[:, 0]
        loads[:, INTERNAL] = tibia.turn.apply(moments)[:, 1]
        return replace(setting, loads=loads, flexion=flexion)

    def observe(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """The coordinates between the measured frames, shape ``(n, 5)``."""
        return self.observe_copies(coordinates, values[None], tests)

    def observe_copies(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """The same in k copies of the trials, copy i with amplitudes ``values[i]``."""
        femur, tibia = self._frames(values, len(coordinates))
        stated = np.radians(tests.flexion_deg)
        flexion = _flexion_between(femur.turn, tibia.turn, stated)
        pose = pose_from_coordinates(coordinates)
        actual = Rotation.from_euler("ZXY", np.column_stack([-flexion, pose[:, 0], pose[:, 1]]))
        origin = _about_z(-flexion).apply(pose[:, 2:])
        angles = (femur.turn.inv() * actual * tibia.turn).as_euler("ZXY")
        between = femur.turn.inv().apply(actual.apply(tibia.shift) + origin - femur.shift)
        in_turned_axes = _about_z(-angles[:, 0]).apply(between)
        return coordinates_from_pose(np.column_stack([angles[:, 1:], in_turned_axes]))

    def _frames(self, values: Array, n: int) -> "tuple[_Frame, _Frame]":
        """The frames of n rows, of which each copy has as many, at values (k, a)."""
        whole = np.zeros((len(values), len(NAMES)))
        whole[:, list(self._used)] = values
        rows = np.repeat(whole, n // len(values), axis=0).reshape(-1, 2, 2, 3)
        return _frame(rows[:, 0]), _frame(rows[:, 1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Frame:
    """Measured frames in that of the geometry: their turns, and their origins [mm], ``(n, 3)``."""

    turn: Rotation
    shift: Array


def _frame(values: Array) -> _Frame:
    """Frames of turns [deg] and shifts [mm], shape ``(n, 2, 3)``."""
    return _Frame(turn=Rotation.from_rotvec(np.radians(values[:, 0])), shift=values[:, 1])


def _flexion_between(femur: Rotation, tibia: Rotation, measured: Array) -> Array:
    """Flexion between the frames of the geometry where it is so much between those measured."""
    turns = femur * _about_z(-measured) * tibia.inv()
    return -np.asarray(turns.as_euler("ZXY"))[:, 0]


def _about_z(angles: Array) -> Rotation:
    return Rotation.from_euler("z", angles[:, None])
