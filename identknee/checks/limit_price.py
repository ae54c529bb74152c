"""The price of limits of plausibility: how much lower the deviance is without them."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.problem import (
    PLAUSIBILITY_TERM,
    Problem,
    SelectedResiduals,
    SumOfTerms,
    innermost,
    limit_rows,
    with_priors_of,
    without_priors,
)
from identknee.model.limit_residuals import LimitAtFit, LimitResiduals
from identknee.runs.declare import OF_PARAMETER, Array, IntArray, declared, entry
from identknee.runs.executors import Executor, serial

# Deviance of a limit below which it costs nothing.
ACTIVE = 0.1


@declared
class LimitPrice:
    """A limit of plausibility at a fit, and what it costs."""

    limit: LimitAtFit = entry("The limit")
    drop_one: float = entry("How much lower the deviance is with all others but this one", unit="1")
    value_without: float = entry("Value at the best fit without any limit", unit="N or %")
    alone: float = entry("How much it raises the deviance where it is the only limit", unit="1")


@declared
class PlausibilityPrice:
    """The price of all limits of plausibility together, and of each.

    The price of some limits is the least deviance with them less that without any. It cannot fall
    if a limit is added, because no limit lowers the deviance and all minima are taken over the same
    parameter sets.
    """

    limits: tuple[LimitPrice, ...] = entry("Each limit")
    price: float = entry("What all limits cost: rise of the least deviance", unit="1")
    of_data: float = entry(
        "The part of it that data and priors pay; the rest is beyond the limits", unit="1"
    )
    without: Mapping[str, float] = entry(
        "Parameters of the best fit without limits", unit=OF_PARAMETER
    )


class _Rows(NamedTuple):
    """Indices of the residuals of limits, and of all others."""

    limits: IntArray
    others: IntArray

    def with_limits(self, which: Sequence[int]) -> IntArray:
        """Indices of the other residuals and of those of some limits, ascending."""
        return np.sort(np.r_[self.others, self.limits[list(which)]])


def limits_of(problem: Problem) -> LimitResiduals | None:
    """The limits of a problem; None if it has none."""
    inner = innermost(problem)
    found = inner.terms.get(PLAUSIBILITY_TERM) if isinstance(inner, SumOfTerms) else None
    return found if isinstance(found, LimitResiduals) else None


def plausibility_price(
    problem: Problem,
    everywhere: Callable[[], Problem],
    thetas: Sequence[Array],
    *,
    search: Callable[..., Fit] = fit,
    executor: Executor = serial,
) -> PlausibilityPrice | None:
    """The price of the limits of a fit; None if it has none.

    The fit is repeated without each active limit, with that limit alone, and without any, each from
    the best known parameters. All ends then count in each of these comparisons.

    Parameters
    ----------
    problem
        The problem in units of the noise.
    everywhere
        Returns the same problem with residuals that are finite wherever a search begins.
    thetas
        The fit, then the ends of other searches with and without limits, shape ``(p,)`` each.
    search
        Fits a problem from a start, as `identknee.calibrate.fit.fit`.
    executor
        Anything with an ordered ``map``.
    """
    limits = limits_of(problem)
    if limits is None:
        return None
    at = limits.at_fit(thetas[0])
    every = range(limits.n)
    active = [i for i in every if at[i].deviance > ACTIVE]
    asked = [(), *((i,) for i in active), *(tuple(j for j in every if j != i) for i in active)]
    searched = with_priors_of(without_priors(everywhere()), problem)
    rows, own = _rows(searched), _rows(problem)
    found = [(problem.residuals(theta), theta) for theta in thetas]
    known = _Known(found, own)
    # Each search begins at the known parameters that are best for it.
    parts = [
        (SelectedResiduals(problem=searched, rows=rows.with_limits(which)), known.best(which))
        for which in asked
    ]
    ends = executor.map(partial(_end, search), parts)
    known = _Known([*found, *((problem.residuals(theta), theta) for theta in ends)], own)
    least = known.least

    nothing, whole = least(()), least(every)
    without = known.best(())
    values = limits.values(without)
    return PlausibilityPrice(
        limits=tuple(
            LimitPrice(
                limit=at[i],
                drop_one=whole - least([j for j in every if j != i]),
                value_without=float(values[i]),
                alone=least([i]) - nothing,
            )
            for i in every
        ),
        price=whole - nothing,
        of_data=known.paid(every) - nothing,
        without=dict(zip(problem.parameters.names, without.tolist(), strict=True)),
    )


def _rows(problem: Problem) -> _Rows:
    whole = np.arange(problem.residuals(problem.parameters.center).size)
    limits = whole[limit_rows(problem)]
    return _Rows(limits=limits, others=np.setdiff1d(whole, limits))


class _Known:
    """Parameter sets that predict every trial, and the deviance of each without and by limits."""

    def __init__(self, found: Sequence[tuple[Array, Array]], rows: _Rows) -> None:
        self.thetas = [theta for residuals, theta in found if np.isfinite(residuals).all()]
        squares = np.array([x**2 for x, _ in found if np.isfinite(x).all()])
        self.base, self.beyond = squares[:, rows.others].sum(axis=1), squares[:, rows.limits]

    def deviances(self, which: Sequence[int]) -> Array:
        """Deviance of each parameter set with some limits."""
        return np.asarray(self.base + self.beyond[:, list(which)].sum(axis=1))

    def least(self, which: Sequence[int]) -> float:
        """The lowest deviance with some limits."""
        return float(self.deviances(which).min())

    def best(self, which: Sequence[int]) -> Array:
        """The parameter set with the lowest deviance."""
        return self.thetas[int(self.deviances(which).argmin())]

    def paid(self, which: Sequence[int]) -> float:
        """Part of the lowest deviance that belongs to data and priors."""
        return float(self.base[self.deviances(which).argmin()])


def _end(search: Callable[..., Fit], part: tuple[Problem, Array]) -> Array:
    return np.asarray(search(*part).theta)
