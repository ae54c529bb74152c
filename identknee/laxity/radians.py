"""Flexion that was written in radians where degrees belong."""

import numpy as np

from identknee.runs.arrays import Array

DEG = 57.29577951308232
# People flex knees to multiples of this [deg]; angles that are all so close to one are no chance.
STEP, CLOSE = 5.0, 0.05
# No knee flexes farther [deg].
FARTHEST = 165.0


def is_in_radians(values: Array) -> bool:
    """Whether flexion angles are round numbers of degrees written in radians.

    At least two of them differ from zero and each other, and as degrees they are not round.

    Examples
    --------
    >>> is_in_radians(np.array([0.0, 0.5236, 1.0472])), is_in_radians(np.array([0.0, 0.5, 1.0]))
    (True, False)
    """
    known = np.unique(np.round(values[~np.isnan(values)], 3))
    turned = DEG * known[known != 0.0]
    if len(turned) < 2 or turned.min() < 0.0 or turned.max() > FARTHEST:
        return False
    off = np.abs(turned - STEP * np.round(turned / STEP))
    return bool(np.all(off < CLOSE) and np.all(turned > STEP / 2.0))
