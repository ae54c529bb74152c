"""Mutated inputs to all readers and verbs: each ends with success or a sentence."""

import argparse
import sys
from collections import Counter
from pathlib import Path

from requirement_rows import Measure, Row

sys.path.append(str(Path(__file__).parents[1] / "fuzz"))

from fuzz_judge import SLOWEST_S
from fuzz_targets import TARGETS
from run_fuzz import tallied

INPUTS, SEED = 20_000, 1


def measure(options: argparse.Namespace) -> Row:
    """How many of the inputs ended in a traceback, a raw warning, half a folder or too late."""
    tallies = {x.name: tallied(x, INPUTS, SEED) for x in TARGETS}
    total = sum((x.counts for x in tallies.values()), Counter[str]())
    slowest = max(tallies, key=lambda x: tallies[x].slowest_s)
    failures = [
        f"{name}: {n} x {why}" for name, x in tallies.items() for why, n in x.failures.items()
    ]
    return Row(
        line="mutated inputs to all readers and verbs: none ends in a traceback, a raw warning, a "
        "half-written folder or after more than 60 s",
        measures=[
            Measure(what="inputs", value=sum(total.values()), unit="", bar=INPUTS, at_least=True),
            Measure(what="inputs that ended badly", value=total["failed"], unit="", bar=0),
            Measure(
                what=f"slowest, {slowest}",
                value=tallies[slowest].slowest_s,
                unit="s",
                bar=SLOWEST_S,
            ),
        ],
        notes=[
            f"seed {SEED}; {total['refused']} refused with a sentence, {total['done']} done",
            *(
                f"{name}: {sum(x.counts.values())} inputs, {x.counts['refused']} refused"
                for name, x in tallies.items()
            ),
            *failures,
        ],
    )
