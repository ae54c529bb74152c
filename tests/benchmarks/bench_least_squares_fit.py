"""Seconds of a least-squares fit from the initial guess that is farthest off."""

import argparse
import time

from knees import model, noise_free
from requirement_rows import Row, median_of

from identknee.calibrate.fit import fit, named_start

RUNS = 20


def measure(options: argparse.Namespace) -> Row:
    """Seconds on the wall and of the processor."""
    measures, notes = [], []
    for name in ("reference", "lenhart2015_stable"):
        subject = model(name)
        problem = noise_free(subject)
        theta = named_start("IG4", subject.parameters)
        fit(problem, theta)
        wall, busy = [], []
        for _ in range(RUNS):
            began = time.process_time()
            end = fit(problem, theta)
            busy.append(time.process_time() - began)
            wall.append(end.seconds)
        measures += [
            median_of(f"{name}, IG4", wall, "s", bar=0.3),
            median_of(f"{name}, IG4, processor time", busy, "s"),
        ]
        notes.append(f"{name}: {end.n_simulations} simulations, {end.outcome.value}")
    return Row(line="least-squares fit from IG4 <= 0.3 s", measures=measures, notes=notes)
