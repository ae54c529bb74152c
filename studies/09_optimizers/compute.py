"""Slow part of the study: all optimizers from the same starts under one budget.

Writes ``records/optimizers.json``. Finished searches are kept in stores outside the checkout, so
that the same command resumes where it was stopped.
"""

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.problems import exact_problem, model_of, truth_of
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.calibrate.fit import fit

GUESSES = ("IG1", "IG2", "IG3", "IG4")
# kN and %, as the paper counts the distance of its guesses.
DISTANCES = (1.0, 2.0, 3.0, 4.5)
# Seeds a guess, and starts on each shell.
NUMBERS = {"reference": (2, 2), "lenhart2015_stable": (1, 1)}
SEED = 9
# Simulations at which the best objective so far is kept.
COUNTS = (1, 3, 5, 7, 10, 15, 20, 40, 70, 100, 150, 200, 300, 400, 600, 800, 1000, 1500, 2000, 2500)


def main() -> None:
    """Compute what the stores do not hold yet and write the record."""
    options = records.parsed_options(
        __file__, "one seed and one shell only", budget=ik.calibrate.BUDGET
    )
    knees = {name: study_knee(name) for name in NUMBERS}
    record = records.begun(options, NUMBERS, numbers=NUMBERS, distances=DISTANCES, seed=SEED)
    with ik.runs.process_pool(options.workers) as executor:
        for name, knee in knees.items():
            problem = problem_of(knee)
            part = record["knees"][name] = described(problem)
            for method in ik.calibrate.METHODS:
                part["methods"][method] = searched(name, problem, method, options, executor)
                write_record(options.record, record)
                records.say(f"{name}: {method}")
    records.say(f"written: {options.record.name}")


def problem_of(knee: ik.Knee) -> ik.LaxityResiduals:
    """The data of a knee without noise."""
    return exact_problem(model_of(knee))


def described(problem: ik.LaxityResiduals) -> Row:
    """Names and truth of a knee, and room for its methods."""
    truth = truth_of(problem.parameters)
    return {"parameters": problem.parameters.names, "truth": rounded(truth), "methods": {}}


def starts_of(
    problem: ik.LaxityResiduals, knee: str, *, quick: bool
) -> tuple[list[str], ik.runs.Array]:
    """Name and theta of every start, the same for all methods, shape ``(n, p)``."""
    parameters = problem.parameters
    seeds, a_shell = (1, 1) if quick else NUMBERS[knee]
    distances = DISTANCES[:1] if quick else DISTANCES
    shells = ik.identify.shell_starts(
        parameters,
        a_shell * len(distances),
        center=truth_of(parameters),
        distances=distances,
        seed=SEED,
    )
    guesses = [ik.calibrate.named_start(x, parameters) for x in GUESSES for _ in range(seeds)]
    names = [x for x in GUESSES for _ in range(seeds)]
    names += [f"shell {x:g}" for _ in range(a_shell) for x in distances]
    return names, np.vstack([guesses, shells])


def searched(
    knee: str,
    problem: ik.LaxityResiduals,
    method: str,
    options: argparse.Namespace,
    executor: ik.runs.Executor,
) -> list[Row]:
    """A row for each start, those in the store not computed again."""
    names, starts = starts_of(problem, knee, quick=options.quick)
    about = {
        "knee": records.knee_digest(problem.model.knee),
        "numbers": fingerprint(problem, method),
        "method": method,
        "budget": options.budget,
        "starts": ik.runs.digest(starts.tobytes()),
    }
    items = [(i, names[i], starts[i].tolist()) for i in range(len(names))]
    path = options.store / f"{knee}_{method}{'_quick' * options.quick}.sqlite"
    with ik.runs.open_work(path, about) as store:
        task = partial(search_row, problem, method, options.budget)
        return ik.runs.resumable_map(task, items, executor=executor, store=store)


def search_row(
    problem: ik.LaxityResiduals, method: str, budget: int, item: tuple[int, str, Any]
) -> Row:
    """One search, what is at its end, and where least squares goes on to from there."""
    number, name, start = item
    truth = truth_of(problem.parameters)
    end = fit(
        problem, start, method=method, seed=ik.identify.search_seed(SEED, number), budget=budget
    )
    kind = ik.identify.classify_end(problem, end)
    failed = end.outcome is ik.Outcome.START_FAILED
    polished = end if failed else fit(problem, end.theta, seed=number)
    groups = ik.identify.unit_groups(problem.parameters)
    error = np.abs(end.theta - truth)
    simulated = problem.model.simulate(end.theta)
    rmse = ik.laxity_rmse(simulated, problem.laxity)
    row: Row = rounded(
        {
            "start": name,
            "start_distance": float(ik.identify.distance(start, truth, problem.parameters)),
            "theta": end.theta,
            "error_kN": float(error[groups == 0].mean()),
            "error_pct": float(error[groups == 1].mean()),
            "objective": end.objective,
            "rmse_mm": rmse.mm,
            "rmse_deg": rmse.deg,
            "outcome": end.outcome.value,
            "kind": kind.value,
            "polished": polished.outcome.value,
            "polished_error": float(np.abs(polished.theta - truth).max()),
            "n_simulations": end.n_simulations,
            "n_polishing": 0 if failed else polished.n_simulations,
            "seconds": end.seconds,
            "best_after": [best_after(end.history, n) for n in COUNTS],
        },
        5,
    )
    return row


def best_after(history: ik.runs.Array, n: int) -> float:
    """Best objective within the first `n` simulations; infinite before the first prediction."""
    seen = history[history[:, 0] <= n, 1]
    return float(seen[-1]) if seen.size else np.inf


def fingerprint(problem: ik.LaxityResiduals, method: str) -> str:
    """Digest of what a short search gives: code that gives other numbers has another one."""
    start = ik.calibrate.named_start("IG4", problem.parameters)
    end = fit(problem, start, method=method, seed=SEED, budget=60)
    return ik.runs.digest(str(rounded([*end.theta, end.objective, end.n_simulations], 8)).encode())


if __name__ == "__main__":
    main()
