"""Coordinates as changes from the unloaded pose of the same flexion angle."""

from dataclasses import replace

import numpy as np

from identknee.laxity.table import Laxity
from identknee.laxity.zeros import unloaded_trials


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
