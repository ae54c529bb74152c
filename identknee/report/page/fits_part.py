"""Fits of one table from several starts, side by side."""

from collections.abc import Sequence

import numpy as np

from identknee.report.answers.fit import at_their_bounds, nuisance_tables
from identknee.report.overview.searches import fits_by_start
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.words import label
from identknee.verbs.answer import Answer
from identknee.verbs.fit import Calibration


def fits_statement(answers: Sequence[Answer]) -> Statement:
    """Where several fits ended, how well each fits, and what it says of geometry and tests.

    Parameters
    ----------
    answers
        Fits of one table, at least two.
    """
    fits = fits_by_start(answers)
    best = min(fits.values(), key=lambda x: x.objective)
    is_uncertain = bool(best.nuisances)
    return Statement(
        question=Question.SEARCH,
        sentence=f"The tables set the {len(fits)} fits side by side."
        + (" The stated errors are those of the fit with the lowest misfit." * is_uncertain),
        tables=(_ends(fits), _parameters(fits), *nuisance_tables(best)),
        is_answer=True,
    )


def _ends(fits: dict[str, Calibration]) -> Table:
    return Table(
        title="How each fit ended",
        columns=(
            Column(name="start"),
            Column(name="RMSE", unit="mm", decimals=None),
            Column(name="RMSE", unit="deg", decimals=None),
            Column(name="simulations", decimals=0),
            Column(name="end"),
        ),
        rows=tuple(
            (name, x.rmse.mm, x.rmse.deg, x.n_simulations, x.outcome.sentence)
            for name, x in fits.items()
        ),
    )


def _parameters(fits: dict[str, Calibration]) -> Table:
    names = dict.fromkeys(
        name
        for x in fits.values()
        for name in x.parameter_names
        if name not in {y.name for y in x.nuisances}
    )
    values = {
        start: dict(zip(x.parameter_names, x.search.theta.tolist(), strict=True))
        for start, x in fits.items()
    }
    notes = {start: at_their_bounds(x) for start, x in fits.items()}
    return Table(
        title="Fitted parameters by start",
        columns=(
            Column(name="parameter"),
            *(Column(name=f"from {start}", decimals=None) for start in fits),
            Column(name="remark"),
        ),
        rows=tuple(
            (
                label(name),
                *(values[start].get(name, np.nan) for start in fits),
                _remark([start for start in fits if name in notes[start]], len(fits)),
            )
            for name in names
        ),
    )


def _remark(starts: Sequence[str], n: int) -> str:
    if not starts:
        return ""
    return "at its bound" if len(starts) == n else f"at its bound from {', '.join(starts)}"
