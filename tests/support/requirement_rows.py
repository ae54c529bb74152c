"""Rows of the tables of what the project must reach: measured, recorded, and rendered as text."""

import argparse
import importlib
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from common.records import processor

from identknee.runs.files import write_atomically, write_json

TESTS = Path(__file__).parents[1]
RECORDS = {
    "benchmarks": TESTS / "benchmarks" / "record.json",
    "verification": TESTS / "verification" / "verdict.json",
}
RESULTS = TESTS / "benchmarks" / "RESULTS.md"


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One number beside its bar.

    ``bar`` is the most that is allowed, or the least where ``at_least``; None where a number is
    reported without one. ``low`` and ``high`` are the smallest and the largest of ``count`` values
    of which ``value`` is the median, unless ``interval`` says something else.
    """

    what: str
    value: float
    unit: str
    bar: float | None = None
    at_least: bool = False
    low: float | None = None
    high: float | None = None
    count: int = 1
    interval: str = "min-max"

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None without one. NaN meets nothing."""
        if self.bar is None:
            return None
        return bool(self.value >= self.bar if self.at_least else self.value <= self.bar)


@dataclass(frozen=True, kw_only=True)
class Row:
    """What one line of the table came to."""

    line: str
    measures: Sequence[Measure]
    notes: Sequence[str] = ()


def median_of(
    what: str,
    values: Sequence[float] | np.ndarray,
    unit: str,
    *,
    bar: float | None = None,
    at_least: bool = False,
) -> Measure:
    """The median of repeated measurements, with their range."""
    sample = np.asarray(values, float)
    return Measure(
        what=what,
        value=float(np.median(sample)),
        unit=unit,
        bar=bar,
        at_least=at_least,
        low=float(sample.min()),
        high=float(sample.max()),
        count=sample.size,
    )


def largest_of(
    what: str, values: Sequence[float] | np.ndarray, unit: str, *, bar: float | None = None
) -> Measure:
    """The largest of many errors, of which none may exceed the bar; the interval is their range."""
    sample = np.asarray(values, float)
    return Measure(
        what=what,
        value=float(sample.max()) if sample.size else math.nan,
        unit=unit,
        bar=bar,
        low=float(sample.min()) if sample.size else None,
        high=float(sample.max()) if sample.size else None,
        count=sample.size,
        interval="min-max, the value is the largest",
    )


def rejected_cells(p_values: Sequence[float]) -> Measure:
    """How many of the cells of a coverage are rejected at 5 % by Holm's method; none may be."""
    holm = np.sort(p_values) * np.arange(len(p_values), 0, -1)
    return Measure(
        what="cells rejected at 5 % after Holm",
        value=float(np.sum(np.minimum.accumulate(holm < 0.05))),
        unit="",
        bar=0.0,
        count=len(p_values),
    )


def run(tier: str, modules: Mapping[str, str], script: str) -> int:
    """Measure the rows asked for on the command line; 1 if a bar was missed, else 0.

    Each module has ``measure(options) -> Row``, or ``parts(options)`` that yields the row again
    whenever more of it is measured; ``options.row`` names the row. The record is written anew each
    time; rows not measured this time keep what they had.
    """
    parser = argparse.ArgumentParser(description=f"Measure the {tier} rows and record them.")
    parser.add_argument("--only", nargs="+", choices=list(modules), default=list(modules))
    parser.add_argument(
        "--opensim-python",
        default=os.environ.get("OPENSIM_PYTHON", sys.executable),
        help="interpreter that can import opensim, where it is not this one",
    )
    parser.add_argument("--workers", type=int, default=2, help="of the rows that use several")
    options = parser.parse_args()
    verdicts = {}
    for name in options.only:
        began = time.perf_counter()
        # A module may measure several rows.
        options.row = name
        module = importlib.import_module(modules[name])
        rows = module.parts(options) if hasattr(module, "parts") else [module.measure(options)]
        for row in rows:
            entry = _entry(row, f"python {script} --only {name}", time.perf_counter() - began)
            _record(tier, list(modules), name, entry)
            _show(name, row, entry)
            verdicts[name] = entry["verdict"]
    return 1 if "missed" in verdicts.values() else 0


def _show(name: str, row: Row, entry: Mapping[str, Any]) -> None:
    print(f"== {name}: {entry['verdict']}, {entry['seconds']:.0f} s", flush=True)
    for measure in row.measures:
        print(f"   {_described(asdict(measure) | {'met': measure.met})}", flush=True)
    for note in row.notes:
        print(f"   {note}", flush=True)


def _entry(row: Row, command: str, seconds: float) -> dict[str, Any]:
    judged = [measure.met for measure in row.measures if measure.met is not None]
    verdict = "reported" if not judged else "met" if all(judged) else "missed"
    return {
        "line": row.line,
        "verdict": verdict,
        "measures": [asdict(x) | {"met": x.met} for x in row.measures],
        "notes": list(row.notes),
        "command": command,
        "date": datetime.now(UTC).date().isoformat(),
        "commit": commit(),
        "machine": {"cores": os.cpu_count(), "processor": processor()},
        "seconds": round(seconds, 1),
    }


def commit() -> str:
    """The commit checked out, "dirty" if code differs from it; records do not count."""
    head = ["git", "rev-parse", "--short", "HEAD"]
    changes = ["git", "status", "--porcelain", "--", "identknee", "tests/*.py"]
    try:
        found, changed = (
            subprocess.run(x, cwd=TESTS.parent, capture_output=True, text=True, check=True).stdout
            for x in (head, changes)
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return found.strip() + (" dirty" if changed.strip() else "")


def _record(tier: str, order: Sequence[str], name: str, entry: Mapping[str, Any]) -> None:
    rows = _rows(tier) | {name: dict(entry)}
    write_json(RECORDS[tier], {"rows": {key: rows[key] for key in order if key in rows}})
    write_atomically(RESULTS, rendered())


def _rows(tier: str) -> dict[str, Any]:
    path = RECORDS[tier]
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))["rows"] if path.exists() else {}
    return found


def rendered() -> str:
    """Both records as one page."""
    parts = [
        "# What was reached",
        "",
        (
            "Written by the two runners from `record.json` and `../verification/verdict.json`; do "
            "not edit. A value with a range is the median of that many runs and their smallest and "
            "largest, unless it says so."
        ),
    ]
    for tier in RECORDS:
        parts += ["", f"## {tier.capitalize()}", ""]
        parts += [
            "| row | what must be reached | measured | met | date, commit, machine, command |"
        ]
        parts += ["| --- | --- | --- | --- | --- |"]
        parts += [_rendered_row(name, entry) for name, entry in _rows(tier).items()]
    return "\n".join(parts) + "\n"


def _rendered_row(name: str, entry: Mapping[str, Any]) -> str:
    cells = [_described(measure) for measure in entry["measures"]] + entry["notes"]
    machine = entry["machine"]
    where = (
        f"{entry['date']}, {entry['commit']}, {machine['cores']} cores {machine['processor']}, "
        f"{entry['seconds']:g} s, `{entry['command']}`"
    )
    return f"| {name} | {entry['line']} | {'<br>'.join(cells)} | {entry['verdict']} | {where} |"


def _described(measure: Mapping[str, Any]) -> str:
    text = f"{measure['what']}: {_number(measure['value'])} {measure['unit']}".rstrip()
    if measure["low"] is not None:
        spread = f"{_number(measure['low'])} to {_number(measure['high'])}"
        kind = "" if measure["interval"] == "min-max" else f", {measure['interval']}"
        text += f" ({spread}, n = {measure['count']}{kind})"
    elif measure["count"] > 1:
        text += f" (n = {measure['count']})"
    if measure["bar"] is not None:
        sign = ">=" if measure["at_least"] else "<="
        text += f", bar {sign} {_number(measure['bar'])}"
        text += "" if measure["met"] else " **missed**"
    return text


def _number(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "none"
    if math.isinf(value):
        return "infinity"
    if value == int(value) and abs(value) < 1e6:
        return f"{int(value):,}"
    return f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.3g}"
