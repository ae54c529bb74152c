"""Which terms of the evidence there are: experiments, states, forces; and whether they agree."""

import numpy as np

from identknee.calibrate.agreement import Agreement, agreement
from identknee.calibrate.problem import (
    BELIEFS,
    TABLE_TERM,
    Problem,
    SumOfTerms,
    innermost,
)
from identknee.checks.usable_trials import residuals_of
from identknee.laxity.table import Laxity
from identknee.runs.arrays import Array, IntArray
from identknee.runs.findings import Finding, finding

# Terms that agree differ as far in this share of data sets.
LEVEL = 0.01
# Fewer values than this are no term of their own.
LEAST_VALUES = 5


def rows_by_term(problem: Problem, laxity: Laxity) -> dict[str, IntArray]:
    """Residuals of each experiment, or of each state of one, and of each kind of force.

    Empty where residuals were mixed to take out errors that trials share.

    Parameters
    ----------
    problem
        Of a fit in units of the noise.
    laxity
        Its data.
    """
    if residuals_of(problem).shared is not None:
        return {}
    protocol, inner = laxity.protocol, innermost(problem)
    trials = np.nonzero(laxity.is_measured)[0]
    if protocol.experiment is not None and len(set(protocol.experiment)) > 1:
        labels: tuple[str, ...] = protocol.experiment
    else:
        labels = ("intact",) * laxity.n if protocol.state is None else protocol.state
    of = np.array(labels, object)[trials]
    found = {name: np.flatnonzero(of == name) for name in dict.fromkeys(labels)}
    if len(found) == 1:
        found = {TABLE_TERM: next(iter(found.values()))}
    if isinstance(inner, SumOfTerms):
        ends = np.cumsum(inner.sizes)
        # Beliefs about a knee are no measurements with an error.
        names = [x for x in inner.terms if x not in BELIEFS]
        found |= {name: np.arange(ends[i - 1], ends[i]) for i, name in enumerate(names) if i > 0}
    return {name: rows for name, rows in found.items() if rows.size >= LEAST_VALUES}


def term_agreement(
    problem: Problem, laxity: Laxity, theta: Array, *, seed: int = 0
) -> Agreement | None:
    """Whether the terms of a fit agree; None where there is one alone."""
    terms = rows_by_term(problem, laxity)
    return agreement(problem, theta, terms, seed=seed) if len(terms) > 1 else None


def agreement_findings(found: Agreement | None) -> tuple[Finding, ...]:
    """That terms do not agree, where chance would seldom make them differ so far."""
    if found is None or found.p_value >= LEVEL:
        return ()
    worst = found.worst
    values = {
        "terms": ", ".join(x.name for x in found.terms),
        "difference": found.difference,
        "p_value": found.p_value,
        "worst": worst.name,
        "rise": worst.rise,
    }
    return (finding("terms-disagree", "data", values),)
