"""The noise that trials under equal loads show, whatever a model says of them."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from identknee.diagnosis.noise_model import (
    LEAST_CORRELATION,
    LEAST_DEGREES,
    MOST_CORRELATION,
    EstimatedScale,
)
from identknee.laxity.table import Laxity
from identknee.runs.arrays import Array, BoolArray, IntArray, frozen_integers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replicates:
    """Trials of one flexion angle, equal loads and one phase of loading.

    Attributes
    ----------
    group
        Number of the set of equal trials that each belongs to, shape ``(n,)``.
    is_measured
        Which values there are, shape ``(n, 5)``.
    """

    group: IntArray
    is_measured: BoolArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "group", frozen_integers(self.group))

    def deviations(self, values: Array, used: BoolArray) -> Array:
        """`values` (n, k) of the trials `used` (n,) less the mean of their set; 0 for others.

        A model predicts the same for all trials of a set, so that nothing of it is in them.
        """
        known = np.where(used[:, None], values, 0.0)
        n_groups = int(self.group.max()) + 1
        sums = np.zeros((n_groups, known.shape[1]))
        np.add.at(sums, self.group, known)
        count = np.bincount(self.group[used], minlength=n_groups)
        means = sums / np.maximum(count, 1)[:, None]
        return np.where(used[:, None], known - means[self.group], 0.0)

    def degrees(self, used: BoolArray) -> int:
        """Degrees of freedom of the deviations in one column."""
        return int(used.sum()) - len(np.unique(self.group[used]))


def replicates_of(laxity: Laxity) -> Replicates:
    """Which trials of the data are equal."""
    protocol = laxity.protocol
    _, phase = np.unique(laxity.phase or ("",) * laxity.n, return_inverse=True)
    settings = np.column_stack([protocol.flexion_deg, protocol.loads, phase])
    group = np.unique(settings, axis=0, return_inverse=True)[1]
    return Replicates(group=group.ravel(), is_measured=laxity.is_measured)


def scale_of_replicates(
    replicates: Replicates, values: Array, columns: slice
) -> EstimatedScale | None:
    """The common noise of some columns, pure error; None where too few trials are equal.

    Parameters
    ----------
    replicates
        Which trials are equal.
    values
        Measured less predicted, or the measured values, in units of their noise up to one common
        factor, shape ``(n, 5)``.
    columns
        Which of them.
    """
    squares, degrees = 0.0, 0
    for column in range(values.shape[1])[columns]:
        used = replicates.is_measured[:, column]
        squares += float((replicates.deviations(values[:, [column]], used) ** 2).sum())
        degrees += replicates.degrees(used)
    if degrees < LEAST_DEGREES:
        return None
    return EstimatedScale(sd=float(np.sqrt(squares / degrees)), degrees_of_freedom=float(degrees))


def correlation_of_replicates(replicates: Replicates, values: Array) -> float | None:
    """The correlation that the errors of a trial share; None where too few trials are equal.

    Parameters
    ----------
    replicates, values
        As in `scale_of_replicates`.
    """
    found = []
    for pair in combinations(range(values.shape[1]), 2):
        used = np.asarray(replicates.is_measured[:, pair].all(axis=1))
        if replicates.degrees(used) < LEAST_DEGREES:
            continue
        left = replicates.deviations(values[:, pair], used)
        products = left.T @ left
        size = np.sqrt(products[0, 0] * products[1, 1])
        if size > 0:
            found.append(products[0, 1] / size)
    return float(np.clip(np.mean(found), LEAST_CORRELATION, MOST_CORRELATION)) if found else None
