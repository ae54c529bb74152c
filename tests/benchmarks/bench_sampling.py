"""Effective draws from 1,000 simulations: stretch, differential evolution, and Newton moves."""

import argparse
from dataclasses import replace

import numpy as np
from noisy_knees import noisy
from problems import sloppy_springs
from requirement_rows import Measure, Row

from identknee.calibrate.problem import Problem
from identknee.identify.posterior.posterior import Posterior, StopRule
from identknee.identify.posterior.sample import Ensembles, sample

MOVES = ("stretch", "difference", "newton")
BAR = {"newton": 60.0, "difference": 20.0, "stretch": None}
# Of the first step after burn-in; what is measured is the price of a draw, not that of a gate.
SIMULATIONS = {"reference": 24_000, "lenhart2015_stable": 24_000, "sloppy springs": 100_000}
SPRINGS_NOISE = 0.02


def measure(options: argparse.Namespace) -> Row:
    """Fewest effective draws of a parameter, of the bulk and of the tails, by moves."""
    measures, notes = [], []
    for where, budget in SIMULATIONS.items():
        problem = _springs() if where == "sloppy springs" else noisy(where)
        for moves in MOVES:
            rule = StopRule(autocorrelation_times=np.inf, budget=budget)
            found = sample(problem, ensembles=Ensembles(moves=moves, steps=50), rule=rule, seed=1)
            bulk, tail = _draws(found)
            bar = BAR[moves] if where == "reference" else None
            measures += [
                Measure(
                    what=f"{where}, {moves}, bulk",
                    value=bulk,
                    unit="effective draws",
                    bar=bar,
                    at_least=True,
                ),
                Measure(what=f"{where}, {moves}, tails", value=tail, unit="effective draws"),
            ]
            notes.append(
                f"{where}, {moves}: tau {found.last_check.tau.max():.1f} of "
                f"{found.last_check.kept} kept "
                f"steps, acceptance {found.last_check.acceptance.mean():.2f}"
            )
    return Row(
        line="effective draws from 1,000 simulations, 8 parameters: >= 20, with gradients >= 60 "
        "(emcee's stretch move: 7.7 on a toy)",
        measures=measures,
        notes=notes,
    )


def _springs() -> Problem:
    springs = sloppy_springs(noise=SPRINGS_NOISE)
    return replace(
        springs,
        residuals_at=lambda theta: springs.residuals(theta) / SPRINGS_NOISE,
        jacobian_at=lambda theta: springs.jacobian(theta) / SPRINGS_NOISE,
    )


def _draws(found: Posterior) -> tuple[float, float]:
    """From 1,000 simulations of the steps kept."""
    gate = found.last_check
    spent = found.n_walk_simulations * gate.kept / gate.steps
    bulk, tail = (float(x.sum(axis=1).min()) for x in (gate.bulk, gate.tail))
    return 1000.0 * bulk / spent, 1000.0 * tail / spent
