"""Nested sampling as a second opinion on the posterior of the knee."""

import argparse

import numpy as np
from noisy_knees import noisy
from requirement_rows import Measure, Row

from identknee.identify.posterior.sample import nested_posterior, quantile_differences, sample
from identknee.runs.executors import process_pool

KNEES = ("reference",)
AGREEMENT = 3.0
WORKERS = 2


def measure(options: argparse.Namespace) -> Row:
    """Largest difference of a quantile in joint standard errors."""
    measures, notes = [], []
    for knee in KNEES:
        problem = noisy(knee)
        with process_pool(WORKERS) as executor:
            sampled = sample(problem, executor=executor, seed=1)
        nested = nested_posterior(problem, seed=1)
        differences = np.abs(quantile_differences(sampled, nested))
        measures.append(
            Measure(
                what=f"{knee}, largest difference of a 2.5, 50 or 97.5 % quantile",
                value=float(differences.max()),
                unit="joint standard errors",
                bar=AGREEMENT,
                low=float(differences.min()),
                high=float(differences.max()),
                count=differences.size,
                interval="min-max, the value is the largest",
            )
        )
        notes.append(
            f"{knee}: sample {sampled.outcome.value}, {sampled.n_simulations} simulations; nested "
            f"sampling {nested.n_simulations} simulations, {nested.effective_draws:.0f} effective "
            f"draws, log evidence {nested.log_evidence:.2f} +- {nested.log_evidence_error:.2f}"
        )
    return Row(
        line="marginals of the posterior by ensembles and by nested sampling (dynesty) differ by "
        "<= 3 Monte Carlo standard errors",
        measures=measures,
        notes=notes,
    )
