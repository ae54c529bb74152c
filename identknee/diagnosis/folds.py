"""The measured values row by row, and the trials to be held out together."""

import numpy as np

from identknee.diagnosis.noise_model import NoiseModel
from identknee.laxity.protocol import (
    DIRECTIONS,
    SAME_ANGLE_DEG,
    Protocol,
    nominal_flexion,
    nominal_loads,
)
from identknee.laxity.table import ROTATIONS, Laxity
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import array, declared, entry

FLEXION = "flexion"
DIRECTION = "load direction"
EXTREMES = "extreme loads"
FAMILIES = (FLEXION, DIRECTION, EXTREMES)
# Share of the largest load of its kind beyond which a load is extreme.
EXTREME_SHARE = 0.8
ROUNDING = 1e-9


@declared
class Fold:
    """Trials that are held out of a fit together.

    Raises
    ------
    ValueError
        If all trials are held out, or none.
    """

    family: str = entry("One of `FAMILIES`")
    name: str = entry('Which trials, such as ``"30 deg"`` or ``"varus moment"``')
    held: BoolArray = array(
        "Whether a trial is held out; some are and some are not", "trial", dtype=bool
    )

    def __post_init__(self) -> None:
        if self.held.all() or not self.held.any():
            raise ValueError(
                f"the fold {self.name!r} must hold out some trials and keep some; "
                f"it holds out {int(self.held.sum())} of {self.held.size}"
            )


def held_out_folds(protocol: Protocol) -> tuple[Fold, ...]:
    """Folds of three families: a flexion angle, a direction of load, and the largest loads.

    A fold that would hold out every trial is none: a protocol of one flexion angle has no fold of
    that family. A load of one size only has no extremes, since nothing smaller of it is left to
    learn from. In a robot's table a flexion angle is the one that was meant, and loads are those
    that a trial is about: stray ones have no direction.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> [fold.name for fold in held_out_folds(load_protocol("seed63"))][:5]
    ['0 deg', '30 deg', '60 deg', 'internal moment', 'external moment']
    """
    found = [(FLEXION, *x) for x in _flexions(nominal_flexion(protocol))]
    for names, load in zip(DIRECTIONS, _acting(protocol).T, strict=True):
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
    sizes = np.abs(_acting(protocol))
    largest = sizes.max(axis=0, initial=0.0)
    beyond = (sizes >= (EXTREME_SHARE - ROUNDING) * largest) & (sizes > 0)
    varies = ((sizes > 0) & ~beyond).any(axis=0)
    return np.asarray((beyond & varies).any(axis=1))


def _acting(protocol: Protocol) -> Array:
    """The loads, shape ``(n, 5)``; of a robot's trials, which read all of them, those told."""
    is_nominal = np.array_equal(nominal_flexion(protocol), protocol.flexion_deg)
    return protocol.loads if is_nominal else nominal_loads(protocol)


def _flexions(flexion_deg: Array) -> list[tuple[str, BoolArray]]:
    """The trials of each flexion angle; angles of a rig that differ by its scatter are one."""
    angles = np.unique(flexion_deg)
    starts = np.flatnonzero(np.diff(angles, prepend=-np.inf) > SAME_ANGLE_DEG)
    group = np.searchsorted(angles[starts], flexion_deg, side="right") - 1
    return [
        (f"{np.median(flexion_deg[group == i]):g} deg", np.asarray(group == i))
        for i in range(len(starts))
    ]


@declared
class Rmse:
    """Root-mean-square errors; NaN, in a file null, where there is nothing to compare."""

    mm: float = entry("Error of the translations", unit="mm")
    deg: float = entry("Error of the rotations", unit="deg")
    noise: float = entry(
        "Error of all values in units of their noise: 1 where nothing but noise is left", unit="1"
    )


@declared
class Observations:
    """What is known of the m measured values besides their size."""

    trial: IntArray = array("The trial of each", "value", dtype=int)
    coordinate: IntArray = array(
        "Its place in `identknee.laxity.table.COORDINATES`", "value", dtype=int
    )
    sd: Array = array("Standard deviation of its noise alone, in its unit, > 0", "value")
    noise: NoiseModel = entry("Covariance of all errors, nuisances included")
    n_trials: int = entry("Trials of the protocol, those that measured nothing included")

    @property
    def is_angle(self) -> BoolArray:
        """Whether a value is a rotation, shape ``(m,)``."""
        return np.asarray(self.coordinate >= ROTATIONS.start)

    def rmse(self, errors: Array) -> Rmse:
        """Root-mean-square of errors in mm and deg, shape ``(..., m)``; NaN is left out."""
        squares = errors**2
        return Rmse(
            mm=_root_mean(squares[..., ~self.is_angle]),
            deg=_root_mean(squares[..., self.is_angle]),
            noise=_root_mean(squares / self.sd**2),
        )


def observations_of(laxity: Laxity, sd: Array, noise: NoiseModel) -> Observations:
    """The measured values of `laxity`.

    Parameters
    ----------
    laxity
        The table.
    sd
        Standard deviation of the noise of each value, shape ``(n, 5)``; read where measured.
    noise
        Covariance of the errors, nuisances included.
    """
    trial, coordinate = np.nonzero(laxity.is_measured)
    return Observations(
        trial=trial,
        coordinate=coordinate,
        sd=sd[laxity.is_measured],
        noise=noise,
        n_trials=laxity.n,
    )


def _root_mean(squares: Array) -> float:
    known = squares[~np.isnan(squares)]
    return float(np.sqrt(known.mean())) if known.size else float("nan")
