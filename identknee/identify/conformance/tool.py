"""identknee's own profile as a tool for the conformance suite."""

import math

import numpy as np
from scipy.stats import qmc

from identknee.calibrate.fit import fit_many
from identknee.identify.conformance.case import Answer, Case
from identknee.identify.profile.profile import profile
from identknee.runs.arrays import Array

N_STARTS, BUDGET = 16, 100


def identknee_tool(case: Case) -> Answer:
    """The answer of `identknee.identify.profile.profile.profile` with its default settings.

    It is told the ends of sixteen fits from Sobol points of the box, as a user's sweep would tell
    it, where the box is bounded. Their simulations are counted.
    """
    ends, n_simulations = _ends_of_fits(case)
    found = profile(case.problem, case.optimum, case.quantity, level=case.level, starts=ends)
    return Answer(
        intervals=tuple(
            (-math.inf if low is None else low, math.inf if high is None else high)
            for low, high in found.intervals
        ),
        lower=found.lower_status.value,
        upper=found.upper_status.value,
        verdict=found.verdict.value,
        n_simulations=found.n_simulations + n_simulations,
    )


def _ends_of_fits(case: Case) -> tuple[Array, int]:
    parameters = case.problem.parameters
    width = parameters.upper - parameters.lower
    if not np.isfinite(width).all():
        return np.empty((0, parameters.n)), 0
    points = qmc.Sobol(parameters.n, seed=0).random(N_STARTS)
    fits = fit_many(case.problem, parameters.lower + points * width, budget=BUDGET)
    ends = [fit.theta for fit in fits if np.isfinite(fit.objective)]
    return np.reshape(ends, (-1, parameters.n)), sum(fit.n_simulations for fit in fits)
