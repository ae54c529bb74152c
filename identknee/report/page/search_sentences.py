"""What results say of fits and sweeps: where searches ended, and what that does not show."""

from collections.abc import Iterator, Mapping
from typing import Any

from identknee.report.page.results import Result
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.report.words import (
    coordinate_words,
    label,
    parameter_words,
)

METHODS = {"morris": "Morris's elementary effects", "sobol": "Sobol's total index"}


def sensitivity_findings(result: Result) -> Iterator[Statement]:
    """Which parameter moves which laxity most."""
    indices = result.summary["indices"]
    name = next((x for x in ("mu_star", "ST") if x in indices), next(iter(indices)))
    entries = indices[name]
    rows = tuple(
        (label(x), str(y["largest"]["group"]), y["largest"]["value"]) for x, y in entries.items()
    )
    columns = (
        Column(name="parameter"),
        Column(name="laxity it moves most"),
        Column(name=f"index {name}", decimals=None),
    )
    yield Statement(
        question=Question.LAXITY,
        sentence=_most_influential(entries, str(result.summary["method"])),
        tables=(Table(title="Largest influence of every parameter", columns=columns, rows=rows),),
    )


def _most_influential(entries: Mapping[str, Any], method: str) -> str:
    # Null where every simulation of a group failed.
    name, entry = max(entries.items(), key=lambda x: float(x[1]["largest"]["value"] or 0.0))
    coordinate, _, where = str(entry["largest"]["group"]).partition(", ")
    measure = METHODS.get(method, f"the {method} index")
    return (
        f"By {measure} laxity depends most on {parameter_words(name)}: "
        f"{coordinate_words(coordinate)} at {where.replace(', ', ' of flexion under ')}."
    )
