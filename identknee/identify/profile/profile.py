"""The profile of a parameter or of any other quantity: which of its values the data allow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.constrained import minimise
from identknee.calibrate.evaluation import Evaluation, Evaluator
from identknee.calibrate.problem import Problem
from identknee.calibrate.quantity import Quantity
from identknee.identify.detours import fit_around
from identknee.identify.profile.result import Profile
from identknee.identify.profile.search import (
    Branch,
    branches_of_a_constant,
    find_branches,
    walk_branch,
)
from identknee.identify.profile.thresholds import chi2_threshold
from identknee.identify.profile.verdict import assembled
from identknee.identify.profile.walk import BetterFound, Walk
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome

LEVEL = 0.95
BUDGET = 1000
MOST_RESTARTS = 5
# Of the deviance: what the optimum may still promise.
OPTIMUM_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Settled:
    """An optimum polished as profiles want it, from `settled`.

    Attributes
    ----------
    theta
        Where it is, shape ``(n,)``.
    """

    theta: Array


def profile(
    problem: Problem,
    optimum_theta: ArrayLike | Settled,
    quantity: Quantity,
    *,
    level: float = LEVEL,
    threshold: float | None = None,
    budget: int = BUDGET,
    starts: ArrayLike = (),
) -> Profile:
    """The best fit at each value of a quantity, and the set of values that the data do not exclude.

    The optimum is polished first. From it the profile is walked outward on both sides; then a fit
    far beyond each end looks for another valley and approaches the end from there. A better fit
    met anywhere starts everything over from it, at most five times.

    That looks along the quantity only. Optima in which other parameters exchange their roles are
    found from `starts` alone; `identknee.identify.profile.profiles.profile_quantities` looks for
    them by itself.

    Parameters
    ----------
    problem
        Residuals in units of their noise.
    optimum_theta
        The best fit known, shape ``(n,)``. What `settled` makes of it is not polished again.
    quantity
        What to profile: a parameter or any function of theta.
    level
        Confidence level of the set.
    threshold
        Rise of the deviance that bounds it; that of the chi-squared law if None. See
        `identknee.identify.profile.thresholds` for unknown noise and for few data.
    budget
        Simulations allowed.
    starts
        Other local optima, or places to look for them from, shape ``(k, n)``: for example the
        basins of a sweep, or `identknee.identify.profile.profiles.other_optima`. Where one is
        likely, its own path counts too; at most twelve paths are walked.

    Raises
    ------
    ValueError
        If the level, the threshold or the budget is not one possible, or the model has no
        prediction at the optimum.
    """
    likely = chi2_threshold(level)
    threshold = likely if threshold is None else threshold
    if not 0.0 < threshold < np.inf:
        raise ValueError(f"the threshold must be positive and finite, got {threshold:g}")
    if budget < 1:
        raise ValueError(f"the budget must be at least 1 simulation, got {budget}")
    run = _Run(
        evaluator=Evaluator(problem, budget=budget),
        quantity=quantity,
        level=level,
        threshold=threshold,
        starts=np.reshape(np.asarray(starts, dtype=np.float64), (-1, problem.parameters.n)),
    )
    if isinstance(optimum_theta, Settled):
        return run.profile(run.evaluator(optimum_theta.theta))
    theta = np.asarray(optimum_theta, dtype=np.float64)
    return run.profile(_settled(run.evaluator, theta, threshold))


def settled(
    problem: Problem, optimum_theta: ArrayLike, *, threshold: float, budget: int = BUDGET
) -> Settled:
    """The optimum polished, as profiles begin from it: once for several of them.

    Parameters
    ----------
    problem, optimum_theta, threshold, budget
        As for `profile`.

    Raises
    ------
    ValueError
        If the model has no prediction at the optimum.
    """
    theta = np.asarray(optimum_theta, dtype=np.float64)
    return Settled(theta=_settled(Evaluator(problem, budget=budget), theta, threshold).theta)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Run:
    """The settings of one profile."""

    evaluator: Evaluator
    quantity: Quantity
    level: float
    threshold: float
    starts: Array

    def profile(self, optimum: Evaluation) -> Profile:
        for n_restarts in range(MOST_RESTARTS + 1):
            walk = Walk(self.evaluator, self.quantity, self.threshold, optimum)
            is_last = n_restarts == MOST_RESTARTS
            walk.is_final = is_last
            try:
                branches = self._branches(walk, optimum.theta)
            except BetterFound as found:
                optimum = _settled(self.evaluator, found.theta, self.threshold)
                continue
            return assembled(
                walk,
                branches,
                level=self.level,
                better_optimum=optimum.theta if n_restarts else None,
                n_restarts=n_restarts,
            )
        raise AssertionError  # pragma: no cover - the last round meets nothing better

    def _branches(self, walk: Walk, theta: Array) -> list[Branch]:
        value, gradient = self.quantity.evaluate(theta)
        origin = walk.point(walk.solve(value, theta, tolerance=np.inf))
        if not gradient.any():
            return branches_of_a_constant(walk, origin)
        return find_branches(walk, walk_branch(walk, origin), self.starts)


def _settled(evaluator: Evaluator, theta: Array, threshold: float) -> Evaluation:
    optimum = minimise(evaluator, theta, tolerance=OPTIMUM_TOLERANCE)
    if optimum.outcome is Outcome.START_FAILED:
        raise ValueError(
            "the model has no prediction at the optimum given; fit it first, or profile from "
            "another parameter set"
        )
    if optimum.outcome is Outcome.CLIFF:
        around = fit_around(
            evaluator,
            optimum.evaluation,
            quantity=None,
            target=np.nan,
            rise=threshold,
            tolerance=OPTIMUM_TOLERANCE,
        )
        if around is not None and around.evaluation.deviance < optimum.evaluation.deviance:
            return around.evaluation
    return optimum.evaluation
