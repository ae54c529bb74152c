"""Proportion of the posterior mass for which the model has no equilibrium."""

import numpy as np

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.problem import Problem
from identknee.identify.posterior.density import newton_kernel
from identknee.identify.shares import Share, share
from identknee.runs.arrays import Array
from identknee.runs.findings import Finding, Severity

N_DRAWS = 100
# Share of the draws without prediction that is worth a word.
NOTEWORTHY = 0.02


def share_without_prediction(
    problem: Problem, theta: Array, *, n_draws: int = N_DRAWS, seed: int = 0
) -> Share:
    """Proportion of parameter sets near `theta` in fit that have no prediction.

    They are drawn from the normal density around theta whose precision is that of the data and the
    priors, within the bounds.

    Parameters
    ----------
    problem
        Residuals in units of their noise.
    theta
        A parameter set with a prediction, shape ``(n,)``.
    n_draws
        Number of draws, one simulation each.
    seed
        Seed of the draws.

    Raises
    ------
    ValueError
        If the model has no prediction at `theta`.
    """
    parameters = problem.parameters
    evaluation = evaluate(problem, theta)
    if not evaluation.is_finite:
        raise ValueError("the model has no prediction at these parameters; fit them first")
    kernel = newton_kernel(evaluation, parameters)
    draws = np.random.default_rng(seed).standard_normal((n_draws, parameters.n))
    steps = np.linalg.solve(kernel.factor.T, draws.T).T
    thetas = parameters.from_working(parameters.to_working(evaluation.theta) + steps)
    inside = np.clip(thetas, parameters.lower, parameters.upper)
    lost = sum(not np.isfinite(problem.residuals(x)).all() for x in inside)
    return share(lost, n_draws)


def feasibility_findings(problem: Problem, theta: Array) -> tuple[Finding, ...]:
    """Whether the feasibility boundary, not the data, limits intervals near a fit."""
    lost = share_without_prediction(problem, theta)
    if lost.value < NOTEWORTHY:
        return ()
    sentence = (
        f"Of {lost.n} parameter sets that would fit about as well as the best one, {lost.count} "
        "have no prediction in some trial: sets that the data allow are missing here because the "
        "model ends, not because the data exclude them. See: identknee subject check"
    )
    return (Finding(severity=Severity.WARNING, sentence=sentence, where="model"),)
