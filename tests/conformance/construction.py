"""Shorter ways to write the cases down."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import chi2

from conformance.case import Case, Formula, Intervals
from identknee.calibrate.problem import ParameterQuantity, UserQuantity
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array

INF = math.inf
# Signed root of the deviance's rise at the end of a 95 % interval: 1.95996.
Z = math.sqrt(chi2.ppf(0.95, 1))
CLOSED, AT_BOUND, FLAT = "closed", "open_at_bound", "open_flat"
FEASIBILITY = "open_at_feasibility"
VERDICTS = {
    0: "identifiable",
    1: "one_sided",
    2: "practically_nonidentifiable",
}


def plain_parameters(*bounds: tuple[float, float]) -> Parameters:
    """Parameters ``x0.value``, ``x1.value``, ... within these bounds, their priors of no use."""
    lower, upper = np.array(bounds, dtype=np.float64).T
    n = len(bounds)
    return Parameters(
        names=tuple(f"x{i}.value" for i in range(n)),
        center=np.clip(np.zeros(n), lower, upper),
        lower=lower,
        upper=upper,
        prior_sd=np.ones(n),
        is_log=np.zeros(n, bool),
    )


def case(
    name: str,
    about: str,
    problem: Formula,
    optimum: Sequence[float] | Array,
    intervals: Intervals | list[tuple[float, float]],
    **others: object,
) -> Case:
    """A case about the first parameter, with the plainest of verdicts that its ends allow.

    An open end is expected to be `AT_BOUND` and a finite one `CLOSED`; `others` are attributes of
    the case that are to be different from that. Words for an end or the verdict may be given as
    one string with ``" or "`` between them.
    """
    parameters = problem.parameters
    ends = intervals[0][0], intervals[-1][1]
    lower, upper = (CLOSED if math.isfinite(end) else AT_BOUND for end in ends)
    n_open = sum(not math.isfinite(end) for end in ends)
    settings: dict[str, object] = {
        "quantity": ParameterQuantity(parameters=parameters, name=parameters.names[0]),
        "lower": lower,
        "upper": upper,
        "verdict": "multimodal" if len(intervals) > 1 else VERDICTS[n_open],
    }
    settings.update(others)
    for words in ("lower", "upper", "verdict"):
        settings[words] = frozenset(str(settings[words]).split(" or "))
    return Case(
        name=name,
        about=about,
        problem=problem,
        optimum=np.asarray(optimum, dtype=np.float64),
        intervals=tuple(intervals),
        **settings,  # type: ignore[arg-type]
    )


def single(
    residual: Callable[[float], float],
    slope: Callable[[float], float],
    bounds: tuple[float, float] = (-10.0, 10.0),
) -> Formula:
    """A problem of one residual and one parameter."""
    return Formula(
        parameters=plain_parameters(bounds),
        residuals_at=lambda theta: [residual(float(theta[0]))],
        jacobian_at=lambda theta: [[slope(float(theta[0]))]],
    )


def linear(matrix: Array, data: Array, *bounds: tuple[float, float]) -> Formula:
    """The problem with residuals ``matrix @ theta - data``."""
    return Formula(
        parameters=plain_parameters(*bounds),
        residuals_at=lambda theta: matrix @ theta - data,
        jacobian_at=lambda _: matrix,
    )


def function(name: str, value: Callable[[Array], float]) -> UserQuantity:
    """A function of theta to ask about, without derivatives."""
    return UserQuantity(name=name, unit="", function=value)
