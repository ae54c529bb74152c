"""What the coordinates of a table are counted from."""

import numpy as np

from identknee.laxity.dominant_load import opposite_pairs
from identknee.laxity.protocol import Protocol
from identknee.runs.arrays import Array, IntArray

SAME_ANGLE_DEG = 0.5
"""Trials whose flexion angles differ by no more [deg] share their unloaded pose: a rig set to 30
seldom reads 30.0."""
ABSOLUTE, UNLOADED, OPPOSITE = "absolute", "unloaded", "opposite"
ZEROS = (ABSOLUTE, UNLOADED, OPPOSITE)


def from_zero(values: Array, protocol: Protocol, zero: str) -> Array:
    """`values` less their mean over the trials that they are counted from.

    Parameters
    ----------
    values
        Anything with a row a trial, shape ``(n, ...)``: coordinates, or their Jacobian.
    protocol
        The trials.
    zero
        ``"absolute"``, ``"unloaded"``, ``"opposite"`` or the name of a trial.

    Raises
    ------
    ValueError
        If a trial that others are counted from is missing.
    """
    if zero == ABSOLUTE:
        return values
    zeros = [values[rows].mean(axis=0) for rows in zero_trials(protocol, zero)]
    return np.asarray(values - np.array(zeros).reshape(values.shape), dtype=np.float64)


def zero_trials(protocol: Protocol, zero: str) -> tuple[IntArray, ...]:
    """Indices of the reference trials of each trial, one array per trial.

    A trial without an opposite one is counted from itself: its change says nothing.

    Raises
    ------
    ValueError
        If a flexion angle has no unloaded trial, or no trial is called so.
    """
    if zero == UNLOADED:
        return unloaded_trials(protocol)
    if zero == OPPOSITE:
        from_which = np.arange(protocol.n)
        for pair in opposite_pairs(protocol):
            from_which[pair] = pair[::-1]
        return tuple(from_which[:, None])
    if zero not in protocol.trials:
        raise ValueError(
            f"no trial of {protocol.name!r} is called {zero}, from which the others are counted. "
            "Keep it in the table."
        )
    return tuple(np.full((protocol.n, 1), protocol.trials.index(zero)))


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


def zero_of_added_trials(zero: str) -> str:
    """What trials to be added to a table are counted from: where it is not absolute, unloaded."""
    return ABSOLUTE if zero == ABSOLUTE else UNLOADED


def zero_fault(zero: str, protocol: Protocol, coordinates: Array) -> tuple[str, str] | None:
    """Why coordinates cannot be counted from there, and the remedy; None if they can.

    Parameters
    ----------
    zero
        As in `from_zero`.
    protocol, coordinates
        The trials, and their coordinates, NaN where not measured, shape ``(n, 5)``.
    """
    measured = ~np.isnan(coordinates)
    if zero == OPPOSITE:
        pairs = opposite_pairs(protocol)
        alone = np.array(measured.any(axis=1))
        alone[pairs.ravel()] = False
        if alone.any():
            trial = protocol.trials[int(np.argmax(alone))]
            return (
                f"{trial} has coordinates, and no trial at its flexion angle has the opposite load",
                "Add that trial with blank cells, or leave the cells of this one blank",
            )
        twice = [pair for pair in pairs.tolist() if measured[pair].all(axis=0).any()]
        if twice:
            first, second = (protocol.trials[i] for i in twice[0])
            why = f"{first} and {second} both have coordinates, which would count their difference"
            remedy = "Give it in the row of one of them, and leave the cells of the other blank"
            return f"{why} twice", remedy
        return None
    if zero in ZEROS:
        return None
    if zero not in protocol.trials:
        return (
            f"the zero {zero!r} is unknown and no trial",
            "Write unloaded, opposite or the name of a trial, or leave the line out",
        )
    own = coordinates[protocol.trials.index(zero)]
    if np.any(own[~np.isnan(own)] != 0.0):
        return (
            f"{zero} is the zero of the table and has coordinates other than 0",
            "Leave its cells blank",
        )
    return None
