"""How far a simulated laxity is from a measured one."""

from dataclasses import replace

import numpy as np

from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.laxity.zero_conventions import ABSOLUTE, UNLOADED, from_zero, unloaded_trials
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_COORDINATE, array, declared, entry


def relative_to_unloaded(laxity: Laxity) -> Laxity:
    """The same laxity as changes from the unloaded pose of each flexion angle.

    Replicates of the unloaded trial are averaged over those that measured the coordinate; where
    none did, the change is not measured either. A standard deviation of a loaded trial becomes that
    of the difference; unloaded trials keep their own. Laxity that is relative already is returned
    as it is.

    Raises
    ------
    ValueError
        If a flexion angle has no unloaded trial.
    """
    if laxity.zero == "unloaded":
        return laxity
    measured = laxity.is_measured
    zeros = np.empty(laxity.coordinates.shape)
    variances = np.empty(laxity.coordinates.shape)
    filled = np.where(measured, laxity.coordinates, 0.0)
    squares = np.zeros_like(filled) if laxity.sd is None else np.where(measured, laxity.sd**2, 0.0)
    for row, unloaded in enumerate(unloaded_trials(laxity.protocol)):
        count = measured[unloaded].sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            zeros[row] = filled[unloaded].sum(axis=0) / count
            variances[row] = squares[unloaded].sum(axis=0) / count**2
    sd = laxity.sd
    if sd is not None:
        added = np.where(laxity.protocol.is_unloaded[:, None] | np.isnan(variances), 0.0, variances)
        sd = np.sqrt(sd**2 + added)
    return replace(laxity, coordinates=laxity.coordinates - zeros, sd=sd, zero="unloaded")


@declared
class LaxityError:
    """Root-mean-square differences of two laxities; NaN where nothing was compared."""

    mm: float = entry("Error of the three translations", unit="mm")
    deg: float = entry("Error of varus and internal rotation", unit="deg")
    by_coordinate: Array = array(
        "Error of each coordinate", "coordinate", unit=OF_COORDINATE, group="errors"
    )
    flexion_deg: Array = array("Flexion angles, ascending", "flexion", unit="deg", group="errors")
    by_flexion: Array = array(
        "Error at each flexion angle",
        *("flexion", "coordinate"),
        unit=OF_COORDINATE,
        group="errors",
    )
    n_compared: int = entry("Measured values with a prediction", unit="1")
    n_missing: int = entry(
        "Measured values without one; they are left out, which makes the errors too good", unit="1"
    )


def laxity_rmse(simulated: Laxity, measured: Laxity) -> LaxityError:
    """Root-mean-square difference over all that was measured.

    Where only `measured` counts from poses of its own, `simulated` is made so first.

    Raises
    ------
    ValueError
        If the trials differ, or `simulated` counts from other poses than `measured`.
    """
    if simulated.protocol.trials != measured.protocol.trials:
        raise ValueError(
            "the two laxities have different trials. Simulate the protocol of the measured one."
        )
    if simulated.zero not in (ABSOLUTE, measured.zero):
        raise ValueError(
            f"the simulated laxity has the zero {simulated.zero} and the measured one "
            f"{measured.zero}. Give the simulated one in absolute coordinates."
        )
    shown = simulated.coordinates
    if measured.zero == UNLOADED:
        shown = relative_to_unloaded(simulated).coordinates
    elif simulated.zero == ABSOLUTE:
        shown = from_zero(shown, simulated.protocol, measured.zero)
    squares = (shown - measured.coordinates) ** 2
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
        n_missing=int((measured.is_measured & np.isnan(shown)).sum()),
    )


def _root_mean(squares: Array) -> float:
    values = squares[~np.isnan(squares)]
    return float(np.sqrt(values.mean())) if values.size else float("nan")
