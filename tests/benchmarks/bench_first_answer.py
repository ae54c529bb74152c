"""Time from the start of Python to the first simulation: with nothing compiled, and later."""

import argparse
import tempfile
from pathlib import Path

from fresh_process import run_fresh
from requirement_rows import Row, median_of

REPEATS = 3
LATER = 3  # later starts after each first one
SIMULATE = """
import json
import identknee as ik
found = ik.simulate(ik.reference_knee(), ik.load_protocol("seed63"))
print(json.dumps({"all_converged": found.n_converged == found.n_trials}))
"""
COMMAND = """
import json, sys, tempfile
from identknee.cli.main import main
sys.argv = ["identknee", "simulate", "reference", "--out", tempfile.mkdtemp()]
try:
    main()
except SystemExit as end:
    print(json.dumps({"code": end.code or 0}))
else:
    print(json.dumps({"code": 0}))
"""


def measure(options: argparse.Namespace) -> Row:
    """Seconds of whole processes, interpreter's start included, each cycle with an empty cache."""
    first, later, whole = [], [], []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as cache:
            first.append(_seconds(SIMULATE, cache))
            later += [_seconds(SIMULATE, cache) for _ in range(LATER)]
            whole.append(_seconds(COMMAND, cache))
    return Row(
        line="first answer of a fresh install (compile included) <= 25 s, later starts <= 1.5 s to "
        "the first simulation",
        measures=[
            median_of("first start", first, "s", bar=25.0),
            median_of("later starts", later, "s", bar=1.5),
            median_of("later `identknee simulate`, its files written", whole, "s"),
        ],
    )


def _seconds(code: str, cache: str) -> float:
    result, seconds = run_fresh(code, Path(cache))
    if not (result.get("all_converged") or result.get("code") == 0):
        raise AssertionError(result)
    return seconds
