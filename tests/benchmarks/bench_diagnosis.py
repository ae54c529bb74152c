"""Seconds that a diagnosis of 63 trials takes with the whole library."""

import argparse
import time

from knees import knee
from requirement_rows import Measure, Row, median_of

from identknee.blind.case import blind_case
from identknee.diagnosis.investigation import investigate
from identknee.runs.executors import one_library_thread

MOST_S, LONGEST_S = 3.0, 8.0
# Every third effect of the library, drawn with seeds of their own, and nothing.
CASES = (
    (),
    ("anterolateral",),
    ("posterior_capsule",),
    ("meniscus",),
    ("compression",),
    ("moment_gain_IE",),
    ("axis_misalignment",),
    ("tibia_frame",),
    ("rig_compliance_VV",),
    ("bundles",),
)
SIGNAL, FIRST_SEED = 10.0, 160_000


def measure(options: argparse.Namespace) -> Row:
    """The time of each case in one process, as in `diagnose`, without compiling."""
    subject = knee("reference")
    seconds, notes = [], []
    for i, effects in enumerate(CASES):
        signal = SIGNAL if effects else None
        case = blind_case(subject, seed=FIRST_SEED + i, effect=effects or None, signal=signal)
        began = time.perf_counter()
        with one_library_thread():
            found = investigate(subject, case.laxity)
        seconds.append(time.perf_counter() - began)
        verdict = "NOT_TESTABLE" if found is None else found.conclusion.verdict.value
        notes.append(f"{' and '.join(effects) or 'nothing'}: {verdict}, {seconds[-1]:.1f} s")
    longest = Measure(
        what="longest diagnosis", value=max(seconds), unit="s", bar=LONGEST_S, count=len(seconds)
    )
    typical = median_of("diagnosis of a blind case, signal 10", seconds, "s", bar=MOST_S)
    return Row(
        line="one diagnosis, 63 trials, full library, one core: median <= 3 s, longest <= 8 s",
        measures=[typical, longest],
        notes=notes,
    )
