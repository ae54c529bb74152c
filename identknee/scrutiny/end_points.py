"""Trials that do not go with the others in the table alone, where no model has a prediction."""

import numpy as np
from scipy.linalg import block_diag

from identknee.laxity.dominant import dominant_loads
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.runs.arrays import Array, IntArray
from identknee.scrutiny.suspicious_rows import SuspiciousRow, left_out, suspicious_rows

# Of a direction of load, fewer trials say nothing of how coordinates change with flexion.
LEAST_TRIALS = 4
# How often a table may be accused for which the courses are right; they are nearly so, not quite.
LEVEL = 1e-4
# Loads of one direction may differ by this share of them and still be one end point.
ALIKE = 0.25


def suspicious_end_points(laxity: Laxity) -> list[SuspiciousRow]:
    """Trials off the course over flexion that others of their load and all others have.

    Every coordinate is a straight line over flexion for each direction of load, bent alike for all
    directions. This is for tables with one load a direction, such as end points of a robot; of
    others nothing is said.
    """
    rows, design = _courses(laxity.protocol)
    values = laxity.coordinates[rows]
    measured = ~np.isnan(values)
    parts = [(values[use, j], design[use]) for j, use in enumerate(measured.T) if use.any()]
    if not rows.size or any(len(x) <= X.shape[1] for x, X in parts):
        return []
    scales = [_scale(x, X) for x, X in parts]
    spread = np.concatenate([np.full(len(x), s) for (x, _), s in zip(parts, scales, strict=True)])
    fit = left_out(
        np.concatenate([x for x, _ in parts]) / spread,
        block_diag(*[X for _, X in parts]) / spread[:, None],
        np.diag(1.0 / spread),
    )
    coordinates, places = np.nonzero(measured.T)
    return suspicious_rows(fit, rows[places], coordinates, level=LEVEL)


def _courses(protocol: Protocol) -> tuple[IntArray, Array]:
    """The trials that can be compared, and the course over flexion that each is on."""
    found = dominant_loads(protocol)
    group = np.where(found.axis < 0, 0, np.sign(found.size) * (found.axis + 1)).astype(int)
    usable = [x for x in np.unique(group) if np.count_nonzero(group == x) >= LEAST_TRIALS]
    for direction in usable:
        size = np.abs(found.size[group == direction])
        if size.min() < (1.0 - ALIKE) * size.max():
            return np.zeros(0, dtype=np.int64), np.zeros((0, 0))
    rows = np.flatnonzero(np.isin(group, usable))
    turn = (protocol.flexion_deg[rows] - 45.0) / 45.0
    own = (group[rows, None] == np.array(usable, dtype=int)).astype(float)
    return rows, np.hstack([own, own * turn[:, None], turn[:, None] ** 2])


def _scale(values: Array, design: Array) -> float:
    """Spread of what the courses leave, which one trial that is off cannot widen much."""
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    free = np.sqrt(len(values) / (len(values) - np.linalg.matrix_rank(design)))
    return max(float(1.4826 * np.median(np.abs(left)) * free), 1e-6)
