"""What is wrong with a table as a whole: no loads, or poses that are not this subject's."""

import numpy as np

from identknee.laxity.table import Laxity
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.model.laxity_model import LaxityModel
from identknee.runs.findings import Finding, Severity

# Share of its length in the scan below which a ligament is too short in half of the trials; one may
# be, as the posterior capsule in deep flexion, and not half of all.
SHORT = 0.75


def load_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """That no trial has a load, as where the columns of loads were left out."""
    if laxity.protocol.loads.any():
        return ()
    sentence = (
        "No trial of the table has a load, so it says next to nothing about ligaments. Check that "
        "the columns of loads are there."
    )
    return (Finding(severity=Severity.WARNING, sentence=sentence, where="data"),)


def pose_findings(model: LaxityModel) -> tuple[Finding, ...]:
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
    sentence = (
        "The coordinates are not those of this subject's frames: in half of the measured poses "
        f"{n_short} of {len(ligaments)} ligaments have less than {100 * SHORT:.0f} % of their "
        f"length in the scan ({ligaments[worst].name} {100 * usual[worst]:.0f} %). If they are "
        "changes from a pose of the knee, say from which in a line of the table: # zero: unloaded, "
        "# zero: opposite, or # zero: and the name of a trial."
    )
    return (Finding(severity=Severity.ERROR, sentence=sentence, where="data"),)
