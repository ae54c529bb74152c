"""Effects on what is read: frames, the rig, the order and phase of trials, remounting."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from identknee.laxity.protocol import LOADS
from identknee.laxity.table import COORDINATES, PHASES, ROTATIONS, TRANSLATIONS
from identknee.mechanics.pose import (
    angles_of,
    coordinates_from_pose,
    pose_from_coordinates,
    rotation_matrix,
)
from identknee.model.effects.effect import (
    InputsChange,
    ReadingError,
    TrialRecord,
    effect_of,
)
from identknee.model.effects.facts import REMOUNTING
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.runs.declare import Array, IntArray
from identknee.subject.knee import Knee

FRAME_SD, FRAME_LIMIT = 2.0, 10.0  # deg


def femur_frame() -> ReadingError:
    """The femur's axes, as the rig has them, turned about their x and y [deg].

    A turn about z is an offset of flexion. Turns of 1 to 5 deg, which cause cross-talk between
    flexion and the other rotations where axes come from landmarks, are an estimate.
    """
    return effect_of(
        *(ReadingError, "femur_frame", ["x_deg", "y_deg"], 2 * [FRAME_SD]),
        upper=2 * [FRAME_LIMIT],
        read=_from_turned_femur,
        differs_by_replica=True,
    )


def tibia_frame() -> ReadingError:
    """The tibia's axes, as the rig has them, turned about their x, y and z [deg]."""
    return effect_of(
        *(ReadingError, "tibia_frame", ["x_deg", "y_deg", "z_deg"], 3 * [FRAME_SD]),
        upper=3 * [FRAME_LIMIT],
        read=_of_turned_tibia,
        differs_by_replica=True,
    )


def flexion_offset() -> InputsChange:
    """An error of flexion, positive where the knee was flexed more than stated [deg].

    The size, 1 to 4 deg, is an estimate.
    """
    names = ["flexion_deg"]
    return effect_of(InputsChange, "flexion_offset", names, [2.0], upper=[8.0], changed=_flexed)


def _from_turned_femur(coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    about_x_y = np.concatenate([values, np.zeros((*values.shape[:-1], 1))], axis=-1)
    return _read(coordinates, tests, _turns(about_x_y), _turns(np.zeros(3)))


def _of_turned_tibia(coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    return _read(coordinates, tests, _turns(np.zeros(3)), _turns(values))


def _turns(values: Array) -> Array:
    """Rotation matrices of vectors (3,) or (k, 3) [deg], shape ``(3, 3, k)``."""
    # Imported here, because the import takes longer than a simulation.
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(np.radians(np.atleast_2d(values))).as_matrix()
    return np.asarray(np.moveaxis(turns, 0, 2))


def _read(coordinates: Array, tests: TrialRecord, femur: Array, tibia: Array) -> Array:
    """Coordinates between frames that are turned from the true ones about the same origins.

    The tibial origin is the same point, but its components are taken along the axes of the rig:
    femoral z, tibial y and the perpendicular to both. Each of the k turns, shape ``(3, 3, k)``,
    applies to one of k equal parts of the coordinates.
    """
    n = len(coordinates)
    femur, tibia = (np.repeat(x, n // x.shape[2], axis=2) for x in (femur, tibia))
    pose, flexion = pose_from_coordinates(coordinates), np.radians(tests.flexion_deg)
    actual = rotation_matrix(flexion, pose[:, 0], pose[:, 1])
    turned = np.einsum("ikn,kln->iln", np.einsum("jin,jkn->ikn", femur, actual), tibia)
    read_flexion, varus, internal = angles_of(turned)
    none = np.zeros(n)
    origin = np.einsum("ikn,nk->in", rotation_matrix(flexion, none, none), pose[:, 2:])
    origin = np.einsum("jin,jn->in", femur, origin)
    in_turned_axes = np.einsum("jin,jn->in", rotation_matrix(read_flexion, none, none), origin)
    return coordinates_from_pose(np.column_stack([varus, internal, *in_turned_axes]))


def _flexed(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    return replace(setting, flexion=setting.flexion + np.radians(values[0]))


# Columns of a moment and of the angle about the same axis.
COLUMNS = {
    "IE": (LOADS.index("internal_moment_Nm"), COORDINATES.index("internal_deg")),
    "VV": (LOADS.index("varus_moment_Nm"), COORDINATES.index("varus_deg")),
}


def rig_compliance(axis: str) -> ReadingError:
    """Rotation of the rig itself about one axis, ``"IE"`` or ``"VV"`` [deg/N·m].

    It is proportional to the stated moment and the same at all flexion angles. The sizes, 0.01 to
    0.05 deg/N·m for pins in bone and 0.2 to 1 deg/N·m for a boot, are estimates.
    """
    return effect_of(
        *(ReadingError, f"rig_compliance_{axis}", ["compliance_deg_per_Nm"], [0.1]),
        lower=[0.0],
        upper=[1.0],
        read=partial(_with_rig_compliance, axis),
    )


def _with_rig_compliance(axis: str, coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    load, angle = COLUMNS[axis]
    read = np.array(coordinates)
    read[:, angle] += values[0] * tests.loads[:, load]
    return read


LOADING, UNLOADING = PHASES
FULL_MOMENT = 10.0  # N·m
AXES = tuple(COLUMNS)


def hysteresis() -> ReadingError:
    """Width of the loops of internal and varus rotation [deg].

    Rotations are smaller by half a width during loading, and larger by half a width during
    unloading; trials in neither phase are unchanged. The size, 0.3 to 3 deg, is an estimate.
    """
    return effect_of(
        *(ReadingError, "hysteresis", [f"{axis}_deg" for axis in AXES], [1.0, 1.0]),
        lower=[0.0, 0.0],
        upper=[8.0, 8.0],
        read=_with_hysteresis,
    )


def creep() -> ReadingError:
    """Growth of internal and varus rotation under load [deg per e-fold of the trials made].

    The growth is that at 10 N·m and proportional to the moment. Like creep of soft tissue, it goes
    with the logarithm of time, for which the number of trials stands. The size is an estimate.
    """
    return effect_of(
        *(ReadingError, "creep", [f"{axis}_deg" for axis in AXES], [0.5, 0.5]),
        lower=[0.0, 0.0],
        upper=[3.0, 3.0],
        read=_with_creep,
    )


def drift() -> ReadingError:
    """Change of each reading from the first trial to the last [mm, deg].

    The change is linear in `order` and zero halfway, because a constant error is no drift. The
    size, 0.1 to 1 mm or deg, is an estimate.
    """
    n, names = len(COORDINATES), COORDINATES
    return effect_of(ReadingError, "drift", names, n * [0.5], upper=n * [4.0], read=_with_drift)


def _with_hysteresis(coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    if tests.phase is None:
        raise ValueError(
            "hysteresis needs to know which trials were loading and which unloading; add a column "
            "phase to the laxity table, or leave the effect out"
        )
    phase = np.array(tests.phase)
    ahead = 0.5 * ((phase == UNLOADING).astype(float) - (phase == LOADING))
    return _turned(coordinates, values, ahead[:, None] * np.sign(_moments(tests)))


def _with_creep(coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    order = _order("creep", tests)
    grown = np.log(order - order.min() + 1.0)
    return _turned(coordinates, values, grown[:, None] * _moments(tests) / FULL_MOMENT)


def _with_drift(coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    order = _order("drift", tests)
    share = (order - order.min()) / max(int(np.ptp(order)), 1)
    return np.asarray(coordinates + (share[:, None] - 0.5) * values)


def _order(cause: str, tests: TrialRecord) -> IntArray:
    if tests.order is None:
        raise ValueError(
            f"{cause} needs to know in which order the trials were made; add a column order to the "
            "laxity table, or leave the effect out"
        )
    return tests.order


def _moments(tests: TrialRecord) -> Array:
    """Stated moments of `AXES` [N·m], shape ``(n, 2)``."""
    return np.asarray(tests.loads[:, [load for load, _ in COLUMNS.values()]])


def _turned(coordinates: Array, values: Array, shape: Array) -> Array:
    """Readings with amplitudes times `shape` (n, 2) added to the angles of `AXES`."""
    read = np.array(coordinates)
    read[:, [angle for _, angle in COLUMNS.values()]] += shape * values
    return read


# Standard deviation of the pose after remounting, an estimate, and its bound [mm, deg].
ZERO_SD, FARTHEST = 0.5, 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Remounting(ReadingError):  # noqa: N818 - an error of reading
    """Offsets of the five coordinates at every flexion angle [mm, deg]."""

    def applied(self, knee: Knee, values: Array) -> Knee:
        """The knee with stated zero errors of the size found, to be marginalised."""
        offsets = values.reshape(-1, len(COORDINATES))
        mm, deg = (float(np.sqrt(np.mean(offsets[:, x] ** 2))) for x in (TRANSLATIONS, ROTATIONS))
        return knee.with_uncertainty(replace(knee.uncertainty, zero_mm=mm, zero_deg=deg))


def remounting(angles: Sequence[float]) -> Remounting:
    """Offsets of every coordinate at these flexion angles [deg]; elsewhere there are none."""
    names = [f"flexion{angle:g}_{name}" for angle in angles for name in COORDINATES]
    return effect_of(
        *(Remounting, REMOUNTING, names, len(names) * [ZERO_SD]),
        upper=len(names) * [FARTHEST],
        read=partial(_offset, np.array(angles)),
        differs_by_replica=True,
    )


def _offset(angles: Array, coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    offsets = values.reshape(*values.shape[:-1], len(angles), len(COORDINATES))
    is_there = tests.flexion_deg[:, None] == angles
    if values.ndim == 1:
        return np.asarray(coordinates + is_there @ offsets)
    copies = is_there.reshape(len(values), -1, len(angles))
    return np.asarray(coordinates + (copies @ offsets).reshape(coordinates.shape))
