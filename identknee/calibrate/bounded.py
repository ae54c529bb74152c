"""A problem with other bounds than its model's."""

from collections.abc import Mapping
from dataclasses import dataclass

from identknee.calibrate.problem import Problem
from identknee.calibrate.scales import floors
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bounded:
    """A problem whose parameters have bounds of their own.

    Attributes
    ----------
    problem
        The problem.
    parameters
        Its parameters with the bounds wanted.
    """

    problem: Problem
    parameters: Parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, shape ``(m,)``."""
        return self.problem.residuals(theta)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        return self.problem.jacobian(theta)


def with_bounds(problem: Problem, bounds: Mapping[str, tuple[float, float]]) -> Problem:
    """The same problem with other bounds for the parameters named.

    Raises
    ------
    ValueError
        If a name is no parameter's, or a lower bound is not below its upper bound or allows
        negative values of a parameter that cannot have them.
    """
    parameters = problem.parameters.with_bounds(bounds)
    for name, low, floor in zip(
        parameters.names, parameters.lower, floors(parameters), strict=True
    ):
        if low < floor:
            raise ValueError(f"the lower bound of {name} must be {floor:g} or more, got {low:g}")
    return Bounded(problem=problem, parameters=parameters)
