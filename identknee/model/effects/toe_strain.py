"""Toe region: the strain at which a ligament's fibres are straight."""

from dataclasses import replace

import numpy as np

from identknee.model.effects.effect import InputsChange, amplitudes
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.runs.arrays import Array


def toe_strain() -> InputsChange:
    """Another transition strain of all of the subject's ligaments: change from 3 % [%].

    Knee models take 3 % since [1]_; that it is 1.5 to 4.5 % in a knee is an estimate.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883
    """
    made = amplitudes("toe_strain", ["transition_strain_pct"], [1.0], lower=[-2.0], upper=[3.0])
    return InputsChange(name="toe_strain", parameters=made, changed=_stretched)


def _stretched(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    is_own = setting.owner >= 0
    transition = setting.lines.transition + np.where(is_own, 0.01 * values[0], 0.0)
    return replace(setting, lines=replace(setting.lines, transition=transition))
