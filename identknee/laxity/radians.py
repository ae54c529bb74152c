"""Flexion of an OpenSim storage that holds radians under a line that says degrees."""

import numpy as np

from identknee.runs.arrays import Array

DEG = 57.29577951308232
# Protocols use multiples of STEP [deg]. Different angles that all lie within CLOSE of multiples are
# not there by chance. A single angle must lie within EXACTLY, rounding to 1e-4 rad.
STEP, CLOSE, EXACTLY = 5.0, 0.05, 0.003
# No knee flexes farther [deg].
FARTHEST = 165.0


def is_in_radians(values: Array) -> bool:
    """Whether flexion angles are round numbers of degrees written in radians.

    A single angle must agree to many digits, and must not be a round number as it is written.

    Examples
    --------
    >>> is_in_radians(np.array([0.0, 0.5236, 1.0472])), is_in_radians(np.array([0.0, 0.5, 1.0]))
    (True, False)
    >>> is_in_radians(np.array([0.43633, 0.43633])), is_in_radians(np.array([0.44, 0.44]))
    (True, False)
    """
    known = values[~np.isnan(values) & (values != 0.0)]
    turned = DEG * known
    if not turned.size or turned.min() < STEP / 2.0 or turned.max() > FARTHEST:
        return False
    step = np.round(turned / STEP)
    off = np.abs(turned - STEP * step)
    if len(np.unique(step)) > 1:
        return bool(np.all(off < CLOSE))
    is_round = np.abs(known - np.round(known, 2)) < 1e-3
    return bool(np.all(off < EXACTLY) and not is_round.any())
