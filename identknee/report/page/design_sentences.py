"""What a design says: which tests would tell more."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from identknee.report.page.results import Result
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.report.words import capital, label, listed, parameter_words, trial_words


def design_findings(result: Result) -> Iterator[Statement]:
    """The trials that shrink open intervals most, and by how much."""
    summary = result.summary
    trials = summary["trials"]
    targets = summary["targets"]
    rows = tuple(
        (label(name), *(_ends(x[when]) for when in ("before", "predicted", "after")))
        for name, x in targets.items()
    )
    columns = tuple(Column(name=x) for x in ("target", "now", "predicted", "simulated"))
    name, entry = next(iter(targets.items()))
    yield Statement(
        question=Question.NEXT,
        sentence=f"Next test for {listed(map(parameter_words, targets))}: {_trials(trials)}. "
        f"{capital(parameter_words(name))} would then be known from {_ends(entry['after'])} "
        f"instead of {_ends(entry['before'])} {entry['before']['unit']}.",
        tables=(
            Table(title="Intervals of the targets", columns=columns, rows=rows),
            _trial_table(trials),
        ),
        is_answer=True,
    )


def _trials(trials: Sequence[Mapping[str, Any]]) -> str:
    counts: dict[str, int] = {}
    for trial in trials:
        words = trial_words(trial)
        counts[words] = counts.get(words, 0) + 1
    return listed(x if n == 1 else f"{x} ({n} times)" for x, n in counts.items())


def _trial_table(trials: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        title="Trials to add, the most telling first",
        columns=(Column(name="trial"), Column(name="what to do")),
        rows=tuple((str(x["trial"]), trial_words(x)) for x in trials),
    )


def _ends(entry: Mapping[str, Any]) -> str:
    low, high = (
        "open" if entry[x] is None else f"{float(entry[x]):.3g}" for x in ("lower", "upper")
    )
    return f"{low} to {high}"
