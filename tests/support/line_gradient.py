"""What the lines of a setting add to the gradient of the energy."""

from identknee.mechanics.ligament_tensions import ligament_tensions
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.runs.declare import Array


def line_gradient(setting: MechanicsInputs, flexion: Array, poses: Array) -> Array:
    """At given angles (n,) and poses (n, 5), shape ``(n, 5)``."""
    return ligament_tensions(
        setting.lines, flexion, poses, setting.stiffness, setting.reference_strain
    ).gradient
