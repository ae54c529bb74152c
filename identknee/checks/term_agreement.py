"""Which terms of the evidence there are: experiments, states, forces; and whether they agree."""

from collections.abc import Sequence

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

# P-value below which terms are said to disagree.
LEVEL = 0.01
# Fewest values of a term.
LEAST_VALUES = 5
# Most ends of other searches from which fits to single terms begin.
MOST_STARTS = 3


def rows_by_term(problem: Problem, laxity: Laxity) -> dict[str, IntArray]:
    """Indices of the residuals of each experiment (or state, if there is one experiment) and force.

    Empty if several experiments or states share an error: whitening then mixes their residuals.

    Parameters
    ----------
    problem
        A problem with residuals in units of the noise.
    laxity
        Its data.
    """
    protocol, inner = laxity.protocol, innermost(problem)
    trials = np.nonzero(laxity.is_measured)[0]
    several = len(set(protocol.experiment_names)) > 1
    labels = protocol.experiment_names if several else protocol.states
    shared = residuals_of(problem).shared
    if shared is not None and _is_across(shared, labels):
        return {}
    of = np.array(labels, object)[trials]
    found = {name: np.flatnonzero(of == name) for name in dict.fromkeys(labels)}
    if len(found) == 1:
        found = {TABLE_TERM: next(iter(found.values()))}
    if isinstance(inner, SumOfTerms):
        ends = np.cumsum(inner.sizes)
        # Beliefs about a knee are no measurements, so they cannot disagree with one.
        names = [x for x in inner.terms if x not in BELIEFS]
        found |= {name: np.arange(ends[i - 1], ends[i]) for i, name in enumerate(names) if i > 0}
    return {name: rows for name, rows in found.items() if rows.size >= LEAST_VALUES}


def _is_across(shared: Array, labels: Sequence[str]) -> bool:
    """Whether an error (n, 5, k) reaches trials of several labels."""
    _, number = np.unique(labels, return_inverse=True)
    reached = np.any(np.nan_to_num(shared) != 0.0, axis=1)
    return any(np.unique(number[column]).size > 1 for column in reached.T)


def term_agreement(
    problem: Problem,
    laxity: Laxity,
    theta: Array,
    *,
    ends: Sequence[Array] = (),
    seed: int = 0,
) -> Agreement | None:
    """Whether the terms of a fit agree; None if there is only one.

    Parameters
    ----------
    problem, laxity
        The problem of the fit, and its data.
    theta
        The best fit.
    ends
        Ends of other searches. Fits to single terms begin there and at the problem's start too.
    seed
        Seed of the draws.
    """
    terms = rows_by_term(problem, laxity)
    if len(terms) < 2:
        return None
    starts = [x for x in ends if np.isfinite(problem.residuals(x)).all()][:MOST_STARTS]
    begin = problem.parameters.start
    if np.isfinite(problem.residuals(begin)).all():
        starts.append(begin)
    return agreement(problem, theta, terms, starts=starts, seed=seed)


def agreement_findings(found: Agreement | None) -> tuple[Finding, ...]:
    """A finding if terms differ by more than chance explains."""
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
