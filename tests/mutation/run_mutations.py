"""Break the package by hand, fault by fault: ``python tests/mutation/run_mutations.py [WORD ...]``.

With words, only faults whose file or text holds one of them are tried, and nothing is recorded.
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
    words = parser.parse_args().words
    chosen = [x for x in MUTATIONS if not words or any(w in x.name for w in words)]
    folder = Path(tempfile.gettempdir()) / "identknee_mutation" / ROOT.name
    _copy(folder)
    caught: list[bool] = []
    green: set[tuple[str, ...]] = set()
    for number, mutation in enumerate(chosen):
        if mutation.tests not in green and _tested(folder, mutation.tests) != GREEN:
            print(f"red without a fault: {' '.join(mutation.tests)}", flush=True)
            return 1
        green.add(mutation.tests)
        caught.append(_is_caught(folder, mutation))
        word = "caught" if caught[-1] else "SURVIVED"
        print(f"{number + 1}/{len(chosen)} {word}: {mutation.name}", flush=True)
    print(f"{sum(caught)} of {len(caught)} caught")
    if not words:
        _record(chosen, caught)
    return 0 if all(caught) else 1


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


def _record(chosen: Sequence[Mutation], caught: Sequence[bool]) -> None:
    verdict = {
        "date": datetime.now(UTC).date().isoformat(),
        "commit": commit(),
        "count": len(chosen),
        "caught": sum(caught),
        "command": "python tests/mutation/run_mutations.py",
        "mutations": [
            {"name": x.name, "why": x.why, "tests": list(x.tests), "caught": y}
            for x, y in zip(chosen, caught, strict=True)
        ],
    }
    text = json.dumps(verdict, indent=1, ensure_ascii=False) + "\n"
    VERDICT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
