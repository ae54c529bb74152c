"""Whether equal trials of a table differ by more than noise: rows of several states or sessions."""

import numpy as np

from identknee.checks.data_noise import replicates_of
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.runs.arrays import Array
from identknee.runs.findings import Finding, finding

# Times the noise beyond which the scatter of equal trials is reported.
MOST = 4.0
# Assumed noise [mm, deg] where none is stated: more than replicates of any rig have.
LARGE_MM, LARGE_DEG = 1.0, 2.0


def replicates_findings(laxity: Laxity, noise_mm: float | None = None) -> tuple[Finding, ...]:
    """A finding if equal trials are further apart than their noise allows.

    Parameters
    ----------
    laxity
        The data. Trials of one state, experiment and phase are compared.
    noise_mm
        Standard deviation of lengths where one is stated beside the table.
    """
    spread = np.empty(laxity.coordinates.shape)
    spread[:, TRANSLATIONS], spread[:, ROTATIONS] = LARGE_MM, LARGE_DEG
    spread *= max(1.0, (noise_mm or 0.0) / LARGE_MM)
    if laxity.sd is not None:
        spread = np.where(np.isnan(laxity.sd), spread, laxity.sd)
    replicates = replicates_of(laxity)
    group, n_groups = replicates.group, int(replicates.group.max(initial=-1)) + 1
    squares, degrees = np.zeros(n_groups), np.zeros(n_groups)
    for column, used in enumerate(laxity.is_measured.T):
        scaled = laxity.coordinates[:, [column]] / spread[:, [column]]
        np.add.at(squares, group, replicates.deviations(scaled, used)[:, 0] ** 2)
        count = np.bincount(group[used], minlength=n_groups)
        degrees += np.maximum(count - 1, 0)
    is_apart = squares > MOST**2 * np.maximum(degrees, 1.0)
    if not is_apart.any():
        return ()
    rows = np.flatnonzero(group == int(np.argmax(squares / np.maximum(degrees, 1.0))))
    column, (one, other) = _farthest(laxity.coordinates[rows] / spread[rows])
    first, second = rows[one], rows[other]
    off = abs(float(laxity.coordinates[first, column] - laxity.coordinates[second, column]))
    unit = COORDINATES[column].rpartition("_")[2]
    names = [laxity.protocol.trials[i] for i in sorted((first, second))]
    n, total = int(is_apart.sum()), int((degrees > 0).sum())
    sentence = (
        f"Trials under equal loads differ by more than noise explains ({n} of {total} repeats): "
        f"{names[0]} and {names[1]} differ by {off:.2g} {unit}. Several states or knees in one "
        "table need a column state or tables of their own."
    )
    values = {"n_apart": n, "n_repeated": total, "first": names[0], "second": names[1]}
    return (finding("replicates-apart", "data", {**values, f"off_{unit}": off}, sentence=sentence),)


def _farthest(scaled: Array) -> tuple[int, tuple[int, int]]:
    """The column in which some of the rows are farthest apart, and which two."""
    lost = np.isnan(scaled)
    low, high = np.where(lost, np.inf, scaled), np.where(lost, -np.inf, scaled)
    column = int(np.argmax(high.max(axis=0) - low.min(axis=0)))
    return column, (int(low[:, column].argmin()), int(high[:, column].argmax()))
