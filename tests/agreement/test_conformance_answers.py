"""The answers of the conformance suite against brute force."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from brute_force import deviance, lowest
from conformance.case import Case, Formula
from conformance.construction import plain_parameters
from conformance.score import conformance_cases
from slow_cases import some_slow

from identknee.calibrate.problem import ParameterQuantity, Problem
from identknee.runs.declare import Array

CASES = {case.name: case for case in conformance_cases()}
# About a second each.
SLOW = {
    *("stiff beside sloppy", "closed by the bound of another", "condition 1e16", "saturation"),
    *("cliff beside the path", "exchangeable parameters", "nuisance pinned at its bounds"),
    *("two branches apart", "thirty parameters"),
}
# How near an end the deviance must cross the threshold, as a share of half the width.
NEAR = 1e-6
# Noise of 1e-4 in a residual of 2 moves an end by this share.
NOISY = {"noisy residuals": 1e-4}
# Between an optimum found on a grid and the true one, far below the threshold of 3.84.
GRID = 1e-6
# What unbounded parameters are looked at within.
FAR = 1e3
# Cases about a function: theta as the function's value and the second parameter.
SOLVED: dict[str, Callable[[float, float], list[float]]] = {
    "the sum itself": lambda value, other: [value - other, other],
    "the product itself": lambda value, other: [value / other, other],
}


def _in_terms_of_the_function(case: Case) -> Formula:
    """The problem with the function in the place of its first parameter."""
    solve = SOLVED[case.name]
    low, high = case.problem.parameters.lower, case.problem.parameters.upper

    def residuals(theta: Array) -> Array:
        original = np.array(solve(*theta))
        inside = ((original >= low) & (original <= high)).all()
        found = case.problem.residuals(original)
        return found if inside else np.full(found.shape, np.inf)

    return Formula(
        parameters=plain_parameters((-1e4, 1e4), (low[1], high[1])),
        residuals_at=residuals,
        # Fits from here go nowhere: the grid over the other parameter decides alone.
        jacobian_at=lambda _: np.zeros((1, 2)),
    )


def _problem(case: Case) -> tuple[Problem, int]:
    if case.name in SOLVED:
        return _in_terms_of_the_function(case), 0
    assert isinstance(case.quantity, ParameterQuantity)
    return _continued(case.problem), case.quantity.index


def _continued(problem: Problem) -> Problem:
    """The problem as it would be if its model ended nowhere."""
    if not isinstance(problem, Formula):
        return problem
    return replace(problem, is_feasible=lambda _: True)


def _has_prediction(case: Case, value: float) -> bool:
    """Whether any parameter set on a grid has a prediction at a value of the first parameter."""
    problem = case.problem
    if not isinstance(problem, Formula) or case.name in SOLVED:
        return True
    low, high = problem.parameters.lower[1:], problem.parameters.upper[1:]
    others = np.linspace(np.maximum(low, -FAR), np.minimum(high, FAR), 101)
    return any(problem.is_feasible(np.r_[value, x]) for x in others)


def _profile(case: Case, value: float) -> float:
    """Lowest deviance at a value, over a grid and fits from many places; nothing is excluded
    where the model has no prediction.
    """
    if not _has_prediction(case, value):
        return 0.0
    problem, index = _problem(case)
    parameters = problem.parameters
    rng = np.random.default_rng(0)
    low, high = np.maximum(parameters.lower, -FAR), np.minimum(parameters.upper, FAR)
    starts = [np.clip(case.optimum, low, high), *rng.uniform(low, high, (2, parameters.n))]
    best = lowest(problem, index, value, np.array(starts))
    if parameters.n != 2:
        return best.deviance
    other = 1 - index

    def along(place: float) -> float:
        theta = np.empty(2)
        theta[index], theta[other] = value, place
        return deviance(problem, theta)

    grid = np.linspace(low[other], high[other], 801)
    around = np.argsort([along(x) for x in grid])[:3]
    found = [best.deviance]
    for k in around:
        ends = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
        with np.errstate(all="ignore"):
            inner = scipy.optimize.minimize_scalar(
                along, bounds=ends, method="bounded", options={"xatol": 1e-10}
            )
        found += [float(inner.fun), along(grid[k])]
    return min(found)


def _lowest_of_all(case: Case) -> float:
    """The lowest deviance along the quantity, its best value found on a grid within the set."""
    here = case.quantity.evaluate(case.optimum)[0]
    values = sorted([here, *(x for pair in case.intervals for x in _inside(case, pair, 11))])
    deviances = [_profile(case, x) for x in values]
    k = int(np.argmin(deviances))
    ends = values[max(k - 1, 0)], values[min(k + 1, len(values) - 1)]
    found = scipy.optimize.minimize_scalar(
        lambda x: _profile(case, x), bounds=ends, method="bounded", options={"maxiter": 15}
    )
    return min(float(found.fun), deviances[k])


def _range(case: Case) -> tuple[float, float]:
    if case.name in SOLVED:
        return -20.0, 20.0
    _, index = _problem(case)
    parameters = case.problem.parameters
    return max(parameters.lower[index], -FAR), min(parameters.upper[index], FAR)


def _inside(case: Case, interval: tuple[float, float], n: int) -> Array:
    low, high = _range(case)
    ends = [interval[0] if math.isfinite(interval[0]) else low]
    ends += [interval[1] if math.isfinite(interval[1]) else high]
    shrink = 2 * NOISY.get(case.name, NEAR) * (ends[1] - ends[0])
    return np.linspace(ends[0] + shrink, ends[1] - shrink, n)


def test_there_are_enough_and_their_names_differ() -> None:
    assert len(CASES) >= 25
    assert len(CASES) == len(conformance_cases())


@pytest.mark.parametrize("name", some_slow(CASES, SLOW))
def test_answer_by_brute_force(name: str) -> None:
    case = CASES[name]
    limit = _lowest_of_all(case) + case.threshold
    for interval in case.intervals:
        assert all(_profile(case, x) <= limit + GRID for x in _inside(case, interval, 5))
    low, high = _range(case)
    edges = [low, *(x for pair in case.intervals for x in pair), high]
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if not math.isfinite(first) or not math.isfinite(last):
            continue
        near = NOISY.get(name, NEAR) * min(case.half_width(x) for x in case.intervals)
        if last - first > 2 * near:
            between = np.linspace(first + near, last - near, 5)
            assert all(_profile(case, x) > limit - GRID for x in between)
