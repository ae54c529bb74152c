"""How files count angles: whole turns cut off, and flexion from a straight knee at 180 deg."""

import numpy as np

from identknee.laxity.protocol import FLEXION_LIMITS_DEG
from identknee.runs.arrays import Array

TURN, STRAIGHT = 360.0, 180.0
# Beyond this no angle of a knee is likely, so that less a whole turn it is what was meant.
LIKELY_DEG = 90.0
# Angles that are all this far from zero, on both sides, lie about half a turn.
NEAR_HALF = 150.0


def flexion_turns(values: Array) -> Array:
    """What to add to each flexion angle [deg]: a whole turn where only that makes it one.

    Examples
    --------
    >>> flexion_turns(np.array([357.0, 2.0, 90.0, 200.0])).tolist()
    [-360.0, 0.0, 0.0, 0.0]
    """
    low, high = FLEXION_LIMITS_DEG
    turns = np.zeros(len(values))
    for turn in (-TURN, TURN):
        is_meant = (values + turn >= low) & (values + turn <= high)
        turns[is_meant & ~((values >= low) & (values <= high))] = turn
    return turns


def is_from_straight(values: Array) -> bool:
    """Whether flexion angles [deg] are those of a knee that is straight at 180 deg.

    All of them are such angles, and some can be nothing else.

    Examples
    --------
    >>> is_from_straight(np.array([178.0, 150.0, -176.0])), is_from_straight(np.array([2.0, 170.0]))
    (True, False)
    """
    known = values[~np.isnan(values)]
    low, high = FLEXION_LIMITS_DEG
    counted = STRAIGHT - known % TURN
    turned = known + flexion_turns(known)
    beyond = (turned < low) | (turned > high)
    return bool(beyond.any() and np.all((counted >= low) & (counted <= high)))


def is_negative(values: Array) -> bool:
    """Whether flexion angles [deg] are those of a knee that flexes towards negative angles.

    All of them are such angles, and some can be nothing else.

    Examples
    --------
    >>> is_negative(np.array([2.0, -30.0, -90.0])), is_negative(np.array([-30.0, 60.0]))
    (True, False)
    """
    known = values[~np.isnan(values)]
    low, high = FLEXION_LIMITS_DEG
    turned = known + flexion_turns(known)
    return bool((turned < low).any() and np.all((-turned >= low) & (-turned <= high)))


def coordinate_turns(values: Array) -> Array:
    """What to add to each value of an angle [deg] so that the column has no jump of a whole turn.

    Values beyond half a turn are turned back to what a knee may have. Where all are near half a
    turn, on either side of it, as changes from a zero can be, they are cut where the widest gap is.

    Examples
    --------
    >>> coordinate_turns(np.array([358.0, 3.0, 12.0])).tolist()
    [-360.0, 0.0, 0.0]
    >>> coordinate_turns(np.array([178.0, -179.0, -171.0])).tolist()
    [-360.0, 0.0, 0.0]
    >>> coordinate_turns(np.array([200.0, 12.0])).tolist()
    [0.0, 0.0]
    """
    none = np.zeros(len(values))
    known = values[~np.isnan(values)]
    half = TURN / 2.0
    is_within = np.abs(known) <= half
    is_split = bool(known.size) and np.abs(known).min() >= NEAR_HALF and np.ptp(known) > half
    if is_within.all() and not is_split:
        return none
    around = np.sort(known % TURN)
    gaps = np.diff(np.r_[around, around[0] + TURN])
    first = around[(int(np.argmax(gaps)) + 1) % len(around)]
    lifted = first + (known - first) % TURN
    lifted -= TURN * np.round(np.median(lifted) / TURN)
    turns = TURN * np.round((lifted - known) / TURN)
    turned = known + turns
    is_likely = bool(np.all(np.abs(turned[~is_within]) <= LIKELY_DEG))
    if np.ptp(turned) > half or not is_likely or np.abs(turns).max() > TURN:
        return none
    none[~np.isnan(values)] = turns
    return none


def default_angles(low: float, high: float, step: float = 15.0) -> tuple[float, ...]:
    """Flexion angles [deg] at which a ramp between two of them is read.

    Examples
    --------
    >>> default_angles(3.0, 62.0), default_angles(17.0, 25.0)
    ((15.0, 30.0, 45.0, 60.0), (21.0,))
    """
    first, last = int(np.ceil(low / step)), int(np.floor(high / step))
    found = tuple(step * k for k in range(first, last + 1))
    return found or ((low + high) / 2.0,)
