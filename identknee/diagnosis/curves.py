"""The load curves of a protocol: trials that differ in one load only."""

import numpy as np

from identknee.diagnosis.noise_model import Curve
from identknee.laxity.protocol import LOADS, Protocol

LEAST_POINTS = 3


def load_curves(protocol: Protocol) -> tuple[Curve, ...]:
    """Curves of at least three trials of one flexion angle and one varying load.

    The other loads are the same all along a curve. A trial without load may be on several curves;
    of replicates the first is on it.
    """
    curves = []
    for axis in range(len(LOADS)):
        others = np.delete(protocol.loads, axis, axis=1)
        setting = np.column_stack([protocol.flexion_deg, others])
        for row in np.unique(setting, axis=0):
            members = np.flatnonzero((setting == row).all(axis=1))
            load, first = np.unique(protocol.loads[members, axis], return_index=True)
            if len(load) >= LEAST_POINTS:
                curves.append(Curve(trials=members[first], load=load))
    return tuple(curves)
