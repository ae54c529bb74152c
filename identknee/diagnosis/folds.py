"""Trials to be held out together: a model is judged by data that it was not fitted to."""

from dataclasses import dataclass

import numpy as np

from identknee.laxity.protocol import Protocol
from identknee.laxity.unloaded import SAME_ANGLE_DEG
from identknee.runs.arrays import Array, BoolArray

FLEXION = "flexion"
DIRECTION = "load direction"
EXTREMES = "extreme loads"
FAMILIES = (FLEXION, DIRECTION, EXTREMES)
# In the order of a protocol's loads: what a positive and a negative load are called.
DIRECTIONS = (
    ("internal moment", "external moment"),
    ("varus moment", "valgus moment"),
    ("anterior force", "posterior force"),
    ("distraction force", "compression force"),
    ("lateral force", "medial force"),
)
# Of the largest load of its kind: a load beyond this is extreme.
EXTREME_SHARE = 0.8
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fold:
    """Trials that are held out of a fit together.

    Attributes
    ----------
    family
        One of `FAMILIES`.
    name
        Which trials, such as ``"30 deg"`` or ``"varus moment"``.
    held
        Whether a trial is held out, shape ``(n,)``; some are and some are not.

    Raises
    ------
    ValueError
        If all trials are held out, or none.
    """

    family: str
    name: str
    held: BoolArray

    def __post_init__(self) -> None:
        held = np.array(self.held, dtype=np.bool_)
        held.flags.writeable = False
        object.__setattr__(self, "held", held)
        if held.all() or not held.any():
            raise ValueError(
                f"the fold {self.name!r} must hold out some trials and keep some; "
                f"it holds out {int(held.sum())} of {held.size}"
            )


def held_out_folds(protocol: Protocol) -> tuple[Fold, ...]:
    """Folds of three families: a flexion angle, a direction of load, and the largest loads.

    A fold that would hold out every trial is none: a protocol of one flexion angle has no fold of
    that family. A load of one size only has no extremes, since nothing smaller of it is left to
    learn from.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> [fold.name for fold in held_out_folds(load_protocol("seed63"))][:5]
    ['0 deg', '30 deg', '60 deg', 'internal moment', 'external moment']
    """
    found = [(FLEXION, *x) for x in _flexions(protocol.flexion_deg)]
    for names, load in zip(DIRECTIONS, protocol.loads.T, strict=True):
        found += [
            (DIRECTION, name, np.asarray(sign * load > 0))
            for name, sign in zip(names, (1.0, -1.0), strict=True)
        ]
    found.append((EXTREMES, "largest loads", extreme_trials(protocol)))
    return tuple(
        Fold(family=family, name=name, held=held)
        for family, name, held in found
        if held.any() and not held.all()
    )


def extreme_trials(protocol: Protocol) -> BoolArray:
    """Whether a trial bears a load of at least 80 % of the largest of its kind, shape ``(n,)``."""
    sizes = np.abs(protocol.loads)
    largest = sizes.max(axis=0, initial=0.0)
    beyond = (sizes >= (EXTREME_SHARE - ROUNDING) * largest) & (sizes > 0)
    varies = ((sizes > 0) & ~beyond).any(axis=0)
    return np.asarray((beyond & varies).any(axis=1))


def _flexions(flexion_deg: Array) -> list[tuple[str, BoolArray]]:
    """The trials of each flexion angle; angles of a rig that differ by its scatter are one."""
    angles = np.unique(flexion_deg)
    starts = np.flatnonzero(np.diff(angles, prepend=-np.inf) > SAME_ANGLE_DEG)
    group = np.searchsorted(angles[starts], flexion_deg, side="right") - 1
    return [
        (f"{np.median(flexion_deg[group == i]):g} deg", np.asarray(group == i))
        for i in range(len(starts))
    ]
