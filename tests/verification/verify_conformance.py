"""Scores of identknee, iminuit and pyPESTO on the conformance suite."""

import argparse
import importlib.util
from importlib.metadata import version

import numpy as np
from conformance.case import Tool
from conformance.score import Grade, conformance_cases, run_conformance
from conformance.tool import identknee_tool
from conformance_tools import iminuit_tool, pypesto_tool
from requirement_rows import Measure, Row
from transformed_cases import SHIFTABLE, transformed

TOOLS: dict[str, Tool] = {
    "identknee": identknee_tool,
    "iminuit": iminuit_tool,
    "pypesto": pypesto_tool,
}
# Seeds of the units and shifts; the tests use another.
MOVED = range(11, 21)
# Kind enough for a tool that interpolates between the points of its curve.
KIND = 0.05


def measure(options: argparse.Namespace) -> Row:
    """Right, wrong and silently wrong answers of each tool; bars for identknee's."""
    measures = [
        Measure(what="cases", value=len(conformance_cases()), unit="", bar=25, at_least=True)
    ]
    notes: list[str] = []
    moved = [transformed(case, seed) for case in SHIFTABLE.values() for seed in MOVED]
    elsewhere = run_conformance(identknee_tool, moved)
    measures += [
        Measure(
            what="identknee, wrong in other units, shifted and mirrored",
            value=len(moved) - elsewhere.count(Grade.RIGHT),
            unit=f"of {len(moved)}",
            bar=0,
        )
    ]
    for name, tool in TOOLS.items():
        if importlib.util.find_spec(name) is None:
            notes.append(f"{name} is not installed and was not asked")
            continue
        measures += _scores(name, tool, None)
        if name != "identknee":
            measures += _scores(name, tool, KIND)
            notes.append(f"{name} {version(name)}")
    return Row(
        line="verdict suite: >= 25 constructed problems, 100 % right, 0 silent; other tools' "
        "adapters run against it",
        measures=measures,
        notes=[
            *notes,
            "ends right to 0.1 % of the half-width, or to 5 % where it says so",
            "a tool without words for open ends or verdicts is judged by its numbers",
            "a bound given back as an end is read as open; functions are asked where they can be",
            "identknee and pyPESTO fit from 16 more starts first",
        ],
    )


def _scores(name: str, tool: Tool, accuracy: float | None) -> list[Measure]:
    # pyPESTO draws its starts from the global generator.
    np.random.seed(0)  # noqa: NPY002
    report = run_conformance(tool, accuracy=accuracy)
    asked = len(report.graded) - report.count(Grade.UNSUPPORTED)
    bar = 0 if name == "identknee" else None
    where = name if accuracy is None else f"{name} at {100 * accuracy:g} %"
    wrong = asked - report.count(Grade.RIGHT)
    silent = report.count(Grade.SILENT)
    simulations = report.n_simulations / asked
    return [
        Measure(what=f"{where}, wrong", value=wrong, unit=f"of {asked}", bar=bar),
        Measure(what=f"{where}, silently wrong", value=silent, unit=f"of {asked}", bar=bar),
        Measure(what=f"{where}, mean simulations a case", value=simulations, unit=""),
    ]
