"""History: readings that depend on the order of trials and the phase of loading."""

from functools import partial

import numpy as np

from identknee.laxity.protocol import LOADS
from identknee.laxity.table import COORDINATES, PHASES
from identknee.model.effects.effect import ReadingError, TrialRecord, amplitudes
from identknee.runs.arrays import Array, IntArray

# Column of the moment and of the angle that goes with it.
COLUMNS = {
    "IE": (LOADS.index("internal_moment_Nm"), COORDINATES.index("internal_deg")),
    "VV": (LOADS.index("varus_moment_Nm"), COORDINATES.index("varus_deg")),
}


def rig_compliance(axis: str) -> ReadingError:
    """Rotation of the rig itself about one axis, ``"IE"`` or ``"VV"`` [deg/N·m].

    In proportion to the stated moment and alike at all angles of flexion. 0.01 to 0.05 deg/N·m for
    pins in bone and 0.2 to 1 deg/N·m for a boot are estimates.
    """
    name = f"rig_compliance_{axis}"
    made = amplitudes(name, ["compliance_deg_per_Nm"], [0.1], lower=[0.0], upper=[1.0])
    return ReadingError(name=name, parameters=made, read=partial(_with_rig_compliance, axis))


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

    Under a growing load the knee is half a width behind, under a falling one half a width ahead. A
    trial of neither phase is on neither side. 0.3 to 3 deg is an estimate.
    """
    names = [f"{axis}_deg" for axis in AXES]
    made = amplitudes("hysteresis", names, [1.0, 1.0], lower=[0.0, 0.0], upper=[8.0, 8.0])
    return ReadingError(name="hysteresis", parameters=made, read=_with_hysteresis)


def creep() -> ReadingError:
    """Growth of internal and varus rotation under load [deg per e-fold of the trials made].

    At 10 N·m, and in proportion to the moment: the longer a knee has been tested, the further it
    gives way, with the logarithm of the time as soft tissue does. The size is an estimate.
    """
    names = [f"{axis}_deg" for axis in AXES]
    made = amplitudes("creep", names, [0.5, 0.5], lower=[0.0, 0.0], upper=[3.0, 3.0])
    return ReadingError(name="creep", parameters=made, read=_with_creep)


def drift() -> ReadingError:
    """Change of each reading from the first trial to the last [mm, deg].

    In proportion to `order`, and nothing halfway: a part that is the same in all trials is no
    drift. 0.1 to 1 mm or deg is an estimate.
    """
    n = len(COORDINATES)
    made = amplitudes("drift", COORDINATES, n * [0.5], upper=n * [4.0])
    return ReadingError(name="drift", parameters=made, read=_with_drift)


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
