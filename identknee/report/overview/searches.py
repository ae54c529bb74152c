"""What all fits say together: how well they fit, and whether they end at the same parameters."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from identknee.checks.fit_warnings import ALIKE
from identknee.identify.basins import WITHIN
from identknee.report.answers.fit import fit_statements
from identknee.report.presenter import of_type, statements_of
from identknee.runs.outcome import Outcome
from identknee.runs.words import amount, listed, parameter_words, unit_of
from identknee.verbs.answer import Answer
from identknee.verbs.fit import Calibration
from identknee.verbs.sweep import Sweep

# More fits than these are told as a range.
MOST_TOLD = 4
MOST_NAMED = 2
ENDED = {
    Outcome.MINIMUM: "a minimum",
    Outcome.VALLEY: "stopped early",
    Outcome.CLIFF: "stopped at a cliff",
    Outcome.BUDGET: "budget used up",
    Outcome.SPREAD: "population shrunk",
}


def searches_sentences(answers: Sequence[Answer]) -> tuple[str, ...]:
    """Fits and sweeps in a few sentences; none without a search."""
    fits = {
        x: y for x, y in fits_by_start(answers).items() if y.outcome is not Outcome.START_FAILED
    }
    failed = [x for x in fits_by_start(answers).values() if x.outcome is Outcome.START_FAILED]
    return (
        *(_several(fits) if len(fits) > 1 else _each(fits.values())),
        *_each(failed),
        *(statements_of(x)[0].sentence for x in of_type(answers, Sweep)),
    )


def disagreement(answers: Sequence[Answer]) -> str:
    """That fits from different starts end at different parameters; empty where they do not."""
    return _disagreement(
        {x: y for x, y in fits_by_start(answers).items() if y.outcome is not Outcome.START_FAILED}
    )


def is_beaten(fit: Calibration, others: Iterable[Calibration]) -> bool:
    """Whether another fit of the same data leaves less, of lengths as of angles."""
    return fit.rmse.n_compared > 0 and any(
        np.array_equal(x.data.coordinates, fit.data.coordinates, equal_nan=True)
        and x.rmse.n_compared >= fit.rmse.n_compared
        and all(
            np.isnan(own) or own > (1.0 + ALIKE) * other
            for own, other in ((fit.rmse.mm, x.rmse.mm), (fit.rmse.deg, x.rmse.deg))
        )
        for x in others
    )


def fits_by_start(answers: Sequence[Answer]) -> dict[str, Calibration]:
    """Fits by their start, and by their method too where several began there."""
    found = of_type(answers, Calibration)
    starts = Counter(x.start for x in found)
    names = [x.start if starts[x.start] == 1 else f"{x.start} ({_method(x)})" for x in found]
    # Fits alike in both, as with other settings, are told apart by their number.
    seen: Counter[str] = Counter()
    by_start = {}
    for name, fit in zip(names, found, strict=True):
        seen[name] += 1
        by_start[name if seen[name] == 1 else f"{name}, fit {seen[name]}"] = fit
    return by_start


def _each(fits: Iterable[Calibration]) -> Iterator[str]:
    yield from (next(fit_statements(x)).sentence for x in fits)


def _several(fits: Mapping[str, Calibration]) -> Iterator[str]:
    if told := _alike(fits):
        yield told
    elif len(fits) <= MOST_TOLD:
        told = "; ".join(
            f"from {name} by {_method(x)} to {_errors(x)} "
            f"({_end(x)}, {x.n_simulations} simulations)"
            for name, x in fits.items()
        )
        yield f"{len(fits)} fits reproduce the measured laxity (RMSE): {told}."
    else:
        best, worst = (f(fits.values(), key=lambda x: x.objective) for f in (min, max))
        yield (
            f"{len(fits)} fits reproduce the measured laxity (RMSE) to {_errors(best)} at best and "
            f"{_errors(worst)} at worst."
        )
    if differ := _disagreement(fits):
        lowest = min(fits, key=lambda x: fits[x].objective)
        yield f"{differ} The lowest misfit is that from {lowest}."
    else:
        yield f"They end at the same parameters, to within {WITHIN:g} kN and {WITHIN:g} %."
    yield "That a model fits does not show that its parameters are right."


def _alike(fits: Mapping[str, Calibration]) -> str:
    """Fits that ended alike, in one sentence; empty where they did not or are many."""
    one = next(iter(fits.values()))
    alike = {(_errors(x), x.outcome, x.method) for x in fits.values()}
    if len(alike) > 1 or len(fits) > MOST_TOLD:
        return ""
    counts = sorted({x.n_simulations for x in fits.values()})
    many = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return (
        f"The {len(fits)} fits from {listed(fits)} by {_method(one)} all reproduce the measured "
        f"laxity to {_errors(one)} (RMSE; {_end(one)} after "
        f"{many} simulations)."
    )


def _end(fit: Calibration) -> str:
    return ENDED.get(fit.outcome, fit.outcome.value)


def _method(fit: Calibration) -> str:
    return fit.method.replace("-", " ")


def _errors(fit: Calibration) -> str:
    sizes = ((fit.rmse.mm, "mm"), (fit.rmse.deg, "deg"))
    return listed(amount(size, unit) for size, unit in sizes if np.isfinite(size))


def _disagreement(fits: Mapping[str, Calibration]) -> str:
    if len(fits) < 2:
        return ""
    starts, own = list(fits), list(fits.values())
    shared = [x for x in own[0].parameter_names if all(x in y.parameter_names for y in own)]
    ends = np.array([[x.search.theta[x.parameter_names.index(y)] for y in shared] for x in own])
    spread = np.ptp(ends, axis=0)
    clauses = []
    for j in np.argsort(-spread)[:MOST_NAMED]:
        if spread[j] > WITHIN:
            name, k = shared[j], sorted((int(ends[:, j].argmin()), int(ends[:, j].argmax())))
            told = [f"{amount(float(ends[i, j]), unit_of(name))} from {starts[i]}" for i in k]
            clauses.append(f"{parameter_words(name)} is {listed(told, 'but')}")
    if not clauses:
        return ""
    return f"Different starts end at different parameters: {'; '.join(clauses)}."
