"""Time of the first simulation of a subject with as many triangles as segmentation gives."""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

from fresh_process import run_fresh
from large_inputs import write_fine_knee
from requirement_rows import Measure, Row

CODE = """
import json, resource, sys, time
from identknee.cli.main import main
sys.argv = ["identknee", "simulate", "{folder}", "--out", "{out}"]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps({{"GB": peak * 1024 / 1e9, "processor": time.process_time()}}))
"""
KNEE = "lenhart2015_stable"
# How often each triangle is cut into four, and the most seconds.
CASES = ((2, 15.0), (3, 50.0))


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """Reading, checks, distance field and 63 trials; what was compiled before stays compiled."""
    measures: list[Measure] = []
    with tempfile.TemporaryDirectory() as cache:
        # Compiles, on the knee as it is.
        run_fresh(CODE.format(folder=KNEE, out=Path(cache, "out")), Path(cache))
        for times, seconds in CASES:
            with tempfile.TemporaryDirectory() as folder:
                n = write_fine_knee(KNEE, times, Path(folder))
                code = CODE.format(folder=folder, out=Path(folder, "out"))
                found, took = run_fresh(code, Path(cache))
            measures += [
                Measure(what=f"{n:,} triangles, first simulate", value=took, unit="s", bar=seconds),
                Measure(
                    what=f"{n:,} triangles, processor time", value=found["processor"], unit="s"
                ),
                Measure(what=f"{n:,} triangles, peak", value=found["GB"], unit="GB"),
            ]
            yield Row(
                line="first simulate of a subject of 614,000 triangles <= 15 s, of 2.5 million "
                "<= 50 s",
                measures=measures,
                notes=[f"surfaces of {KNEE}, each triangle cut into four 2 and 3 times, wavy"],
            )
