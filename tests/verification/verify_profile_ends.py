"""Ends of profile intervals on the knee against brute force, and what a profile costs."""

import argparse
from typing import Any

import numpy as np
from brute_force import BruteForceProfile
from coverage_replicates import DESIGNS, design_model, noisy_problem
from requirement_rows import Measure, Row, largest_of
from scipy.stats import chi2
from work_store import work_store

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import ParameterQuantity
from identknee.identify.profile.profile import profile
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array
from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map
from identknee.verbs.verb import knee_digest

KNEES = ("reference", "lenhart2015_stable")
DESIGN = next(design for design in DESIGNS if design.name == "seed63 at 0.5")
THRESHOLD = float(chi2.ppf(0.95, 1))
ERROR_BAR, SIMULATIONS_BAR = 0.1, 50
DENSE_STARTS = 24
# Of the deviance: a lower fit that would move an end by less than a thousandth of the half-width.
NEGLIGIBLE = 0.01
WORKERS = 2
SEED = (9, 0)


def measure(options: argparse.Namespace) -> Row:
    """Every end of the eight profiles of two knees with noisy data, and the simulations spent."""
    tasks = [(knee, i) for knee in KNEES for i in range(design_model(knee, DESIGN).parameters.n)]
    about = {x: knee_digest(design_model(x, DESIGN).knee) for x in KNEES}
    with work_store("profile_ends", about) as store, process_pool(WORKERS) as executor:
        brute = resumable_map(
            brute_force_ends, tasks, executor=executor, store=store, description="brute force"
        )
    measures, notes = [], []
    for knee in KNEES:
        found = [
            (task[1], ends) for task, ends in zip(tasks, brute, strict=True) if task[0] == knee
        ]
        some, said = _knee(knee, found)
        measures += some
        notes += said
    return Row(
        line="profiles of 8 parameters, seed63 at 0.5 mm/deg: ends within 0.1 % of the half-width "
        "of a brute-force multistart profile, <= 50 simulations per full profile",
        measures=measures,
        notes=[*notes, "brute force: scipy's least squares from 5 to 7 starts at every value"],
    )


def _problem(knee: str) -> tuple[LaxityResiduals, Array]:
    truth = tuple(design_model(knee, DESIGN).parameters.center.tolist())
    problem = noisy_problem(knee, DESIGN, truth, SEED)
    return problem, fit(problem, np.array(truth)).theta


def brute_force_ends(task: tuple[str, int]) -> dict[str, Any]:
    """Both ends of one parameter's interval, and how much lower more starts got there."""
    knee, index = task
    problem, optimum = _problem(knee)
    jacobian = problem.jacobian(optimum)
    sd = float(np.sqrt(np.linalg.inv(jacobian.T @ jacobian)[index, index]))
    searched = BruteForceProfile(problem, index, optimum)
    ends = [searched.end(direction, 0.5 * sd, THRESHOLD) for direction in (-1, 1)]
    lower = [searched.lower_at(x, DENSE_STARTS) for x in ends if np.isfinite(x)]
    return {"ends": ends, "lower_elsewhere": max(lower, default=0.0)}


def _knee(knee: str, brute: list[tuple[int, dict[str, Any]]]) -> tuple[list[Measure], list[str]]:
    problem, optimum = _problem(knee)
    parameters = problem.parameters
    errors, simulations, notes = [], [], []
    differently_open, lower = 0, 0
    for index, exact in brute:
        quantity = ParameterQuantity(parameters=parameters, name=parameters.names[index])
        found = profile(problem, optimum, quantity)
        ends = np.array([_number(found.lower, -np.inf), _number(found.upper, np.inf)])
        truth = np.array(exact["ends"])
        differently_open += int(np.sum(np.isfinite(ends) != np.isfinite(truth)))
        both = np.isfinite(ends) & np.isfinite(truth)
        half = 0.5 * np.ptp(truth) if both.all() else abs(truth[both] - optimum[index]).max()
        errors += (100.0 * abs(ends - truth)[both] / half).tolist()
        simulations.append(found.n_simulations)
        lower += exact["lower_elsewhere"] > NEGLIGIBLE
        notes.append(
            f"{knee}, {quantity.name}: {found.lower_status.value} {found.upper_status.value}, "
            f"{found.verdict.value}, {found.n_simulations} simulations, {len(found.values)} points"
        )
    return [
        largest_of(f"{knee}, error of an end", errors, "% of half-width", bar=ERROR_BAR),
        largest_of(f"{knee}, simulations a profile", simulations, "", bar=SIMULATIONS_BAR),
        Measure(
            what=f"{knee}, ends open here and closed there",
            value=differently_open,
            unit="",
            bar=0,
            count=2 * len(brute),
        ),
        Measure(
            what=f"{knee}, brute-force ends where {DENSE_STARTS} more starts went lower",
            value=lower,
            unit="",
            bar=0,
            count=len(brute),
        ),
    ], notes


def _number(end: float | None, if_open: float) -> float:
    return if_open if end is None else end
