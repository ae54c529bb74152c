"""What results say of the parameters: known within limits, open, or interchangeable."""

from collections.abc import Iterator, Mapping
from typing import Any

from identknee.report.page.results import Result
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.report.words import between, label, listed, parameter_words

STIFFNESS = "stiffness_kN"
# More of them in one sentence are no answer any more.
MOST_NAMED = 5
MOST_FORCES = 12
Entries = Mapping[str, Mapping[str, Any]]


def sample_findings(result: Result) -> Iterator[Statement]:
    """What a sample of the posterior says."""
    entries: Entries = result.summary["parameters"]
    table = Table(
        title="Posterior of the parameters",
        columns=(
            *(Column(name=x, decimals=None) for x in ("parameter", "mean", "sd", "2.5 %")),
            *(Column(name=x, decimals=None) for x in ("97.5 %", "R-hat", "effective draws")),
        ),
        rows=tuple(
            (label(name), *(x[key] for key in ("mean", "sd", "q025", "q975", "rhat", "ess_bulk")))
            for name, x in entries.items()
        ),
    )
    said = f"Given the stated assumptions before the data, {_probable(entries)}." if entries else ""
    yield Statement(
        question=Question.KNOWN,
        sentence=f"{said} {_trusted(result)}".strip(),
        tables=(table,) if entries else (),
    )


def _trusted(result: Result) -> str:
    """Whether the sample may be relied on."""
    summary = result.summary
    if summary["outcome"] == "converged":
        return "Independent samplers agree on it."
    return f"Do not rely on it yet: {summary['sentence']}"


def _probable(entries: Entries) -> str:
    """Of at most so many parameters, the widest stiffnesses where there are any."""
    names = [x for x in entries if x.endswith(STIFFNESS)] or list(entries)
    parts = []
    for name in names[:MOST_NAMED]:
        unit = "kN" if name.endswith("_kN") else "%" if name.endswith("_pct") else ""
        low, high = entries[name]["q025"], entries[name]["q975"]
        parts.append(f"{parameter_words(name)} is {between((low, high), unit)}")
    return f"with 95 % probability {listed(parts)}"
