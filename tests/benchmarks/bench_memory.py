"""Peak memory of a process that fits a knee."""

import argparse

from fresh_process import run_fresh
from requirement_rows import Row, median_of

REPEATS = 3
# Linux counts the peak in kB of 1024 bytes.
FIT = """
import json, resource
from knees import model, noise_free
from identknee.calibrate.fit import fit
from identknee.calibrate.fit import named_start
subject = model("{knee}")
problem = noise_free(subject)
fit(problem, named_start("IG4", subject.parameters), method="{method}")
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps({{"GB": peak * 1024 / 1e9}}))
"""


def measure(options: argparse.Namespace) -> Row:
    """Of the process as a whole, interpreter and libraries included."""
    measures = []
    for knee in ("reference", "lenhart2015_stable"):
        for method in ("complex", "least-squares"):
            code = FIT.format(knee=knee, method=method)
            peaks = [run_fresh(code)[0]["GB"] for _ in range(REPEATS)]
            measures.append(median_of(f"{knee}, {method} from IG4", peaks, "GB", bar=1.0))
    return Row(line="memory of a fit <= 1 GB", measures=measures)
