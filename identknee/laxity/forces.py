"""Forces measured in trials beside the pose: of ligaments, groups and compartments."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared

_COLUMN = re.compile(r"(?P<ligament>.+)_tension_N|contact_(?P<side>medial|lateral)_N")
SD = "sd_"
# The reading of a slack ligament scatters around 0. Below minus this many standard deviations it is
# not noise.
MOST_BELOW_ZERO = 4.0


@declared
class MeasuredForces:
    """Forces in the n trials of a table, each with a standard deviation.

    Raises
    ------
    ValueError
        If a force has no standard deviation above 0, or is further below zero than noise explains.
    """

    names: tuple[str, ...] = array(
        "Name of the predicted quantity, such as `ACL.tension_N`", "force", is_in_arrays=False
    )
    values: Array = array("Forces; NaN where not measured", "trial", "force", unit="N")
    sd: Array = array("Standard deviation of their errors", "trial", "force", unit="N")

    def __post_init__(self) -> None:
        measured = self.is_measured
        sd = self.sd[measured]
        if not (np.isfinite(sd).all() and (sd > 0.0).all()):
            raise ValueError("every measured force needs a standard deviation greater than 0")
        if np.any(is_beyond_noise(self.values[measured], sd)):
            raise ValueError(
                f"a measured force is more than {MOST_BELOW_ZERO:g} standard deviations below 0: "
                "give how hard a structure pulls or presses [N]"
            )

    @property
    def is_measured(self) -> BoolArray:
        """Whether a force has a value, shape ``(n, k)``."""
        return np.isfinite(self.values)

    def select(self, rows: ArrayLike) -> "MeasuredForces":
        """Those of some trials, by their places or a mask."""
        chosen = np.asarray(rows)
        return replace(self, values=self.values[chosen], sd=self.sd[chosen])

    def without(self, lost: BoolArray) -> "MeasuredForces":
        """Those with the trials `lost` (n,) blank."""
        return replace(self, values=np.where(lost[:, None], np.nan, self.values))


def is_beyond_noise(value: ArrayLike, sd: ArrayLike) -> BoolArray:
    """Whether a force is so far below zero that noise of that size does not explain it.

    Examples
    --------
    >>> is_beyond_noise([-3.0, -30.0], 5.0).tolist()
    [False, True]
    """
    return np.asarray(np.asarray(value) < -MOST_BELOW_ZERO * np.asarray(sd))


def quantity_of(column: str) -> str:
    """The quantity that a column of forces holds; empty for another column.

    Examples
    --------
    >>> quantity_of("ACL_tension_N"), quantity_of("contact_medial_N"), quantity_of("varus_deg")
    ('ACL.tension_N', 'contact.medial_N', '')
    """
    found = _COLUMN.fullmatch(column)
    if found is None or column.startswith(SD):
        return ""
    return f"{found['ligament']}.tension_N" if found["ligament"] else f"contact.{found['side']}_N"


def column_of(quantity: str) -> str:
    """The column that holds a quantity.

    Examples
    --------
    >>> column_of("ACL.tension_N"), column_of("contact.medial_N")
    ('ACL_tension_N', 'contact_medial_N')
    """
    return quantity.replace(".", "_")


def force_columns(columns: Iterable[str]) -> tuple[str, ...]:
    """Those of forces among the columns of a table."""
    return tuple(x for x in columns if quantity_of(x))


def joined_forces(
    forces: Sequence[MeasuredForces | None], sizes: Sequence[int]
) -> MeasuredForces | None:
    """The forces of several tables of so many trials each, one after the other."""
    names = tuple(dict.fromkeys(name for x in forces if x is not None for name in x.names))
    if not names:
        return None
    values, sd = (np.full((sum(sizes), len(names)), np.nan) for _ in range(2))
    first = 0
    for x, n in zip(forces, sizes, strict=True):
        if x is not None:
            columns = [names.index(name) for name in x.names]
            values[first : first + n, columns], sd[first : first + n, columns] = x.values, x.sd
        first += n
    return MeasuredForces(names=names, values=values, sd=sd)
