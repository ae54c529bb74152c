"""Time a trial against OpenSim's elastic foundation, on the trials that OpenSim solves."""

import argparse

from beside_peer import agreement, compared, peer_record
from rows import Row

BAR = 50_000.0
FLEXION_DEG = 0.0


def measure(options: argparse.Namespace) -> Row:
    """The peer first, ours directly after it."""
    record = peer_record(options.opensim_python, "peer_opensim.py")
    return Row(
        line="against OpenSim 4.6 (PyPI, ElasticFoundationForce, medium mesh, side by side in one "
        "run): >= 50,000 times faster on the trials at 0 deg that OpenSim solves; its failures at "
        "30 and 60 deg are counted",
        measures=compared(record, FLEXION_DEG, BAR),
        notes=[agreement(record, FLEXION_DEG)],
    )
