"""Coordinates as changes from the unloaded pose of the same flexion angle."""

from dataclasses import replace

import numpy as np

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.runs.arrays import Array, IntArray

SAME_ANGLE_DEG = 0.5
"""Trials whose flexion angles differ by no more [deg] share their unloaded pose: a rig set to 30
seldom reads 30.0."""


def unloaded_trials(protocol: Protocol) -> tuple[IntArray, ...]:
    """Indices of the unloaded trials at the flexion angle of each trial, one array a trial.

    Raises
    ------
    ValueError
        If a flexion angle has no unloaded trial.
    """
    unloaded = np.flatnonzero(protocol.is_unloaded)
    found = []
    for flexion in protocol.flexion_deg:
        near = np.abs(protocol.flexion_deg[unloaded] - flexion) <= SAME_ANGLE_DEG
        if not near.any():
            raise ValueError(
                f"no trial of {protocol.name!r} is unloaded at {flexion:g} deg flexion. "
                "Add one with all loads zero at that angle."
            )
        found.append(unloaded[near].astype(np.int64))
    return tuple(found)


def from_unloaded(values: Array, protocol: Protocol) -> Array:
    """`values` less their mean over the unloaded trials of the same flexion angle.

    Parameters
    ----------
    values
        Anything with a row a trial, shape ``(n, ...)``: coordinates, or their Jacobian.
    protocol
        The trials.

    Raises
    ------
    ValueError
        If a flexion angle has no unloaded trial.
    """
    zeros = [values[rows].mean(axis=0) for rows in unloaded_trials(protocol)]
    return np.asarray(values - np.array(zeros).reshape(values.shape), dtype=np.float64)


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
