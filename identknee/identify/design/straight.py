"""A problem and the trials that may be added, along straight lines about the best fit.

Where equilibria begin at measured poses, a small change of parameters may lead from one to another.
What a profile finds then hangs on these jumps; the slopes at the best fit do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identknee.calibrate.problem import Problem, with_nuisance_priors, without_priors
from identknee.identify.design.added_trials import Candidates
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StraightProblem:
    """Residuals at theta ``(m,)``, and their slopes ``(m, n)`` wherever they are asked for."""

    parameters: Parameters
    theta: Array
    at_theta: Array
    slopes: Array

    def residuals(self, theta: Array) -> Array:
        """Residuals, shape ``(m,)``."""
        return np.asarray(self.at_theta + self.slopes @ (theta - self.theta))

    def jacobian(self, theta: Array) -> Array:  # noqa: ARG002 - they are the same everywhere
        """Their derivatives, shape ``(m, n)``."""
        return self.slopes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StraightCandidates:
    """Values of all candidates at theta ``(k, m)``, and their slopes ``(k, m, n)``."""

    names: tuple[str, ...]
    theta: Array
    at_theta: Array
    slopes: Array

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """What the chosen trials would measure, and its derivatives, as the candidates do."""
        slopes = self.slopes[list(chosen)]
        return self.at_theta[list(chosen)] + slopes @ (theta - self.theta), slopes


def straight(
    problem: Problem, theta: Array, candidates: Candidates
) -> tuple[Problem, StraightCandidates]:
    """Both as they are at theta and along their slopes there, priors of nuisances as they are."""
    data = without_priors(problem)
    lines = StraightProblem(
        parameters=problem.parameters,
        theta=theta,
        at_theta=data.residuals(theta),
        slopes=data.jacobian(theta),
    )
    values, slopes = candidates.predict(theta, range(len(candidates.names)))
    offered = StraightCandidates(
        names=tuple(candidates.names), theta=theta, at_theta=values, slopes=slopes
    )
    return with_nuisance_priors(lines), offered
