"""Whether the tibia moves against the load that is put on it, which no knee does."""

import numpy as np

from identknee.laxity.dominant import dominant_loads, opposite_pairs
from identknee.laxity.protocol import LOADS
from identknee.laxity.table import COORDINATES, Laxity
from identknee.runs.findings import Finding, Severity

# The coordinate on which each load works.
WORKS_ON = (
    "internal_deg",
    "varus_deg",
    "anterior_drawer_mm",
    "distraction_mm",
    "lateral_shift_mm",
)
# What opposite loads move a knee by at the least for their sign to be beyond doubt [mm, deg].
LEAST = 2.0


def against_load_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """The columns in which opposite loads move the tibia the wrong way, from the table alone.

    A load moves the tibia its own way wherever equilibrium is stable. Only columns are named in
    which most pairs of opposite loads say so, and by more than any stray load or noise explains.
    """
    pairs = opposite_pairs(laxity.protocol)
    axis = dominant_loads(laxity.protocol).axis
    found = []
    for k, (load, coordinate) in enumerate(zip(LOADS, WORKS_ON, strict=True)):
        own = pairs[axis[pairs[:, 0]] == k]
        values = laxity.coordinates[:, COORDINATES.index(coordinate)]
        moved = values[own[:, 0]] - values[own[:, 1]]
        moved = moved[~np.isnan(moved)]
        if moved.size < 2 or np.median(moved) > -LEAST:
            continue
        unit = "deg" if coordinate.endswith("_deg") else "mm"
        sentence = (
            f"{coordinate} falls as {load} rises, by {-np.median(moved):.3g} {unit} between "
            f"opposite loads in the middle of {moved.size} pairs of trials; no knee moves against "
            "its load. The sign of one of the two columns is flipped, or two columns are "
            "exchanged. Correct the table and begin again."
        )
        found.append(Finding(severity=Severity.ERROR, sentence=sentence, where="data"))
    return tuple(found)
