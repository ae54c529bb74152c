"""Runs with two workers whose first process is killed: the workers must end with it."""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from killed_commands import descendants, is_running, run_for
from requirement_rows import Measure, Row, largest_of

KILLS, SEED, LIMIT_S = 20, 0, 5.0
# Between the start of the first process and the midst of the work [s].
MOMENTS = (1.0, 15.0)
COMMAND = [sys.executable, "-m", "identknee.cli.main"]
SUBJECTS = ("reference", "lenhart2015_stable")
VERBS = {"sweep": ["--n-starts", "400"], "profile": [], "sample": ["--budget", "5000"]}


def measure(options: argparse.Namespace) -> Row:
    """How long the workers live on after a kill."""
    rng = np.random.default_rng(SEED)
    with tempfile.TemporaryDirectory() as folder:
        data = {x: _data(Path(folder), x) for x in SUBJECTS}
        found: list[tuple[str, float, float, int, int]] = []
        while len(found) < KILLS:
            k = len(found)
            subject, verb = SUBJECTS[k % 2], list(VERBS)[k % 3]
            words = [verb, subject, str(data[subject]), *VERBS[verb], "--workers", "2"]
            one = _killed([*COMMAND, *words, "--out", f"{folder}/{k}"], rng.uniform(*MOMENTS))
            # Before there are workers there is nothing to see.
            if one is not None:
                found.append((verb, *one))
    left = [f"{verb}, killed after {at:.1f} s: {n} left" for verb, at, _, n, _ in found if n]
    n_processes = sum(x[4] for x in found)
    return Row(
        line="kill -9 of a run with two workers, 20 times: no orphan after 5 s",
        measures=[
            Measure(what="kills", value=len(found), unit="", bar=KILLS, at_least=True),
            Measure(what="kills with an orphan after 5 s", value=len(left), unit="", bar=0),
            largest_of("until the last one ended", [x[2] for x in found], "s", bar=LIMIT_S),
        ],
        notes=[f"{n_processes} other processes in all, of {', '.join(VERBS)}", *left],
    )


def _data(folder: Path, subject: str) -> Path:
    out = folder / subject
    words = ["simulate", subject, "--noise", "0.5mm,0.5deg", "--out", str(out)]
    if run_for([*COMMAND, *words], None) != 0:
        raise RuntimeError("identknee simulate did not end well")
    return out / "laxity.csv"


def _killed(command: list[str], after_s: float) -> tuple[float, float, int, int] | None:
    """When it was killed, how long its others lived on, how many still do, and how many were."""
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    ) as process:
        time.sleep(after_s)
        others = descendants(process.pid)
        process.send_signal(signal.SIGKILL)
    if len(others) < 2:
        return None
    began = time.monotonic()
    while (left := [x for x in others if is_running(x)]) and time.monotonic() - began < LIMIT_S:
        time.sleep(0.02)
    lived = time.monotonic() - began
    for other in left:
        os.kill(other, signal.SIGKILL)
    return after_s, lived, len(left), len(others)
