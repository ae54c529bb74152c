"""What a simulation says: how many trials have an equilibrium, and why the others have none."""

from collections.abc import Iterator

import numpy as np

from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.outcome import Outcome
from identknee.verbs.simulate import Simulation


def simulate_statements(answer: Simulation) -> Iterator[Statement]:
    """How many trials have an equilibrium."""
    lost = [x for x in answer.trials if x.outcome is not Outcome.CONVERGED]
    columns = (Column(name="trial"), Column(name="why"))
    rows = tuple((x.trial, x.reason) for x in lost)
    table = Table(title="Trials without prediction", columns=columns, rows=rows)
    blank = " The cells of the others are blank." if lost else ""
    margins = [x.margin_N_per_mm for x in answer.trials if np.isfinite(x.margin_N_per_mm)]
    # The mesh law has no second derivatives and no margins.
    lowest = f" The least stable has a margin of {min(margins):.3g} N/mm." if margins else ""
    yield Statement(
        question=Question.LAXITY,
        sentence=f"{_how_many(answer)} a stable pose.{blank}{lowest}",
        tables=(table,) if lost else (),
    )


def _how_many(answer: Simulation) -> str:
    n, found = answer.n_trials, answer.n_converged
    if n == found:
        return "The one simulated trial has" if n == 1 else f"All {n} simulated trials have"
    return f"Of {n} simulated trials, {found} {'has' if found == 1 else 'have'}"
