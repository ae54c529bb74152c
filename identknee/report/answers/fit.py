"""What a fit says: how well it reproduces the data, and that this is not yet knowledge."""

from collections.abc import Iterator

import numpy as np

from identknee.checks.fit_warnings import AT_END
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.findings import Severity
from identknee.runs.outcome import Outcome
from identknee.runs.words import amount, coordinate_words, label, listed, unit_of
from identknee.verbs.fit import Calibration
from identknee.verbs.held_out import HeldOut

# Below it an error is that of rounding, mm or deg.
NO_ERROR = 1e-4
# Stated errors that a terminal shows.
MOST_ERRORS = 8


def fit_statements(answer: Calibration) -> Iterator[Statement]:
    """How well the fit reproduces the data, and how the search ended."""
    if answer.outcome is Outcome.START_FAILED:
        # What the search began with is no fit, and its error is that of the other trials.
        yield Statement(question=Question.SEARCH, sentence=answer.sentence, is_answer=True)
        return
    sizes = ((answer.rmse.mm, "mm"), (answer.rmse.deg, "deg"))
    errors = [
        amount(size, unit) if size >= NO_ERROR else f"less than {NO_ERROR:g} {unit}"
        for size, unit in sizes
        if np.isfinite(size)
    ]
    is_good = all(x.severity is Severity.INFO for x in answer.findings)
    caution = " A good fit does not show that its parameters are right." if is_good else ""
    plural = "" if answer.rmse.n_compared == 1 else "s"
    yield Statement(
        question=Question.SEARCH,
        sentence=f"The best fit reproduces the measured laxity to {listed(errors)} on average "
        f"(RMSE over {answer.rmse.n_compared} measured value{plural}). {answer.sentence}{caution}",
        tables=(_table(answer), *nuisance_tables(answer)),
        is_answer=True,
    )
    if answer.held_out is not None:
        yield _held_out(answer.held_out)


def _held_out(held: HeldOut) -> Statement:
    sizes = [f"{amount(x, unit_of(k))} {coordinate_words(k)}" for k, x in held.rmse.items()]
    lost = (
        f" {len(held.lost)} of them have no prediction: {listed(held.lost)}." if held.lost else ""
    )
    share = f"{100 * held.within_90:.0f} % of the values predicted lie in their 90 % intervals."
    shown = f" {share}" if sizes else ""
    errors = f", to {listed(sizes)} on average (RMSE)" if sizes else ""
    return Statement(
        question=Question.SEARCH,
        sentence=f"The fit predicts {len(held.trials)} trials that it did not see{errors}."
        f"{lost}{shown}",
        tables=(
            Table(
                title="Trials held out",
                columns=(
                    Column(name="value"),
                    Column(name="measured", decimals=2),
                    Column(name="predicted", decimals=2),
                    Column(name="sd", decimals=2),
                ),
                rows=tuple(
                    (f"{label(x.coordinate)} in {x.trial}", x.measured, x.predicted, x.sd)
                    for x in held.values
                ),
            ),
        ),
    )


def _table(answer: Calibration) -> Table:
    search = answer.search
    notes = dict.fromkeys(at_their_bounds(answer), "at its bound")
    notes |= dict.fromkeys(search.fixed, "fixed")
    nuisances = {x.name for x in answer.nuisances}
    rows = zip(answer.parameter_names, search.start.tolist(), search.theta.tolist(), strict=True)
    return Table(
        title="Fitted parameters",
        columns=(
            Column(name="parameter"),
            Column(name="start", decimals=None),
            Column(name="fitted", decimals=None),
            Column(name="remark"),
        ),
        rows=tuple(
            (label(name), start, end, notes.get(name, ""))
            for name, start, end in rows
            if name not in nuisances
        ),
    )


def at_their_bounds(answer: Calibration) -> tuple[str, ...]:
    """Names of the parameters that the fit's own warning says to stand at a bound."""
    search, own = answer.search, answer.search.parameters
    margin = AT_END * (own.upper - own.lower)
    stands = (np.abs(search.theta - own.lower) <= margin) | (
        np.abs(search.theta - own.upper) <= margin
    )
    named = zip(own.names, stands & (own.lower < own.upper), strict=True)
    return tuple(name for name, is_there in named if is_there and name not in search.fixed)


def nuisance_tables(answer: Calibration) -> Iterator[Table]:
    """What a fit says of stated errors; nothing where none are stated."""
    if answer.nuisances:
        moved = sorted(answer.nuisances, key=lambda x: -abs(x.away))
        yield Table(
            title="Stated errors of geometry and tests at the fit, those moved most first",
            columns=(
                Column(name="error"),
                Column(name="fitted", decimals=None),
                Column(name="sd", decimals=None),
                Column(name="stated sd", decimals=None),
            ),
            rows=tuple((label(x.name), x.value, x.sd, x.prior_sd) for x in moved),
            most=MOST_ERRORS,
        )
