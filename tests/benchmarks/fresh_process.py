"""Python code run in a process of its own, with a cache folder of its own."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def run_fresh(code: str, cache: Path | None = None) -> tuple[dict[str, Any], float]:
    """What the last line that the code prints says in JSON, and the seconds the process took.

    Without `cache` the process uses the cache this one uses.
    """
    environment = dict(os.environ)
    # Nobody compiles the sources at every start.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    paths = [str(ROOT), str(ROOT / "tests" / "support"), environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    if cache is not None:
        environment["IDENTKNEE_CACHE"] = str(cache)
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - began
    if done.returncode != 0:
        raise RuntimeError(done.stderr)
    result: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return result, seconds
