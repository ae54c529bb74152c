"""Seconds of a Complex fit from each of the paper's initial guesses."""

import argparse
import time

from knees import model, noise_free
from requirement_rows import Row, median_of

from identknee.calibrate.fit import fit, named_start

SEEDS = range(3)
STARTS = ("IG1", "IG2", "IG3", "IG4")


def measure(options: argparse.Namespace) -> Row:
    """Seconds on the wall and of the processor, and what it did in them."""
    measures, notes = [], []
    for name in ("reference", "lenhart2015_stable"):
        subject = model(name)
        problem = noise_free(subject)
        problem.residuals(subject.parameters.center)
        for start in STARTS:
            wall, busy, simulations = [], [], []
            for seed in SEEDS:
                began = time.process_time()
                theta = named_start(start, subject.parameters)
                end = fit(problem, theta, method="complex", seed=seed)
                busy.append(time.process_time() - began)
                wall.append(end.seconds)
                simulations.append(end.n_simulations)
            measures += [
                median_of(f"{name}, {start}", wall, "s", bar=7.0),
                median_of(f"{name}, {start}, processor time", busy, "s"),
            ]
            notes.append(f"{name}, {start}: {min(simulations)} to {max(simulations)} simulations")
    return Row(line="Complex fit from an IG <= 7 s", measures=measures, notes=notes)
