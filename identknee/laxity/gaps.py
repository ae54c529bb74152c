"""Numbers of a laxity table that stand for missing values, such as -99 or a row of zeros."""

from collections.abc import Iterator, Sequence

import numpy as np

from identknee.laxity.protocol import LOADS, Protocol, dominant_loads
from identknee.laxity.spreadsheets import is_code
from identknee.runs.declare import Array, BoolArray
from identknee.runs.findings import Finding, finding
from identknee.runs.words import listed_first

# Times the size of all other values of a column from which a code is one of no knee.
BEYOND = 2.0
# Fewest values beside a code, or loaded trials beside one of zeros, with which it is compared.
LEAST = 3
# Probability below which zeros under load did not come about by rounding.
IMPROBABLE = 1e-3
MOST_LISTED = 3
# Most decimals that are looked for, and how far a rounded number may be off in its last one.
MOST_DECIMALS, ROUNDED = 6, 1e-3


def gap_findings(
    protocol: Protocol, coordinates: Array, zero: str, along: Sequence[int]
) -> tuple[Finding, ...]:
    """A finding for each number that is taken for a measured value and hardly is one.

    Codes such as -99 are named where they are far from all other values of their column. Zeros are
    named in trials under load, if rounding would hardly make them: where all coordinates are
    exactly zero, or the one along which the load acts. A compressed knee may be the zero of a
    table, and a rig may hold a coordinate across the load: neither is named.

    Parameters
    ----------
    protocol
        The trials.
    coordinates
        As the table has them, NaN where blank, shape ``(n, 5)``.
    zero
        What they are counted from, as in `identknee.Laxity`.
    along
        Place of the coordinate along which each of `LOADS` acts.
    """
    found = []
    for number, cells in (*_codes(coordinates), *_zeros(protocol, coordinates, zero, along)):
        trials = tuple(protocol.trials[i] for i in np.flatnonzero(cells.any(axis=1)))
        n, where = int(cells.sum()), listed_first(trials, MOST_LISTED)
        counted = ""
        if number == 0.0:
            hold = "coordinate is" if n == 1 else "coordinates are"
            sentence = f"{n} {hold} exactly 0 under load, as rounding hardly makes them: {where}. "
            is_still = (cells | np.isnan(coordinates)).all(axis=1) & cells.any(axis=1)
            if is_still.any():
                trial = protocol.trials[int(np.argmax(is_still))]
                counted = f"; if others are counted from {trial}, say so: # zero: {trial}"
        else:
            hold = "cell holds" if n == 1 else "cells hold"
            sentence = f"{n} {hold} {number:g}, far from all others of the column: {where}. "
        sentence += f"If nothing was measured, leave the cells blank{counted}."
        values = {"number": number, "n": n, "trials": trials}
        found.append(finding("gap-as-number", "data", values, sentence=sentence))
    return tuple(found)


def _codes(coordinates: Array) -> Iterator[tuple[float, BoolArray]]:
    """Codes of a missing value, each with its cells."""
    for number in filter(is_code, np.unique(coordinates[~np.isnan(coordinates)]).tolist()):
        cells = coordinates == number
        for column, own in zip(coordinates.T, cells.T, strict=True):
            others = np.abs(column[~np.isnan(column) & ~own])
            if (
                BEYOND * others.max(initial=0.0) > abs(number)
                or max(others.size, own.sum()) < LEAST
            ):
                own[:] = False
        if cells.any():
            yield number, cells


def _zeros(
    protocol: Protocol, coordinates: Array, zero: str, along: Sequence[int]
) -> Iterator[tuple[float, BoolArray]]:
    """Zero, with its cells in loaded trials that rounding hardly explains."""
    is_zero, measured = coordinates == 0.0, ~np.isnan(coordinates)
    axis = dominant_loads(protocol).axis
    loaded = (axis >= 0) & (axis != LOADS.index("distraction_force_N"))
    loaded &= np.array([x != zero for x in protocol.trials])
    cells = np.zeros(coordinates.shape, bool)
    for load in np.unique(axis[loaded]).tolist():
        k, own = along[load], loaded & (axis == load)
        others = coordinates[own & measured[:, k] & ~is_zero[:, k], k]
        if len(others) >= LEAST and own.sum() * _share_of_zero(others) < IMPROBABLE:
            cells[:, k] |= own & is_zero[:, k]
    # A coordinate that never moves says nothing.
    moves = measured & (measured & ~is_zero).any(axis=0)
    still = loaded & moves.any(axis=1) & ~(moves & ~is_zero).any(axis=1)
    usual = moves[loaded & ~still]
    if len(usual) >= LEAST:
        share = (is_zero[loaded & ~still][usual].sum() + 1.0) / (usual.sum() + 2.0)
        still &= loaded.sum() * share ** moves.sum(axis=1) < IMPROBABLE
        cells |= still[:, None] & moves
    if cells.any():
        yield 0.0, cells


def _share_of_zero(values: Array) -> float:
    """How often one of such values would be exactly zero: their last decimal over their spread."""
    steps = 10.0 ** -np.arange(MOST_DECIMALS + 1.0)
    whole = values / steps[:, None]
    is_rounded = np.all(np.abs(whole - np.round(whole)) < ROUNDED, axis=1)
    step = steps[int(np.argmax(is_rounded))] if is_rounded.any() else steps[-1]
    return float(step / max(np.std(values), step))
