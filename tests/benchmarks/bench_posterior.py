"""Time to the full gate on the knee, with two workers."""

import argparse
import time

from noisy_knees import NOISE, noisy
from requirement_rows import Measure, Row

from identknee.identify.posterior.sample import sample
from identknee.runs.executors import process_pool

WORKERS = 2
BAR_MIN = {"reference": 5.0, "lenhart2015_stable": None}


def measure(options: argparse.Namespace) -> Row:
    """Minutes, and the numbers of the gate that was passed."""
    measures, notes = [], []
    for knee, bar in BAR_MIN.items():
        problem = noisy(knee)
        problem.residuals(problem.parameters.center)
        began = time.perf_counter()
        with process_pool(WORKERS) as executor:
            found = sample(problem, executor=executor, seed=1)
        minutes = (time.perf_counter() - began) / 60.0
        measures.append(Measure(what=f"{knee}, full gate", value=minutes, unit="min", bar=bar))
        measures.append(
            Measure(
                what=f"{knee}, conditions of the gate not met",
                value=sum(not met for _, _, met in found.last_check.conditions.values()),
                unit="",
                bar=0,
            )
        )
        numbers = ", ".join(f"{k} {v:.4g}" for k, (v, _, _) in found.last_check.conditions.items())
        notes.append(
            f"{knee}: {found.outcome.value} after {found.n_simulations} simulations; {numbers}"
        )
    return Row(
        line="posterior of the knee to the full gate, 2 cores: <= 15 min, with gradients <= 5 "
        f"(seed63 at {NOISE:g} mm and deg)",
        measures=measures,
        notes=notes,
    )
