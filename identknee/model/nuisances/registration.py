"""Registration: the frames in which poses were measured are not those of the geometry."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from identknee.mechanics.grood_suntay import coordinates_from_pose, pose_from_coordinates
from identknee.mechanics.pose import angles_of, rotation_matrix
from identknee.model.effects.effect import Tests, amplitudes
from identknee.model.effects.loads import INTERNAL, VARUS, X, Y, Z
from identknee.model.nuisances.loading import REACH
from identknee.model.parameters import Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.subject.uncertainty import BONES

FORCES = [X, Y, Z]
NAMES = [f"{bone}_{axis}_{unit}" for bone in BONES for unit in ("deg", "mm") for axis in "xyz"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """The pose of each bone's measured frame in the frame of its geometry.

    A rigid transform of each bone. It acts on the readings, on the axes and points of the loads and
    on flexion, which the rig prescribes between its own frames. Loads and flexion are turned as in
    the measured attitude of each trial, or in a knee without varus and internal rotation where none
    was measured.

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
        tilt = _tilt(setting.attitude)
        turned = _tibia_in_femur(femur, tibia, _product(_flexed(setting.flexion), tilt))
        flexion, varus, internal = angles_of(turned)
        forces = setting.loads[:, FORCES]
        # Moments about the floating axis and the tibial axis, work-conjugate to the two angles.
        moments = setting.loads[:, [VARUS]] * [1.0, 0.0, 0.0]
        moments = moments + setting.loads[:, [INTERNAL]] * tilt[:, 1].T
        # The force acts at the measured origin of the tibia.
        to_axes = _product(tilt, _inverse(tibia.turn))
        moments += np.cross(_turned(to_axes, tibia.shift), forces)
        into_geometry = _product(femur.turn, _flexed(setting.flexion))
        turn = _product(_flexed(-flexion), into_geometry)
        loads = np.array(setting.loads)
        loads[:, FORCES] = _turned(turn, forces)
        loads[:, VARUS] = _turned(turn, moments)[:, 0]
        loads[:, INTERNAL] = _turned(_product(tibia.turn, _inverse(tilt)), moments)[:, 1]
        measured = setting.measured
        if measured is not None:
            origin = _turned(turn, measured[:, 2:]) + _turned(_flexed(-flexion), femur.shift)
            origin -= _turned(_product(_flexed(-flexion), turned), tibia.shift)
            measured = np.column_stack([varus, internal, origin])
        return replace(setting, loads=loads, flexion=flexion, measured=measured)

    def observe(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """The coordinates between the measured frames, shape ``(n, 5)``."""
        return self.observe_copies(coordinates, values[None], tests)

    def observe_copies(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """The same in k copies of the trials, copy i with amplitudes ``values[i]``."""
        femur, tibia = self._frames(values, len(coordinates))
        nominal = _flexed(np.radians(tests.flexion_deg))
        tilt = _tilt(tests.attitude)
        flexion = angles_of(_tibia_in_femur(femur, tibia, _product(nominal, tilt)))[0]
        pose = pose_from_coordinates(coordinates)
        actual = rotation_matrix(flexion, pose[:, 0], pose[:, 1])
        origin = _turned(_flexed(flexion), pose[:, 2:])
        between = _turned(actual, tibia.shift) + origin - femur.shift
        to_measured = _inverse(femur.turn)
        turns = _product(_product(to_measured, actual), tibia.turn)
        read_flexion, varus, internal = angles_of(turns)
        in_turned_axes = _turned(_flexed(-read_flexion), _turned(to_measured, between))
        return coordinates_from_pose(np.column_stack([varus, internal, in_turned_axes]))

    def _frames(self, values: Array, n: int) -> "tuple[_Frames, _Frames]":
        """The frames of n rows, of which each copy has as many, at values (k, a)."""
        whole = np.zeros((len(values), len(NAMES)))
        whole[:, list(self._used)] = values
        femur, tibia = np.moveaxis(whole.reshape(-1, 2, 2, 3), 1, 0)
        return _frames(femur, n), _frames(tibia, n)


@declared
class _Frames:
    """Measured frames of n rows in that of the geometry."""

    turn: Array = entry("Rotation matrices, shape ``(3, 3, n)``")
    shift: Array = entry("Origins [mm], shape ``(n, 3)``")


def _frames(values: Array, n: int) -> _Frames:
    """Frames of turns [deg] and shifts [mm], shape ``(k, 2, 3)``, each for an equal part of n."""
    each = n // len(values)
    turns = Rotation.from_rotvec(np.radians(values[:, 0])).as_matrix()
    return _Frames(
        turn=np.repeat(np.moveaxis(turns, 0, 2), each, axis=2),
        shift=np.repeat(values[:, 1], each, axis=0),
    )


def _tibia_in_femur(femur: _Frames, tibia: _Frames, measured: Array) -> Array:
    """Rotations between the frames of the geometry where those measured are turned so."""
    return _product(_product(femur.turn, measured), _inverse(tibia.turn))


def _tilt(attitude: Array) -> Array:
    """Rotations from the axes of the tibia into those that turn with flexion, ``(3, 3, n)``."""
    return rotation_matrix(np.zeros(len(attitude)), attitude[:, 0], attitude[:, 1])


def _flexed(angles: Array) -> Array:
    """Rotations from axes that turn with flexion into those of the femur, ``(3, 3, n)``."""
    none = np.zeros(len(angles))
    return rotation_matrix(angles, none, none)


def _product(first: Array, second: Array) -> Array:
    return np.asarray(np.einsum("ikn,kjn->ijn", first, second))


def _inverse(turns: Array) -> Array:
    return np.asarray(np.swapaxes(turns, 0, 1))


def _turned(turns: Array, vectors: Array) -> Array:
    """Vectors (n, 3) turned by matrices (3, 3, n)."""
    return np.asarray(np.einsum("ikn,nk->ni", turns, vectors))
