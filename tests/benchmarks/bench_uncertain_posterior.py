"""Time to a sample over uncertain geometry, with two workers, and what its draws cost."""

import argparse
import time

from knees import model, own_laxity
from noisy_knees import NOISE, SEED
from rows import Measure, Row

import identknee as ik
from identknee.identify.posterior.sample import sample
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.executors import process_pool
from identknee.subject.knee import Uncertainty

WORKERS = 2
KNEES = ("reference", "lenhart2015_stable")
STATED = Uncertainty(insertions_mm=2.0, registration_deg=2.0, registration_mm=2.0)
BAR_MIN, BAR_DRAWS = 10.0, 100.0


def measure(options: argparse.Namespace) -> Row:
    """Minutes, and effective draws of each ligament parameter from 1,000 simulations."""
    measures, notes = [], []
    for name in KNEES:
        exact = model(name)
        laxity = ik.add_noise(own_laxity(exact), sd_mm=NOISE, sd_deg=NOISE, seed=SEED)
        uncertain = LaxityModel(
            knee=exact.knee.with_uncertainty(STATED), protocol=exact.protocol
        ).with_tests(laxity)
        problem = LaxityResiduals(model=uncertain, laxity=laxity, weighting="noise")
        problem.residuals(problem.parameters.center)
        began = time.perf_counter()
        with process_pool(WORKERS) as executor:
            found = sample(problem, executor=executor, seed=1)
        minutes = (time.perf_counter() - began) / 60.0
        check = found.last_check
        n_ligament = uncertain.n_ligament_parameters
        spent = found.n_walk_simulations * check.kept / check.steps
        draws = 1000.0 * float(check.bulk.sum(axis=1)[:n_ligament].min()) / spent
        where = f"{name}, {problem.parameters.n} parameters"
        measures += [
            Measure(what=f"{where}, full gate", value=minutes, unit="min", bar=BAR_MIN),
            Measure(
                what=f"{where}, conditions of the gate not met",
                value=sum(not met for _, _, met in check.conditions.values()),
                unit="",
                bar=0,
            ),
            Measure(
                what=f"{where}, fewest effective draws of a ligament parameter",
                value=draws,
                unit="in 1,000 simulations",
                bar=BAR_DRAWS,
                at_least=True,
            ),
        ]
        numbers = ", ".join(f"{k} {v:.4g}" for k, (v, _, _) in check.conditions.items())
        notes.append(
            f"{name}: {found.outcome.value} after {found.n_simulations} simulations, acceptance "
            f"{check.acceptance.mean():.2f}; {numbers}"
        )
    return Row(
        line="posterior over insertions 2 mm, frames 2 deg and 2 mm, 2 cores: <= 10 min to the "
        "full gate, >= 100 effective draws in 1,000 simulations "
        f"(seed63 at {NOISE:g} mm and deg)",
        measures=measures,
        notes=notes,
    )
