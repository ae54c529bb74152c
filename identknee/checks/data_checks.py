"""Checks of a laxity table as a whole: loads, frames, and motion against the load."""

import numpy as np

from identknee.laxity.protocol import LOADS, dominant_loads, opposite_pairs
from identknee.laxity.table import COORDINATES, Laxity
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.model.laxity_model import LaxityModel
from identknee.runs.findings import Finding, finding

# Share of its length in the scan below which a ligament is too short in half of the trials; one may
# be, as the posterior capsule in deep flexion, and not half of all.
SHORT = 0.75
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


def load_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """That no trial has a load, as where the columns of loads were left out."""
    return () if laxity.protocol.loads.any() else (finding("no-loads", "data"),)


def frame_findings(model: LaxityModel) -> tuple[Finding, ...]:
    """That the measured poses put the insertions of half the ligaments far too close together."""
    ligaments = model.knee.ligaments
    setting = model.setting(model.parameters.start)
    if setting.measured is None:
        return ()
    places, lines = zip(setting.flexion.tolist(), setting.measured, strict=True), setting.lines
    lengths = np.array([line_lengths(lines, angle, pose) for angle, pose in places])
    usual = (np.median(lengths, axis=0) / lines.reference_length)[: len(ligaments)]
    n_short = int(np.count_nonzero(usual < SHORT))
    if 2 * n_short < len(ligaments):
        return ()
    worst = int(np.argmin(usual))
    values = {
        "n_short": n_short,
        "n_ligaments": len(ligaments),
        "shortest": ligaments[worst].name,
        "length_in_scan_pct": 100.0 * usual[worst],
    }
    sentence = (
        "The coordinates are not those of this subject's frames: in half of the measured poses "
        f"{n_short} of {len(ligaments)} ligaments have less than {100 * SHORT:.0f} % of their "
        f"length in the scan ({ligaments[worst].name} {100 * usual[worst]:.0f} %). If they are "
        "changes from a pose of the knee, say from which in a line of the table: # zero: unloaded, "
        "# zero: opposite, or # zero: and the name of a trial."
    )
    return (finding("coordinates-of-other-frames", "data", values, sentence=sentence),)


def load_sign_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """The columns in which opposite loads move the tibia the wrong way, from the table alone.

    A load moves the tibia its own way wherever equilibrium is stable. Only columns are named in
    which most pairs of opposite loads move it the other way, and by more than any stray load or
    noise explains.
    """
    pairs = opposite_pairs(laxity.protocol)
    axis = dominant_loads(laxity.protocol).axis
    found = []
    for k, (load, coordinate) in enumerate(zip(LOADS, WORKS_ON, strict=True)):
        own = pairs[axis[pairs[:, 0]] == k]
        column = laxity.coordinates[:, COORDINATES.index(coordinate)]
        moved = column[own[:, 0]] - column[own[:, 1]]
        moved = moved[~np.isnan(moved)]
        if moved.size < 2 or np.median(moved) > -LEAST:
            continue
        unit = "deg" if coordinate.endswith("_deg") else "mm"
        values = {
            "coordinate": coordinate,
            "load": load,
            f"fall_{unit}": -np.median(moved),
            "n_pairs": moved.size,
        }
        sentence = (
            f"{coordinate} falls as {load} rises, by {-np.median(moved):.3g} {unit} between "
            f"opposite loads in the middle of {moved.size} pairs of trials; no knee moves against "
            "an applied load. The sign of one of the two columns is flipped, or two columns are "
            "exchanged. Correct the table and repeat the command."
        )
        found.append(finding("moves-against-load", "data", values, sentence=sentence))
    return tuple(found)
