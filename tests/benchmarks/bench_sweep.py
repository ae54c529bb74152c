"""Minutes that sweeps take on two cores, and whether a start costs the same when there are more."""

import argparse
import resource
import time

import numpy as np
from knees import model, noise_free
from requirement_rows import Measure, Row

from identknee.calibrate.problem import Problem
from identknee.identify.sweep import SweepSearches, shell_starts, split_into_tenths, sweep
from identknee.runs.executors import process_pool

WORKERS = 2
DISTANCES = (0.5, 1.0, 2.0, 3.0, 4.5)
N_LEAST_SQUARES, N_COMPLEX, N_COMPLEX_MADE = 10_000, 500, 20
MOST_LEAST_SQUARES_S, MOST_COMPLEX_S = 20 * 60.0, 60 * 60.0
# Later starts over earlier ones: the sd of a start's time is about its mean, the tenths hold 1,000.
MOST_GROWTH = 1.1


def measure(options: argparse.Namespace) -> Row:
    """All of the least-squares starts; of Complex a few, whose time is multiplied."""
    problem = noise_free(model("reference"))
    exact, exact_s = timed(problem, "least-squares", N_LEAST_SQUARES)
    simplex, simplex_s = timed(problem, "complex", N_COMPLEX_MADE)
    parts = [float(x.mean()) for x in split_into_tenths(exact.seconds)]
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000.0
    measures = [
        Measure(
            what=f"{N_LEAST_SQUARES} least-squares starts, {WORKERS} workers",
            value=exact_s,
            unit="s",
            bar=MOST_LEAST_SQUARES_S,
        ),
        Measure(
            what=f"{N_COMPLEX} Complex starts, from {N_COMPLEX_MADE}",
            value=simplex_s * N_COMPLEX / N_COMPLEX_MADE,
            unit="s",
            bar=MOST_COMPLEX_S,
        ),
        Measure(
            what="time of the last fifth of starts over that of the first",
            value=sum(parts[-2:]) / sum(parts[:2]),
            unit="",
            bar=MOST_GROWTH,
            low=min(parts) / float(np.mean(parts)),
            high=max(parts) / float(np.mean(parts)),
            count=len(parts),
            interval="least and most expensive tenth over the mean",
        ),
    ]
    notes = [
        str(exact),
        str(simplex),
        f"most memory of the main process {memory_mb:.0f} MB",
        "all 500 Complex starts: studies/03_basin_of_attraction",
    ]
    line = "sweep of 10,000 least-squares starts <= 20 min, 500 Complex starts <= 60 min"
    return Row(line=f"{line}; cost per start constant", measures=measures, notes=notes)


def timed(problem: Problem, method: str, n: int) -> tuple[SweepSearches, float]:
    """A sweep on shells around the subject's own values, and its seconds."""
    parameters = problem.parameters
    starts = shell_starts(parameters, n, center=parameters.center, distances=DISTANCES)
    with process_pool(WORKERS) as executor:
        began = time.perf_counter()
        found = sweep(problem, starts, method=method, executor=executor)
        return found, time.perf_counter() - began
