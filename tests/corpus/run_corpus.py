"""What every verb prints and writes, kept aside and compared after a change.

    python tests/corpus/run_corpus.py run FOLDER      # the checkout that is imported
    python tests/corpus/run_corpus.py compare BEFORE AFTER

Numbers must agree to `RELATIVE` of the largest in their list (or `ABSOLUTE`), fitted parameters
too; words may change and are listed, not judged. Times, versions and digests are left out.
"""

import argparse
import contextlib
import json
import math
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

RELATIVE, ABSOLUTE = 1e-6, 1e-9
ACL = "ACL.stiffness_kN"
OPTIONS = ("--noise", "0.3mm,0.3deg")
MEASURED = ("--noise", "1mm,1.5deg", "--uncertain", "registration=4deg,registration=4mm")
DATA = "simulate/laxity.csv"
COMMANDS: dict[str, tuple[str, ...]] = {
    "simulate": ("simulate", "reference", "--protocol", "seed63", *OPTIONS),
    "simulate-stable": ("simulate", "lenhart2015_stable", "--protocol", "table2"),
    "simulate-folding": ("simulate", "lenhart2015", "--protocol", "table2"),
    "simulate-mesh": ("simulate", "reference", "--protocol", "drawer", "--contact", "mesh"),
    "check": ("subject", "check", "lenhart2015_stable", "--samples", "4"),
    "settle": ("subject", "settle", "lenhart2015"),
    "fit": ("fit", "reference", DATA, "--start", "IG4"),
    "fit-complex": ("fit", "reference", DATA, "--method", "complex", "--budget", "200"),
    "fit-cma": ("fit", "reference", DATA, "--method", "cma-es", "--budget", "100"),
    "fit-student": ("fit", "reference", DATA, "--likelihood", "student", *OPTIONS),
    "fit-uncertain": ("fit", "reference", DATA, *OPTIONS, "--uncertain", "insertions=2mm"),
    "fit-held-out": ("fit", "reference", DATA, "--hold-out", "flexion30*", *OPTIONS),
    "fit-measured": ("fit", "s192803", "s192803", *MEASURED),
    "sweep": ("sweep", "reference", DATA, "--n-starts", "8", "--paths", "4"),
    "profile": (
        "profile",
        "reference",
        DATA,
        "--parameter",
        ACL,
        "--quantity",
        "varus_deg@{trial}",
    ),
    "profile-forces": (
        *("profile", "reference", DATA, "--parameter", ACL, "--forces", "{trial}"),
        *("--uncertain", "insertions=1mm", *OPTIONS),
    ),
    "sample": ("sample", "reference", DATA, "--ensembles", "2", "--budget", "3000"),
    "information": ("information", "reference", DATA),
    "equivalents": ("equivalents", "reference", DATA, "--criterion", "paper", "--n-sets", "3"),
    "sobol": ("sensitivity", "reference", "--protocol", "drawer", "--samples", "8"),
    "morris": (
        *("sensitivity", "reference", "--protocol", "drawer", "--method", "morris"),
        *("--samples", "8"),
    ),
    "design": ("design", "reference", DATA, "--target", ACL, "--n-trials", "2"),
    "blind": ("blind", "reference", "--seed", "7", "--effect", "anterolateral"),
    "diagnose": ("diagnose", "reference", "blind/laxity.csv"),
    "diagnose-null": ("diagnose", "reference", DATA),
    "diagnose-measured": ("diagnose", "s192803", "s192803", *MEASURED),
    "isolability": ("diagnose", "reference", "--protocol", "table2", *OPTIONS),
    "demo": ("demo", "--runs", "1", "--budget", "60"),
}
HELPS = (
    *("demo", "simulate", "fit", "sweep", "profile", "sample", "information", "sensitivity"),
    *("equivalents", "design", "diagnose", "blind", "reveal", "report", "doctor", "subject"),
)
_VOLATILE = re.compile(
    r"second|started|version|digest|sha|platform|cores|time|command|folder|cache"
)


def main() -> int:
    """0 if all commands ran, or all numbers agree."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("what", choices=["run", "compare"])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--only", nargs="*", default=[], help="names of commands")
    options = parser.parse_args()
    if options.what == "run":
        return run(options.folders[0], options.only)
    return compare(*options.folders)


def run(folder: Path, only: list[str]) -> int:
    """Every command once, its text beside its results; what is there already stays."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in HELPS:
        if not only:
            _kept(folder / f"help-{name}.txt", [name, "--help"], folder)
    for name, words in COMMANDS.items():
        if (only and name not in only) or (folder / f"{name}.txt").exists():
            continue
        trial = _first_trial(folder) if any("{trial}" in x for x in words) else ""
        given = [x.replace("{trial}", trial) for x in words]
        begun = time.perf_counter()
        code = _kept(folder / f"{name}.txt", [*given, "--out", name], folder)
        print(f"{name}: exit {code}, {time.perf_counter() - begun:.1f} s", flush=True)
    if not only:
        _kept(folder / "reveal.txt", ["reveal", "blind", "diagnose"], folder)
        _kept(folder / "report.txt", ["report", "."], folder)
    return 0


def _kept(path: Path, words: list[str], folder: Path) -> int:
    done = subprocess.run(
        [sys.executable, "-m", "identknee.cli.main", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "COLUMNS": "100"},
    )
    path.write_text(f"exit {done.returncode}\n{done.stdout}{done.stderr}", encoding="utf-8")
    return done.returncode


def _first_trial(folder: Path) -> str:
    rows = (folder / DATA).read_text(encoding="utf-8").splitlines()
    names = [x.partition(",")[0] for x in rows if x and not x.startswith(("#", "trial"))]
    return names[len(names) // 2]


def compare(before: Path, after: Path) -> int:
    """Print every number that moved, and how many texts differ."""
    moved = 0
    for old in sorted(before.rglob("result.json")):
        new = after / old.relative_to(before)
        if not new.exists():
            continue
        pairs = [json.loads(x.read_text(encoding="utf-8")) for x in (old, new)]
        moved += _report(old.parent.name, list(_moved(pairs[0], pairs[1])))
        arrays = [x.with_suffix(".nc") for x in (old, new)]
        if arrays[0].exists() and arrays[1].exists():
            moved += _report(f"{old.parent.name} arrays", list(_moved_arrays(*arrays)))
    for old in sorted(before.glob("*.txt")):
        new = after / old.name
        if new.exists():
            lines = [x.read_text(encoding="utf-8").splitlines() for x in (old, new)]
            n = len(set(lines[0]) ^ set(lines[1]))
            if n:
                print(f"{old.name}: {n} lines of text differ, {lines[0][0]} -> {lines[1][0]}")
    print(f"{moved} numbers moved")
    return int(moved > 0)


def _report(name: str, found: list[str]) -> int:
    for line in found[:10]:
        print(f"{name}: {line}")
    if len(found) > 10:
        print(f"{name}: and {len(found) - 10} more")
    return len(found)


def _moved(before: Any, after: Any, place: str = "") -> Iterator[str]:
    """Places whose numbers differ; places that only one of them has."""
    if _VOLATILE.search(place.rpartition(".")[2]) or place.startswith((".record", ".findings")):
        return
    if isinstance(before, dict) and isinstance(after, dict):
        for key in before:
            if key in after:
                yield from _moved(before[key], after[key], f"{place}.{key}")
            elif isinstance(before[key], int | float):
                yield f"{place}.{key} is gone"
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield f"{place}: {len(before)} entries, now {len(after)}"
        for k, (x, y) in enumerate(zip(before, after, strict=False)):
            yield from _moved(x, y, f"{place}[{k}]")
    elif isinstance(before, int | float) or isinstance(after, int | float):
        same = _same(before, after)
        if not same:
            yield f"{place}: {before} -> {after}"


def _same(before: Any, after: Any) -> bool:
    if before is None or after is None or isinstance(before, str) or isinstance(after, str):
        return bool(before == after)
    return math.isclose(before, after, rel_tol=RELATIVE, abs_tol=ABSOLUTE) or (
        math.isnan(before) and math.isnan(after)
    )


def _moved_arrays(before: Path, after: Path) -> Iterator[str]:
    with contextlib.ExitStack() as stack:
        trees = [stack.enter_context(xr.open_datatree(x)) for x in (before, after)]
        for path, node in trees[0].subtree_with_keys:
            for name, values in node.data_vars.items():
                place = f"{path}/{name}"
                if _VOLATILE.search(place) or values.dtype.kind not in "fiu":
                    continue
                try:
                    other = trees[1][f"{path}/{name}"]
                except KeyError:
                    yield f"{place} is gone"
                    continue
                if values.shape != other.shape:
                    yield f"{place}: {values.shape}, now {other.shape}"
                    continue
                x, y = np.asarray(values, float), np.asarray(other, float)
                scale = np.nanmax(np.abs(x), initial=0.0)
                apart = ~np.isclose(x, y, rtol=RELATIVE, atol=ABSOLUTE + RELATIVE * scale)
                apart &= ~(np.isnan(x) & np.isnan(y))
                if apart.any():
                    most = np.nanmax(np.abs(x - y), initial=0.0)
                    yield f"{place}: {apart.sum()} of {x.size} values, by up to {most:.3g}"


if __name__ == "__main__":
    raise SystemExit(main())
