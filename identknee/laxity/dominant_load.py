"""Which load a trial is about, and which trial has the opposite one."""

import numpy as np

from identknee.laxity.protocol import Protocol
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared

# Loads of a usual laxity test: a load counts by its share of these.
TYPICAL = np.array([5.0, 10.0, 100.0, 100.0, 100.0])
# Below this share a load is a stray one. A constant load, such as compression, is none of a trial.
STRAY = 0.1
# Share of the largest load of a trial below which another is a stray one beside it.
STRAY_BESIDE = 0.2
# Opposite loads may differ by this share of them, and their flexion angles by so much [deg].
ALIKE, SAME_FLEXION_DEG = 0.5, 5.0


@declared
class DominantLoads:
    """The dominant load of each trial."""

    axis: IntArray = array("Its place among the loads; -1 where there is none", "trial", dtype=int)
    size: Array = array(
        "Its size with its sign, less what all trials hold", "trial", unit="N or N m"
    )


def dominant_loads(protocol: Protocol) -> DominantLoads:
    """The load that each trial is about: the largest beside a usual test's, stray ones aside.

    A load that no trial is without, such as compression, is counted from its median, unless the
    trials then have no load left.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> found = dominant_loads(load_protocol("drawer"))
    >>> found.axis[:3].tolist(), found.size[:3].tolist()
    ([2, -1, 2], [-100.0, 0.0, 134.0])
    """
    loads = _changes(protocol)
    share = np.abs(loads) / TYPICAL
    if not np.any(share >= STRAY):
        # As in drawer one way alone, or in a single trial.
        loads = protocol.loads
        share = np.abs(loads) / TYPICAL
    axis = np.argmax(share, axis=1)
    rows = np.arange(protocol.n)
    is_stray = share[rows, axis] < STRAY
    return DominantLoads(
        axis=np.where(is_stray, -1, axis), size=np.where(is_stray, 0.0, loads[rows, axis])
    )


def nominal_loads(protocol: Protocol) -> Array:
    """The loads that tell the trials apart, shape ``(n, 5)``: stray and constant ones are zero.

    A load is a stray one where it is small, also beside the largest of its trial, unless it is the
    only one; one that no trial is without, such as compression, is counted from its median.
    """
    share = np.abs(_changes(protocol)) / TYPICAL
    alone = np.count_nonzero(share, axis=1, keepdims=True) == 1
    least = np.maximum(STRAY, STRAY_BESIDE * share.max(axis=1, keepdims=True))
    told = np.where((share >= least) | (alone & (share > 0.0)), protocol.loads, 0.0)
    return told if told.any() else protocol.loads


def _changes(protocol: Protocol) -> Array:
    """Loads less what the rig holds throughout: the median of a load that no trial is without."""
    signs = np.sign(protocol.loads)
    is_held = np.all(signs == signs[:1], axis=0) & (signs[0] != 0.0)
    return protocol.loads - np.where(is_held, np.median(protocol.loads, axis=0), 0.0)


def nominal_flexion(protocol: Protocol) -> Array:
    """Nominal flexion of each trial [deg], shape ``(n,)``.

    Where most trials have an angle of their own, as a robot reads them, angles that are close
    together are one, their rounded mean; elsewhere they are what they are.
    """
    angles, place = np.unique(protocol.flexion_deg, return_inverse=True)
    if 2 * angles.size <= protocol.n:
        return protocol.flexion_deg
    cluster = np.cumsum(np.r_[0, np.diff(angles) > SAME_FLEXION_DEG])[place]
    sums = np.bincount(cluster, weights=protocol.flexion_deg)
    return np.asarray(np.round(sums / np.bincount(cluster))[cluster])


def opposite_pairs(protocol: Protocol) -> IntArray:
    """Pairs of trials under opposite loads at about the same flexion, shape ``(k, 2)``.

    The trial with the positive load stands first; each trial is in one pair at most, the most alike
    in flexion and size first.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> opposite_pairs(load_protocol("drawer"))[0].tolist()
    [2, 0]
    """
    found = dominant_loads(protocol)
    apart = np.abs(protocol.flexion_deg[:, None] - protocol.flexion_deg)
    size = np.where(found.size == 0.0, np.inf, np.abs(found.size))
    unlike = np.abs(found.size[:, None] + found.size) / size
    fits = (
        (found.axis[:, None] == found.axis)
        & (found.size[:, None] > 0.0)
        & (found.size < 0.0)
        & (apart <= SAME_FLEXION_DEG)
        & (unlike <= ALIKE)
    )
    first, second = np.nonzero(fits)
    distance = apart[first, second] / SAME_FLEXION_DEG + unlike[first, second] / ALIKE
    order = np.lexsort((first, distance))
    taken: set[int] = set()
    pairs = []
    for i, j in zip(first[order].tolist(), second[order].tolist(), strict=True):
        if not taken & {i, j}:
            taken |= {i, j}
            pairs.append((i, j))
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)
