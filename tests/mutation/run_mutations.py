"""Break the package by hand, fault by fault: ``python tests/mutation/run_mutations.py [WORD ...]``.

With words, only faults whose file or text holds one of them are tried. The fate of each is recorded
as soon as it is known, with the date and the commit; faults not tried keep what they had.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

from mutation import ROOT, Mutation  # noqa: E402
from mutations import MUTATIONS  # noqa: E402
from rows import commit  # noqa: E402

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
    if tests and _tested(folder, tests) != GREEN:
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
    return not words or any(x in mutation.name for x in words)


def _copy(folder: Path) -> None:
    """Bring a copy of the package and its tests up to date, so that compiled code stays valid."""
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
        return _tested(folder, mutation.tests) == RED
    finally:
        path.write_text(text, encoding="utf-8")
        os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))


def _tested(folder: Path, tests: Sequence[str]) -> int:
    """What pytest returns in the copy, whose package is the first on its path."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [*command, *tests],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=MOST_S,
        )
    except subprocess.TimeoutExpired:
        return RED
    if done.returncode not in (RED, GREEN):
        print(done.stdout[-2000:], done.stderr[-2000:], flush=True)
    return done.returncode


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
        "commit": commit(),
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
