"""What a sample of the posterior says: how probable values are, and whether to rely on it."""

from collections.abc import Iterator, Mapping

import numpy as np

from identknee.identify.posterior.convergence import SampleOutcome
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.words import interval, label, listed, parameter_words
from identknee.verbs.sample import Sample
from identknee.verbs.sample_records import Marginal, Nested

STIFFNESS = "stiffness_kN"
# More of them in one sentence are no answer any more.
MOST_NAMED = 5
CONDITIONS = {
    "steps_per_tau": "length of the chain in autocorrelation times, at least",
    "effective_draws": "effective draws (bulk or tail), at least",
    "effective_draws_each": "effective draws of any one ensemble, at least",
    "tau_drift": "relative change of an autocorrelation time between checks, at most",
    "rhat": "R-hat between half ensembles, at most",
    "mean_error": "Monte Carlo error of a mean [standard deviations], at most",
}


def sample_statements(answer: Sample) -> Iterator[Statement]:
    """What is probable, whether the sample converged, and what the prior excludes."""
    if answer.last_check is None:
        yield _statement(_trusted(answer))
        return
    yield _statement(
        f"Given the prior and the data, {_probable(answer.parameters)}. {_trusted(answer)}",
        _table(answer.parameters),
    )
    check = answer.last_check
    yield _statement(
        f"Each walker made {check.steps} steps, of which the first {check.burn_in} were discarded; "
        f"{100 * check.acceptance.mean():.0f} % of the proposals were accepted.",
        _conditions(answer),
    )
    yield _statement(f"{answer.excluded} The sample took {answer.n_simulations} simulations.")
    if answer.nested is not None:
        yield _statement(_opinion(answer.nested))


def _statement(sentence: str, *tables: Table) -> Statement:
    return Statement(question=Question.KNOWN, sentence=sentence, tables=tables)


def _trusted(answer: Sample) -> str:
    """Whether the sample may be relied on."""
    if answer.outcome is SampleOutcome.CONVERGED:
        return "The independent ensembles of walkers agree."
    unmet = sum(not x["met"] for x in answer.gate.values())
    count = f" {unmet} of {len(answer.gate)} conditions of convergence are not met." * bool(unmet)
    is_short = answer.outcome is SampleOutcome.BUDGET
    remedy = " The same command with a larger --budget goes on from here." if is_short else ""
    return f"Do not rely on this yet. {answer.sentence}{count}{remedy}"


def _probable(marginals: Mapping[str, Marginal]) -> str:
    """Intervals of a few parameters, stiffnesses where there are any."""
    names = [x for x in marginals if x.endswith(STIFFNESS)] or list(marginals)
    parts = []
    for name in names[:MOST_NAMED]:
        unit = "kN" if name.endswith("_kN") else "%" if name.endswith("_pct") else ""
        limits = (marginals[name].q025, marginals[name].q975)
        parts.append(f"{interval(limits, unit)} for {parameter_words(name)}")
    return f"the 95 % {'interval is' if len(parts) == 1 else 'intervals are'} {listed(parts)}"


def _table(marginals: Mapping[str, Marginal]) -> Table:
    heads = ("parameter", "mean", "sd", "2.5 %", "97.5 %", "R-hat", "effective draws")
    return Table(
        title="Posterior of the parameters",
        columns=tuple(Column(name=x, decimals=None) for x in heads),
        rows=tuple(
            (label(name), x.mean, x.sd, x.q025, x.q975, x.rhat, x.ess_bulk)
            for name, x in marginals.items()
        ),
    )


def _conditions(answer: Sample) -> Table:
    return Table(
        title="Conditions of convergence",
        columns=(
            Column(name="condition"),
            Column(name="value", decimals=None),
            Column(name="bar", decimals=None),
            Column(name="met"),
        ),
        rows=tuple(
            (CONDITIONS.get(name, name), x["value"], x["bar"], "yes" if x["met"] else "no")
            for name, x in answer.gate.items()
        ),
    )


def _opinion(nested: Nested) -> str:
    worst = float(np.max(np.abs(nested.quantile_differences)))
    return (
        f"Nested sampling: log evidence {nested.log_evidence:.2f} ± "
        f"{nested.log_evidence_error:.2f}; its quantiles differ by {worst:.1f} joint standard "
        "errors at most."
    )
