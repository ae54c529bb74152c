"""Time a trial against the same equilibria solved with trimesh's queries and scipy's root."""

import argparse
import sys

from beside_peer import agreement, compared, peer_record
from requirement_rows import Row

BAR = 20_000.0
TRIALS = 3
FLEXION_DEG = 0.0


def measure(options: argparse.Namespace) -> Row:
    """The peer first, ours directly after it."""
    record = peer_record(sys.executable, "peer_trimesh.py", "--trials", str(TRIALS))
    return Row(
        line="against the same equilibria solved with trimesh queries + scipy root (3 trials): "
        ">= 20,000 times",
        measures=compared(record, FLEXION_DEG, BAR),
        notes=[agreement(record, FLEXION_DEG)],
    )
