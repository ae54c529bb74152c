"""Errors of the tests: axes and size of the loads, the angle of flexion."""

from dataclasses import replace

import numpy as np

from identknee.model.effects.changes import SettingChange
from identknee.model.effects.effect import amplitudes
from identknee.model.effects.frames import flexion_offset
from identknee.model.effects.insertion import AXES
from identknee.model.effects.loads import INTERNAL, VARUS, LoadError, X, Y, Z
from identknee.runs.arrays import Array

# Standard deviations within which an amplitude lies.
REACH = 4.0
KINDS = ("varus_moment", "internal_moment", "anterior_force", "axial_force", "lateral_force")
MOMENTS, FORCES = [VARUS, INTERNAL], [X, Y, Z]


def load_axes(sd_deg: float) -> LoadError:
    """Loads along axes that are turned about the joint's x, y and z [deg]."""
    names = [f"{x}_deg" for x in AXES]
    made = amplitudes("load_axes", names, 3 * [sd_deg], upper=3 * [REACH * sd_deg])
    return LoadError(name="load_axes", parameters=made.as_nuisances(), acted=_turned)


def load_gain(sd: float) -> LoadError:
    """A wrong scale of each kind of load [-]."""
    made = amplitudes("load_gain", KINDS, 5 * [sd], upper=5 * [REACH * sd])
    return LoadError(name="load_gain", parameters=made.as_nuisances(), acted=_scaled)


def flexion(sd_deg: float) -> SettingChange:
    """How much more the knee was flexed than stated, in all trials alike [deg]."""
    made = amplitudes("flexion", ["offset_deg"], [sd_deg], upper=[REACH * sd_deg])
    return replace(flexion_offset(), name="flexion", parameters=made.as_nuisances())


def _turned(loads: Array, _flexion: Array, values: Array) -> Array:
    # Loaded late: it takes longer than a simulation.
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(np.radians(values))
    moments = np.column_stack([loads[:, MOMENTS], np.zeros(len(loads))])
    acted = np.array(loads)
    # Of a moment about the axis of flexion the rig takes up all.
    acted[:, MOMENTS] = turn.apply(moments)[:, :2]
    acted[:, FORCES] = turn.apply(loads[:, FORCES])
    return acted


def _scaled(loads: Array, _flexion: Array, values: Array) -> Array:
    return loads * (1.0 + values)
