"""How far a simulated laxity is from a measured one."""

from dataclasses import dataclass

import numpy as np

from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.laxity.unloaded import relative_to_unloaded
from identknee.runs.arrays import Array, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaxityError:
    """Root-mean-square differences of two laxities; NaN where nothing was compared.

    Attributes
    ----------
    mm
        Over the three translations [mm].
    deg
        Over varus and internal rotation [deg].
    by_coordinate
        In the order and units of `COORDINATES` [mm, deg], shape ``(5,)``.
    flexion_deg
        The flexion angles, ascending [deg], shape ``(n_angles,)``.
    by_flexion
        At each flexion angle, shape ``(n_angles, 5)``.
    n_compared
        How many cells were compared.
    n_missing
        How many cells were measured and have no simulated value. They are left out, so that any
        number but 0 here makes the others too good.
    """

    mm: float
    deg: float
    by_coordinate: Array
    flexion_deg: Array
    by_flexion: Array
    n_compared: int
    n_missing: int

    def __post_init__(self) -> None:
        for name, shape in (
            ("by_coordinate", (len(COORDINATES),)),
            ("flexion_deg", (None,)),
            ("by_flexion", (len(self.flexion_deg), len(COORDINATES))),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), *shape, name=name))


def laxity_rmse(simulated: Laxity, measured: Laxity) -> LaxityError:
    """Root-mean-square difference over all that was measured.

    Where only `measured` is relative to the unloaded pose, `simulated` is made so first.

    Raises
    ------
    ValueError
        If the trials differ, or only `simulated` is relative to the unloaded pose.
    """
    if simulated.protocol.trials != measured.protocol.trials:
        raise ValueError(
            "the two laxities have different trials. Simulate the protocol of the measured one."
        )
    if measured.zero == "unloaded":
        simulated = relative_to_unloaded(simulated)
    elif simulated.zero == "unloaded":
        raise ValueError(
            "the simulated laxity is relative to the unloaded pose and the measured one is not. "
            "Give the simulated one in absolute coordinates."
        )
    squares = (simulated.coordinates - measured.coordinates) ** 2
    compared = ~np.isnan(squares)
    flexion = np.unique(measured.protocol.flexion_deg)
    rows = [measured.protocol.flexion_deg == angle for angle in flexion]
    return LaxityError(
        mm=_root_mean(squares[:, TRANSLATIONS]),
        deg=_root_mean(squares[:, ROTATIONS]),
        by_coordinate=np.array([_root_mean(column) for column in squares.T]),
        flexion_deg=flexion,
        by_flexion=np.array([[_root_mean(x) for x in squares[row].T] for row in rows]).reshape(
            len(rows), len(COORDINATES)
        ),
        n_compared=int(compared.sum()),
        n_missing=int((measured.is_measured & ~simulated.is_measured).sum()),
    )


def _root_mean(squares: Array) -> float:
    values = squares[~np.isnan(squares)]
    return float(np.sqrt(values.mean())) if values.size else float("nan")
