"""What was promised and what was measured, from the records of verification and benchmarks."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

RECORDS = {"Verification": "verification/verdict.json", "Benchmarks": "benchmarks/record.json"}
ORDER = ("missed", "met", "reported")
Entry = Mapping[str, Any]


def write_records(path: Path, tests: Path) -> None:
    """Write the summary, then a section for each line: the missed ones first."""
    rows = [
        (tier, name, entry)
        for tier, file in RECORDS.items()
        for name, entry in json.loads((tests / file).read_text(encoding="utf-8"))["rows"].items()
    ]
    rows.sort(key=lambda row: ORDER.index(row[2]["verdict"]))
    sections = "\n".join(_section(*row) for row in rows)
    path.write_text(f"{_summary(rows)}\n{sections}", encoding="utf-8")


def _summary(rows: list[tuple[str, str, Entry]]) -> str:
    counts = {x: sum(row[2]["verdict"] == x for row in rows) for x in ORDER}
    said = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count)
    lines = [
        f"{len(rows)} lines: {said}. A line is missed where one of its numbers misses its bar.",
        "",
        "| line | what must be reached | verdict | numbers that missed |",
        "| --- | --- | --- | --- |",
    ]
    for tier, name, entry in rows:
        judged = [x for x in entry["measures"] if x["met"] is not None]
        missed = f"{sum(not x['met'] for x in judged)} of {len(judged)}"
        link = f"[{name}](#{_label(tier, name)})"
        lines += [f"| {link} | {_cell(entry['line'])} | {_verdict(entry)} | {missed} |"]
    return "\n".join(lines) + "\n"


def _section(tier: str, name: str, entry: Entry) -> str:
    cores, processor = entry["machine"]["cores"], _cell(entry["machine"]["processor"])
    where = f"{cores} cores {processor}, {entry['seconds']:,.0f} s"
    lines = [
        f"({_label(tier, name)})=",
        f"## {name}: {entry['verdict']}",
        "",
        f"{tier}. {_cell(entry['line'])}.",
        "",
        "| | measured | range | count | bar | met |",
        "| --- | ---: | --- | ---: | ---: | --- |",
        *(_measure(x) for x in sorted(entry["measures"], key=lambda x: x["met"] is not False)),
        "",
        *(f"- {_cell(note)}" for note in entry["notes"]),
        "",
        f"{entry['date']}, commit `{entry['commit']}`, {where}: `{entry['command']}`",
        "",
    ]
    return "\n".join(lines)


def _measure(measure: Entry) -> str:
    value = f"{number(measure['value'])} {_cell(measure['unit'])}".strip()
    spread = ""
    if measure["low"] is not None:
        spread = f"{number(measure['low'])} to {number(measure['high'])}"
        if measure["interval"] != "min-max":
            spread += f" ({_cell(measure['interval'])})"
    bar = "" if measure["bar"] is None else number(measure["bar"])
    sign = "at least " if measure["at_least"] else "at most "
    met = {True: "yes", False: "**missed**", None: ""}[measure["met"]]
    cells = (_cell(measure["what"]), value, spread, measure["count"], bar and sign + bar, met)
    return f"| {' | '.join(str(x) for x in cells)} |"


def _verdict(entry: Entry) -> str:
    return "**missed**" if entry["verdict"] == "missed" else str(entry["verdict"])


def _label(tier: str, name: str) -> str:
    return f"{tier}-{name}".lower().replace("_", "-")


def _cell(text: str) -> str:
    """Text that Markdown leaves as it is."""
    for mark in "\\|$*<[":
        text = text.replace(mark, "\\" + mark)
    return text.rstrip(".")


def number(value: float | None) -> str:
    """A number with three digits, or what stands in its place."""
    if value is None or math.isnan(value):
        return "none"
    if math.isinf(value):
        return "infinity"
    if value == int(value) and abs(value) < 1e6:
        return f"{int(value):,}"
    return f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.3g}"
