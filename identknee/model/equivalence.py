"""Criteria of equivalence of parameter sets, and the trials in which forces are compared."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import COORDINATES
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array, IntArray

# The paper: "the kinematic error remained below 1 mm and 1.2 deg for all conditions", the
# root-mean-square difference over the trials of a flexion angle.
PAPER_LIMITS: Mapping[str, float] = MappingProxyType(
    {"anterior_drawer_mm": 1.0, "varus_deg": 1.2, "internal_deg": 1.2}
)


def rms_blocks(
    residuals: LaxityResiduals, limits: Mapping[str, float] = PAPER_LIMITS
) -> dict[str, Array]:
    """Weights of residuals by flexion angle and coordinate, shape ``(m,)`` each.

    The weighted sum of squares of a block is the mean square of a coordinate's residuals over the
    trials at a flexion angle, in units of its limit squared: a block of value 1 has a
    root-mean-square at its limit. Names read ``"internal_deg@30"``.

    Parameters
    ----------
    residuals
        Unit-weighted, so that they are in mm and deg.
    limits
        Largest root-mean-square by coordinate [mm, deg]; coordinates not named are free.

    Raises
    ------
    ValueError
        If the residuals are weighted by noise, a limit is not greater than 0, or no coordinate
        with a limit was measured.
    """
    if residuals.weighting != "unit":
        raise ValueError('a limit in mm and deg needs residuals with weighting="unit"')
    for name, limit in limits.items():
        if name not in COORDINATES or not 0 < limit < np.inf:
            raise ValueError(
                f"the limit of {name} is {limit:g}: limits are greater than 0 and belong to "
                f"{', '.join(COORDINATES)}"
            )
    laxity = residuals.laxity
    trial, coordinate = np.nonzero(laxity.is_measured)
    flexion = laxity.protocol.flexion_deg[trial]
    blocks = {}
    for angle in np.unique(flexion):
        for name, limit in limits.items():
            rows = (flexion == angle) & (coordinate == COORDINATES.index(name))
            if rows.any():
                weight = 1.0 / (limit * np.sqrt(rows.sum()))
                blocks[f"{name}@{angle:g}"] = np.where(rows, weight, 0.0)
    if not blocks:
        raise ValueError(
            f"none of {', '.join(limits)} was measured, so that nothing limits the difference; "
            "use the noise criterion"
        )
    return blocks


def largest_loads(protocol: Protocol) -> IntArray:
    """Which trials have the largest load of their kind at their flexion angle, in their order.

    Two loads are of a kind where the same of them push the same way.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> protocol = load_protocol("seed63")
    >>> [protocol.trials[i] for i in largest_loads(protocol)][:2]
    ['flexion0_varus-10Nm', 'flexion0_unloaded']
    """
    largest: dict[tuple[float, ...], int] = {}
    sizes = np.abs(protocol.loads).sum(axis=1)
    for i in range(protocol.n):
        kind = (float(protocol.flexion_deg[i]), *np.sign(protocol.loads[i]).tolist())
        if kind not in largest or sizes[i] > sizes[largest[kind]]:
            largest[kind] = i
    return np.sort(list(largest.values()))
