"""Other tools asked what the conformance suite asks, each as its own tutorial would.

Both minimise half the deviance from the case's optimum first (pyPESTO from 16 more starts too).
A bound given back as an end is read as open: neither tool has a word for it.
"""

import logging
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from conformance.case import Answer, Case

from identknee.calibrate.problem import ParameterQuantity
from identknee.runs.declare import Array

N_STARTS = 16
# A deviance for where there is no prediction; these tools want numbers.
NO_PREDICTION = 1e12
# Of the box: what is still its bound, after a transformation of it.
AT_BOUND = 1e-9


class _Deviance:
    """Sum of squared residuals and its gradient, counting."""

    def __init__(self, case: Case) -> None:
        self._problem = case.problem
        self.n_simulations = 0

    def value(self, theta: Array) -> float:
        self.n_simulations += 1
        residuals = self._problem.residuals(np.asarray(theta, float))
        return float(residuals @ residuals) if np.isfinite(residuals).all() else NO_PREDICTION

    def gradient(self, theta: Array) -> Array:
        theta = np.asarray(theta, float)
        residuals = self._problem.residuals(theta)
        if not np.isfinite(residuals).all():
            return np.zeros(theta.size)
        return np.asarray(2.0 * self._problem.jacobian(theta).T @ residuals)


def _index(case: Case) -> int:
    if not isinstance(case.quantity, ParameterQuantity):
        raise NotImplementedError("no profiles of functions")
    return case.quantity.index


def iminuit_tool(case: Case) -> Answer:
    """MINOS of iminuit, after MIGRAD."""
    from iminuit import Minuit

    index = _index(case)
    parameters = case.problem.parameters
    deviance = _Deviance(case)
    with _quietly():
        minuit = Minuit(deviance.value, np.array(case.optimum), grad=deviance.gradient)
        minuit.errordef = 1.0
        minuit.limits = list(zip(parameters.lower, parameters.upper, strict=True))
        minuit.migrad()
        minuit.minos(index, cl=case.level)
    error = minuit.merrors[index]
    low, high = minuit.values[index] + error.lower, minuit.values[index] + error.upper
    doubts = {
        "fit not valid": not minuit.valid,
        "lower not valid": not error.lower_valid and not error.at_lower_limit,
        "upper not valid": not error.upper_valid and not error.at_upper_limit,
        "new minimum": error.lower_new_min or error.upper_new_min,
        "call limit": error.at_lower_max_fcn or error.at_upper_max_fcn,
    }
    ends = (
        -math.inf if error.at_lower_limit else _end(case, index, low),
        math.inf if error.at_upper_limit else _end(case, index, high),
    )
    return Answer(
        intervals=(ends,),
        warnings=tuple(what for what, is_so in doubts.items() if is_so),
        n_simulations=deviance.n_simulations,
    )


def pypesto_tool(case: Case) -> Answer:
    """pyPESTO's multistart, profile and approximate confidence interval."""
    import pypesto
    import pypesto.optimize
    import pypesto.profile

    index = _index(case)
    parameters = case.problem.parameters
    deviance = _Deviance(case)
    # Its thresholds are for minus the log likelihood.
    objective = pypesto.Objective(
        fun=lambda theta: 0.5 * deviance.value(theta),
        grad=lambda theta: 0.5 * deviance.gradient(theta),
    )
    with _quietly() as caught:
        problem = pypesto.Problem(
            objective=objective,
            lb=parameters.lower,
            ub=parameters.upper,
            x_guesses=np.array([case.optimum]),
        )
        optimizer = pypesto.optimize.ScipyOptimizer()
        result = pypesto.optimize.minimize(
            problem, optimizer=optimizer, n_starts=1 + N_STARTS, progress_bar=False
        )
        result = pypesto.profile.parameter_profile(
            problem,
            result,
            optimizer=optimizer,
            profile_index=np.array([index]),
            progress_bar=False,
        )
        found = result.profile_result.list[0][index]
        low, high = pypesto.profile.calculate_approximate_ci(
            xs=found.x_path[index, :], ratios=found.ratio_path, confidence_ratio=_ratio(case)
        )
    return Answer(
        intervals=((_end(case, index, low), _end(case, index, high)),),
        warnings=tuple(caught),
        n_simulations=deviance.n_simulations,
    )


def _ratio(case: Case) -> float:
    return math.exp(-0.5 * case.threshold)


def _end(case: Case, index: int, value: float) -> float:
    low, high = case.problem.parameters.lower[index], case.problem.parameters.upper[index]
    near = AT_BOUND * (high - low) if np.isfinite(high - low) else 0.0
    if value <= low + near:
        return -math.inf
    return math.inf if value >= high - near else float(value)


@contextmanager
def _quietly() -> Iterator[list[str]]:
    """What a tool warns of while it runs, in place of its output."""
    said: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("pypesto")
    propagates, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield said
            said += [str(x.message) for x in caught]
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagates
