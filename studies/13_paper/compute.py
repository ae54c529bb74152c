"""Slow part of the study: what can be checked of the paper's tables and no other study has.

Writes ``records/paper_checks.json``: what the initial guesses do before any fit, how large a
change of force errors as small as the paper's can make at all, how a search comes by the paper's
errors on its way, and what it costs to read equation 1 one-way instead of two-way.
"""

import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.largest import largest_by
from common.records import Row, rounded, study_knee, write_record
from other_studies import module_of

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.verbs.demo import parameter_error

GUESSES = module_of("02_initial_guess", "compute")
TABLES = module_of("02_initial_guess", "paper_tables")
# Simulations after which a search is looked at; the first is the first population.
CHECKPOINTS = (20, 50, 100, 200, 400)
SEEDS, DRAWS, DRAWS_SEED = 5, 300, 13
# Vertices of one surface instead of both: half the pressure at equal density of the meshes.
ONE_WAY = 0.5


class Watched:
    """A problem that remembers the best parameters seen after each simulation."""

    def __init__(self, problem: ik.calibrate.Problem) -> None:
        self._problem = problem
        self._best = np.inf
        self.parameters = problem.parameters
        self.best: list[ik.runs.Array] = []

    def residuals(self, theta: ik.runs.Array) -> ik.runs.Array:
        """The residuals at `theta`."""
        residuals = self._problem.residuals(theta)
        value = float(residuals @ residuals) if np.isfinite(residuals).all() else np.inf
        if value < self._best or not self.best:
            self._best = value
            self.best.append(np.array(theta))
        else:
            self.best.append(self.best[-1])
        return residuals

    def jacobian(self, theta: ik.runs.Array) -> ik.runs.Array:
        """Their derivatives."""
        return self._problem.jacobian(theta)


def main() -> None:
    """Compute all and write the record."""
    options = records.parsed_options(__file__, seeds=SEEDS, draws=DRAWS)
    knees = {name: study_knee(name) for name in GUESSES.KNEES}
    record = records.begun(
        options, knees, checkpoints=CHECKPOINTS, draws_seed=DRAWS_SEED, one_way_factor=ONE_WAY
    )
    with ik.runs.process_pool(options.workers) as executor:
        for name in knees:
            began = time.perf_counter()
            record["knees"][name] = {
                "before_any_fit": before_any_fit(name),
                "small_errors": small_errors(name, options.draws),
                "one_way": one_way(name),
                "course": course(name, options.seeds, executor),
                "smallest_step": smallest_step(name),
            }
            record["knees"][name]["seconds"] = rounded(time.perf_counter() - began, 3)
            write_record(options.record, record)
            print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)


def before_any_fit(knee: str) -> Row:
    """Kinematic errors and differences of tension at each initial guess itself."""
    its = GUESSES.setting(knee)
    return {
        start: rounded(GUESSES.errors(its, ik.calibrate.named_start(start, its.problem.parameters)))
        for start in GUESSES.STARTS[1:]
    }


def small_errors(knee: str, n: int) -> Row:
    """Largest difference of tension over parameter sets with the errors of the paper's first row.

    The absolute errors of the four ligaments have the mean and the standard deviation that its
    Table 3 gives for IG1; how they are spread over the ligaments, and their signs, are drawn.
    """
    its = GUESSES.setting(knee)
    generator = np.random.default_rng(DRAWS_SEED)
    rows = [GUESSES.errors(its, its.truth + drawn_error(generator, its)) for _ in range(n)]
    found: Row = rounded(
        {
            "n": n,
            "n_without_prediction": sum(row["n_not_converged"] > 0 for row in rows),
            "rmse_mm": max(row["rmse_mm"] for row in rows),
            "rmse_deg": max(row["rmse_deg"] for row in rows),
            **{
                key: np.nanmax([row[key] for row in rows], axis=0)
                for key in ("tension_by_flexion_N", "tension_by_scenario_N")
            },
        }
    )
    return found


def drawn_error(generator: np.random.Generator, its: Any) -> ik.runs.Array:
    """Errors of all parameters with the mean and sd of absolute values that Table 3 gives."""
    n = its.truth.size // 2
    drawn = np.empty((2, n))
    for row, (mean, sd) in zip(drawn, TABLES.PAPER_TABLE3["IG1"], strict=True):
        while True:
            sizes = generator.normal(size=n)
            sizes = mean + sd * (sizes - sizes.mean()) / sizes.std(ddof=1)
            if sizes.min() >= 0.0:
                break
        row[:] = sizes * generator.choice([-1.0, 1.0], size=n)
    return drawn.ravel()


def one_way(knee: str) -> Row:
    """A fit to data of the knee by a model whose contact is half as stiff, started at the truth."""
    its = GUESSES.setting(knee)
    law = ik.model.Cartilage()
    model = its.problem.model.with_effects([law])
    softness = np.array([np.log(ONE_WAY), 0.0])
    start = np.concatenate([its.truth, softness])
    problem = ik.LaxityResiduals(model=model, laxity=its.problem.laxity)
    ended = fit(problem, start, fixed=law.parameters.names)
    n = its.truth.size
    error = parameter_error(ended.theta[:n], its.truth)
    return {
        "before": soft_errors(its, model, start),
        "fitted": {
            **soft_errors(its, model, ended.theta),
            **rounded(
                {
                    "theta": ended.theta[:n],
                    "error_kN": error.stiffness_kN,
                    "error_pct": error.strain_pct,
                    "outcome": ended.outcome.value,
                    "n_simulations": ended.n_simulations,
                }
            ),
        },
    }


def soft_errors(its: Any, model: Any, theta: ik.runs.Array) -> Row:
    """Kinematic errors over the 63 trials and differences of tension of another model."""
    whole = model.with_protocol(its.model.protocol)
    prediction = whole.predict(theta, derivatives=False)
    measured = its.problem.laxity
    simulated = ik.Laxity(
        protocol=measured.protocol, coordinates=prediction.coordinates[: measured.n]
    )
    change = np.abs(simulated.coordinates - measured.coordinates)
    kinematic = ik.laxity_rmse(simulated, measured)
    differences = np.abs(
        ik.model.tensions_of(whole, prediction) - ik.model.tensions_of(its.model, its.at_truth)
    )
    row: Row = rounded(
        {
            "n_not_converged": int((~prediction.is_converged).sum()),
            "rmse_mm": kinematic.mm,
            "rmse_deg": kinematic.deg,
            "largest_mm": np.nanmax(change[:, ik.laxity.TRANSLATIONS]),
            "largest_deg": np.nanmax(change[:, ik.laxity.ROTATIONS]),
            "tension_by_scenario_N": largest_by(
                differences, ik.laxity.load_scenarios(whole.protocol), GUESSES.SCENARIOS
            ),
        }
    )
    return row


def course(knee: str, n_seeds: int, executor: ik.runs.Executor) -> Row:
    """Errors of the best set after so many simulations of the Complex method, by start and seed."""
    tasks = [(knee, start, seed) for start in GUESSES.STARTS for seed in range(n_seeds)]
    rows = list(executor.map(one_course, tasks))
    return {start: rows[i * n_seeds : (i + 1) * n_seeds] for i, start in enumerate(GUESSES.STARTS)}


def one_course(task: tuple[str, str, int]) -> Row:
    """One search."""
    knee, start, seed = task
    its = GUESSES.setting(knee)
    watched = Watched(its.problem)
    begin = ik.calibrate.named_start(start, its.problem.parameters)
    fit(watched, begin, method="complex", seed=seed, budget=CHECKPOINTS[-1])
    found = [watched.best[n - 1] for n in CHECKPOINTS]
    errors = [parameter_error(theta, its.truth) for theta in found]
    row: Row = rounded(
        {
            "seed": seed,
            "error_kN": [x.mean_kN for x in errors],
            "error_pct": [x.mean_pct for x in errors],
            "rmse_by_flexion": [GUESSES.errors(its, x)["rmse_by_flexion"] for x in found],
        },
        4,
    )
    return row


def smallest_step(knee: str) -> Row:
    """Least change of the angle that a moment works on, from one moment to the next [deg].

    On a stable branch of a model with an energy it is above zero: the angle grows with its moment
    by an entry on the diagonal of the inverse stiffness.
    """
    its = GUESSES.setting(knee)
    protocol, laxity = its.problem.laxity.protocol, its.problem.laxity
    least: Row = {}
    for load, column in (("internal_moment_Nm", "internal_deg"), ("varus_moment_Nm", "varus_deg")):
        steps = []
        for flexion in np.unique(protocol.flexion_deg):
            moments, angles = along(laxity, float(flexion), load, column)
            steps.append(float(np.diff(angles[np.argsort(moments)]).min()))
        least[column] = rounded(min(steps))
    return least


def along(
    laxity: ik.Laxity, flexion: float, load: str, column: str
) -> tuple[ik.runs.Array, ik.runs.Array]:
    """Values of one load at a flexion angle, no other load acting, and of one coordinate there."""
    loads = laxity.protocol.loads
    index = ik.laxity.LOADS.index(load)
    others = np.delete(loads, index, axis=1)
    chosen = (laxity.protocol.flexion_deg == flexion) & ~others.any(axis=1)
    place = ik.laxity.COORDINATES.index(column)
    return loads[chosen, index], laxity.coordinates[chosen, place]


if __name__ == "__main__":
    main()
