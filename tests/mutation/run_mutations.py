"""Break the package by hand, fault by fault: ``python tests/mutation/run_mutations.py [WORD ...]``.

With words, only faults whose file or text holds one of them are tried. The fate of each is recorded
as soon as it is known, with the date and the commit; faults not tried keep what they had.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NoReturn

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

# Loaded once for all processes to come; the package itself is not, since it is what changes.
import emcee  # noqa: F401
import numba  # noqa: F401
import pytest
import scipy.interpolate
import scipy.ndimage
import scipy.optimize
import scipy.spatial.transform
import scipy.stats  # noqa: F401
import trimesh  # noqa: F401
from mutation import ROOT, Mutation
from mutations import MUTATIONS

VERDICT = Path(__file__).with_name("verdict.json")
COPIED = ("identknee", "tests", "studies", "docs")
FILES = ("pyproject.toml", "README.md", "CHANGELOG.md", "CITATION.cff")
# What pytest returns where tests ran and some failed; a fault that stops the collection is none.
RED, GREEN = 1, 0
MOST_S = 900


def main() -> int:
    """1 if a fault was not seen, or tests are red without one."""
    parser = argparse.ArgumentParser(description="Break the package and see tests go red.")
    parser.add_argument("words", nargs="*", help="only faults that hold one of these")
    parser.add_argument("--new", action="store_true", help="only faults not recorded as caught")
    options = parser.parse_args()
    known = {x["name"] for x in _recorded() if x["caught"]} if options.new else set()
    chosen = [x for x in MUTATIONS if _is_meant(x, options.words) and x.name not in known]
    folder = Path(tempfile.gettempdir()) / "identknee_mutation" / ROOT.name
    _copy(folder)
    tests = list(dict.fromkeys(x for mutation in chosen for x in mutation.tests))
    if tests and _tested(folder, tests, [GREEN]) != GREEN:
        print("tests are red without a fault", flush=True)
        return 1
    n_caught = 0
    for number, mutation in enumerate(chosen):
        is_caught = _is_caught(folder, mutation)
        _record(mutation, is_caught=is_caught)
        n_caught += is_caught
        word = "caught" if is_caught else "SURVIVED"
        print(f"{number + 1}/{len(chosen)} {word}: {mutation.name}", flush=True)
    print(f"{n_caught} of {len(chosen)} caught")
    return 0 if n_caught == len(chosen) else 1


def _is_meant(mutation: Mutation, words: Sequence[str]) -> bool:
    text = f"{mutation.file} {mutation.name}"
    return not words or any(x in text for x in words)


def _copy(folder: Path) -> None:
    """Make a copy of the package and its tests anew, where compiled code of the last may be."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in COPIED:
        shutil.rmtree(folder / name, ignore_errors=True)
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy2(ROOT / name, folder / name)


def _is_caught(folder: Path, mutation: Mutation) -> bool:
    path = folder / mutation.file
    text, stamp = path.read_text(encoding="utf-8"), path.stat()
    try:
        path.write_text(mutation.applied(text), encoding="utf-8")
        return _tested(folder, mutation.tests, [GREEN, RED]) == RED
    finally:
        path.write_text(text, encoding="utf-8")
        os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))


def _tested(folder: Path, tests: Sequence[str], expected: Sequence[int]) -> int:
    """What pytest returns in the copy, in a process of its own that has the libraries already."""
    with tempfile.TemporaryFile("w+") as output:
        child = os.fork()
        if child == 0:
            _run_tests(folder, tests, output.fileno())
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        if code < 0:  # Ended by the alarm: a fault may make a search go on for ever.
            return RED
        if code not in expected:
            output.seek(0)
            print(output.read()[-3000:], flush=True)
    return code


def _run_tests(folder: Path, tests: Sequence[str], output: int) -> NoReturn:
    code = 3
    try:
        signal.alarm(MOST_S)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.chdir(folder)
        sys.path[:0] = [str(folder / x) for x in (".", "tests", "tests/support", "studies")]
        code = int(pytest.main(["-q", "-x", "--slow", "-n", "0", "-p", "no:cacheprovider", *tests]))
    except BaseException:  # noqa: BLE001 - nothing may go on in the copy of the process
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _commit() -> str:
    """The commit checked out, "dirty" if code differs from it; the record does not count."""
    head = ["git", "rev-parse", "--short", "HEAD"]
    changes = ["git", "status", "--porcelain", "--", "identknee", "tests/*.py"]
    found, changed = (
        subprocess.run(x, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for x in (head, changes)
    )
    return found.strip() + (" dirty" if changed.strip() else "")


def _recorded() -> list[dict[str, Any]]:
    if not VERDICT.exists():
        return []
    found: list[dict[str, Any]] = json.loads(VERDICT.read_text(encoding="utf-8"))["mutations"]
    return found


def _record(mutation: Mutation, *, is_caught: bool) -> None:
    """Write the record anew with the fate of one fault."""
    entries = {x["name"]: x for x in _recorded()}
    entries[mutation.name] = {
        "name": mutation.name,
        "why": mutation.why,
        "tests": list(mutation.tests),
        "caught": is_caught,
        "date": datetime.now(UTC).date().isoformat(),
        "commit": _commit(),
    }
    kept = [entries[x.name] for x in MUTATIONS if x.name in entries]
    verdict = {
        "count": len(kept),
        "caught": sum(x["caught"] for x in kept),
        "command": "python tests/mutation/run_mutations.py",
        "mutations": kept,
    }
    VERDICT.write_text(json.dumps(verdict, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
