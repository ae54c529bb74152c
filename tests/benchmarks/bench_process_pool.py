"""Least-squares fits of a knee by two processes beside one, kernel on one thread in both."""

import argparse
import time
from functools import partial
from typing import Any

import numpy as np
from knees import model
from requirement_rows import Row, median_of

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import Problem
from identknee.laxity.table import add_noise
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array
from identknee.runs.executors import Executor, process_pool, serial
from identknee.runs.store import resumable_map

STARTS, REPEATS, BAR = 100, 5, 1.7


def measure(options: argparse.Namespace) -> Row:
    """How many times as fast the pool is, in pairs measured one after the other."""
    subject = model("reference")
    parameters = subject.parameters
    laxity = add_noise(subject.simulate(parameters.center), sd_mm=0.5, sd_deg=0.5, seed=0)
    problem = LaxityResiduals(model=subject, laxity=laxity, weighting="noise")
    rng = np.random.default_rng(0)
    share = np.where(parameters.is_log, 0.25 * parameters.center, 3.0)
    starts = parameters.center + share * rng.uniform(-1.0, 1.0, (STARTS, parameters.n))
    alone, together, ratios = [], [], []
    with process_pool(2) as pool:
        # Workers begin, load the problem and the compiled kernel.
        expected, _ = _timed(problem, starts[:8], pool)
        for _ in range(REPEATS):
            expected, seconds = _timed(problem, starts, serial)
            found, pooled = _timed(problem, starts, pool)
            if found != expected:
                raise AssertionError("two processes found other bits than one")
            alone.append(seconds)
            together.append(pooled)
            ratios.append(seconds / pooled)
    return Row(
        line="process pool of 2 against serial (kernel threads = 1 in both) >= 1.7, bit-equal",
        measures=[
            median_of(
                "serial / pool of 2, time on the wall", ratios, "times", bar=BAR, at_least=True
            ),
            median_of(f"{STARTS} least-squares starts, serial", alone, "s"),
            median_of(f"{STARTS} least-squares starts, pool of 2", together, "s"),
        ],
        notes=[f"all {STARTS} end points equal bit for bit in each of {REPEATS} repeats"],
    )


def end_point(problem: Problem, start: Array) -> dict[str, Any]:
    """Where a fit ends, all that must be equal."""
    end = fit(problem, start)
    return {
        "theta": end.theta,
        "objective": end.objective,
        "outcome": end.outcome,
        "n_simulations": end.n_simulations,
    }


def _timed(problem: Problem, starts: Array, executor: Executor) -> tuple[list[Any], float]:
    began = time.perf_counter()
    found = resumable_map(partial(end_point, problem), list(starts), executor=executor)
    return found, time.perf_counter() - began
