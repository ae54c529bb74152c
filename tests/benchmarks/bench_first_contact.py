"""Time of a newcomer: from a clone to the first report, by the README's first command."""

import argparse
import os
import re
import subprocess
import tempfile
import time
from pathlib import Path

from requirement_rows import Row, median_of

ROOT = Path(__file__).parents[2]
REPEATS = 2
REPORT = Path("identknee-demo", "report.html")


def measure(options: argparse.Namespace) -> Row:
    """Seconds from `git clone` to the report, environment and cache being new each time."""
    seconds = [_seconds() for _ in range(REPEATS)]
    return Row(
        line="from clone to first report <= 3 minutes on 2 cores, install included",
        measures=[median_of("clone, environment, installation and demo", seconds, "s", bar=180.0)],
        notes=["what the network adds hangs on the machine: packages came from a near mirror"],
    )


def _seconds() -> float:
    with tempfile.TemporaryDirectory() as scratch:
        clone, cache = Path(scratch, "clone"), Path(scratch, "cache")
        kept = {k: x for k, x in os.environ.items() if k != "PYTHONPATH"}
        began = time.perf_counter()
        subprocess.run(["git", "clone", "-q", str(ROOT), str(clone)], check=True)
        subprocess.run(
            ["bash", "-c", _first_command(clone)],
            cwd=clone,
            env={**kept, "IDENTKNEE_CACHE": str(cache)},
            stdout=subprocess.DEVNULL,
            check=True,
        )
        seconds = time.perf_counter() - began
        if not (clone / REPORT).is_file():
            raise AssertionError(f"no {REPORT}")
    return seconds


def _first_command(clone: Path) -> str:
    readme = (clone / "README.md").read_text(encoding="utf-8")
    found = re.search(r"^python3 -m venv .*identknee demo$", readme, re.MULTILINE)
    if found is None:
        raise AssertionError("README.md has no command that ends in identknee demo")
    return found[0]
