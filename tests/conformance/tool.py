"""identknee's own profile as a tool for the conformance suite."""

import math

from conformance.case import Answer, Case
from identknee.calibrate.problem import Problem
from identknee.identify.profile.profile import profile_quantities
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array


def identknee_tool(case: Case) -> Answer:
    """The answer of `identknee.identify.profile.profile.profile_quantities`, left to itself.

    All its simulations are counted, those of the search for other optima among them.
    """
    problem = _Counted(case.problem)
    (found,) = profile_quantities(problem, case.optimum, [case.quantity], level=case.level)
    return Answer(
        intervals=tuple(
            (-math.inf if low is None else low, math.inf if high is None else high)
            for low, high in found.intervals
        ),
        lower=found.lower_status.value,
        upper=found.upper_status.value,
        verdict=found.verdict.value,
        n_simulations=problem.n_simulations,
    )


class _Counted:
    """A problem that counts how often it is asked; a Jacobian comes with its residuals."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.n_simulations = 0

    @property
    def parameters(self) -> Parameters:
        return self._problem.parameters

    def residuals(self, theta: Array) -> Array:
        self.n_simulations += 1
        return self._problem.residuals(theta)

    def jacobian(self, theta: Array) -> Array:
        return self._problem.jacobian(theta)
