"""Time and memory of a fit and a diagnosis of thousands of trials."""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

from fresh_process import run_fresh
from large_inputs import large_table
from requirement_rows import Measure, Row

from identknee.laxity.table import write_laxity

SEED = 1
# Linux counts the peak in kB of 1024 bytes.
CODE = """
import json, resource, sys
from identknee.cli.main import main
sys.argv = ["identknee", "{verb}", "reference", "{table}", "--out", "{out}"]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps({{"GB": peak * 1024 / 1e9}}))
"""
# Verb, trials, and the most seconds and GB.
CASES = (
    ("fit", 3_000, 25.0, 0.6),
    ("diagnose", 3_000, 60.0, 1.5),
    ("fit", 10_000, 90.0, 1.5),
)


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """Of the process as a whole, interpreter, libraries and files included."""
    measures: list[Measure] = []
    for verb, n, seconds, gigabytes in CASES:
        with tempfile.TemporaryDirectory() as scratch:
            table = write_laxity(large_table(n, seed=SEED), Path(scratch, "laxity.csv"))
            code = CODE.format(verb=verb, table=table, out=Path(scratch, "out"))
            found, took = run_fresh(code)
        measures += [
            Measure(what=f"{verb} of {n:,} trials", value=took, unit="s", bar=seconds),
            Measure(
                what=f"{verb} of {n:,} trials, peak", value=found["GB"], unit="GB", bar=gigabytes
            ),
        ]
        yield Row(
            line="3,000 random trials of the reference knee with noise of 0.3 mm and deg: fit <= "
            "25 s and 0.6 GB, diagnose <= 60 s and 1.5 GB; fit of 10,000 <= 90 s and 1.5 GB",
            measures=measures,
            notes=[f"random flexion and loads, seed {SEED}; one run each"],
        )
