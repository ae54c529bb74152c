"""Compliance of the rig: clamps and soft tissue yield and their rotation is read as the knee's."""

from functools import partial

import numpy as np

from identknee.laxity.protocol import LOADS
from identknee.laxity.table import COORDINATES
from identknee.model.effects.changes import ReadingError
from identknee.model.effects.effect import Tests, amplitudes
from identknee.runs.arrays import Array

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
    return ReadingError(name=name, parameters=made, read=partial(_yielded, axis))


def _yielded(axis: str, coordinates: Array, values: Array, tests: Tests) -> Array:
    load, angle = COLUMNS[axis]
    read = np.array(coordinates)
    read[:, angle] += values[0] * tests.loads[:, load]
    return read
