"""Fits by the Complex method from the paper's initial guesses, and the limits they are held to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from knees import mean_errors, noise_free

from identknee.calibrate.fit import fit
from identknee.calibrate.starts import named_start
from identknee.laxity.table import laxity_rmse
from identknee.model.laxity_model import LaxityModel

STARTS = ("IG1", "IG2", "IG3", "IG4")
RECOVERABLE = ("IG1", "IG2", "IG3")
# Median mean-absolute error [kN, %].
LARGEST_ERROR = {"IG1": (0.40, 0.12), "IG2": (0.45, 0.15), "IG3": (1.0, 0.40)}
LARGEST_RMSE = (0.2, 0.4)  # mm, deg; of every run from a recoverable start
LARGEST_SHARE = 0.25  # of the start's RMSE, from IG2 and IG3
# From IG4 the laxity fits and the parameters do not, as the paper found.
IG4_RMSE = (1.0, 1.2)
IG4_LEAST_ERROR = 1.0  # kN


@dataclass(frozen=True, kw_only=True)
class Run:
    """One fit: mean absolute errors, RMSE of its laxity and of the start's, simulations."""

    start: str
    seed: int
    kN: float  # noqa: N815 - a unit
    percent: float
    mm: float
    deg: float
    start_mm: float
    start_deg: float
    n_simulations: int


def complex_runs(of: LaxityModel, starts: Sequence[str], seeds: Sequence[int]) -> list[Run]:
    """A fit of the model to its own laxity from every start with every seed."""
    problem = noise_free(of)
    runs = []
    for start in starts:
        theta = named_start(start, of.parameters)
        before = laxity_rmse(of.simulate(theta), problem.laxity)
        for seed in seeds:
            end = fit(problem, theta, method="complex", seed=seed)
            after = laxity_rmse(of.simulate(end.theta), problem.laxity)
            stiffness, strain = mean_errors(end.theta, of.parameters)
            runs.append(
                Run(
                    start=start,
                    seed=seed,
                    kN=stiffness,
                    percent=strain,
                    mm=after.mm,
                    deg=after.deg,
                    start_mm=before.mm,
                    start_deg=before.deg,
                    n_simulations=end.n_simulations,
                )
            )
    return runs


def values(runs: Sequence[Run], start: str, field: str) -> np.ndarray:
    """One number of every run from a start."""
    return np.array([getattr(run, field) for run in runs if run.start == start])
