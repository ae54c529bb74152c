"""Slow part of the study: all optimizers from the same starts under one budget.

Writes ``records/optimizers.json``. Finished searches are kept in stores outside the checkout, so
that the same command resumes where it was stopped.
"""

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from identknee.calibrate.fit import BUDGET, METHODS, fit
from identknee.calibrate.starts import named_start
from identknee.identify.sweep.starts_design import distance, shell_starts, unit_groups
from identknee.identify.sweep.sweep import kind_of_end, search_seed
from identknee.laxity.protocol import load_protocol
from identknee.laxity.rmse import laxity_rmse
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.report.study_records import (
    knee_digest,
    record_head,
    rounded,
    study_knee,
    write_record,
)
from identknee.runs.arrays import Array
from identknee.runs.executors import Executor, process_pool
from identknee.runs.files import digest
from identknee.runs.outcome import Outcome
from identknee.runs.resume import open_work, resumable_map
from identknee.subject.knee import Knee

HERE = Path(__file__).parent
RECORD = HERE / "records" / "optimizers.json"
COMMAND = "python studies/09_optimizers/compute.py"
TRUTH = "IG1"  # Table 1 of the paper: its first initial guess is the reference itself.
GUESSES = ("IG1", "IG2", "IG3", "IG4")
# kN and %, as the paper counts the distance of its guesses.
DISTANCES = (1.0, 2.0, 3.0, 4.5)
# Seeds a guess, and starts on each shell.
NUMBERS = {"reference": (2, 2), "lenhart2015_stable": (1, 1)}
SEED = 9
# Simulations at which the best objective so far is kept.
COUNTS = (1, 3, 5, 7, 10, 15, 20, 40, 70, 100, 150, 200, 300, 400, 600, 800, 1000, 1500, 2000, 2500)
Row = dict[str, Any]


def main() -> None:
    """Compute what the stores do not hold yet and write the record."""
    options = parsed_options()
    knees = {name: study_knee(name) for name in NUMBERS}
    record: Row = {
        "head": record_head(
            f"{COMMAND} --workers {options.workers}",
            settings={
                "workers": options.workers,
                "budget": options.budget,
                "numbers": NUMBERS,
                "distances": DISTANCES,
                "seed": SEED,
                "quick": options.quick,
            },
            inputs={name: knee_digest(knee) for name, knee in knees.items()},
        ),
        "knees": {},
    }
    with process_pool(options.workers) as executor:
        for name, knee in knees.items():
            problem = problem_of(knee)
            part = record["knees"][name] = described(problem)
            for method in METHODS:
                part["methods"][method] = searched(name, problem, method, options, executor)
                write_record(options.record, record)
                say(f"{name}: {method}")
    say(f"written: {options.record.name}")


def parsed_options() -> argparse.Namespace:
    """What was asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    store = platformdirs.user_cache_path("identknee") / "studies" / "optimizers"
    parser.add_argument("--store", type=Path, default=store, help="folder of finished searches")
    parser.add_argument("--record", type=Path, default=RECORD, help="the file to write")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--budget", type=int, default=BUDGET, help="simulations a search")
    parser.add_argument("--quick", action="store_true", help="one seed and one shell only")
    return parser.parse_args()


def problem_of(knee: Knee) -> LaxityResiduals:
    """The 63 trials simulated at the true parameters, without noise, in mm and deg."""
    model = LaxityModel(knee=knee, protocol=load_protocol("seed63"))
    truth = named_start(TRUTH, model.parameters)
    return LaxityResiduals(model=model, laxity=model.simulate(truth))


def described(problem: LaxityResiduals) -> Row:
    """Names and truth of a knee, and room for its methods."""
    truth = named_start(TRUTH, problem.parameters)
    return {"parameters": problem.parameters.names, "truth": rounded(truth), "methods": {}}


def starts_of(problem: LaxityResiduals, knee: str, *, quick: bool) -> tuple[list[str], Array]:
    """Name and theta of every start, the same for all methods, shape ``(n, p)``."""
    parameters = problem.parameters
    seeds, a_shell = (1, 1) if quick else NUMBERS[knee]
    distances = DISTANCES[:1] if quick else DISTANCES
    shells = shell_starts(
        parameters,
        a_shell * len(distances),
        center=named_start(TRUTH, parameters),
        distances=distances,
        seed=SEED,
    )
    guesses = [named_start(x, parameters) for x in GUESSES for _ in range(seeds)]
    names = [x for x in GUESSES for _ in range(seeds)]
    names += [f"shell {x:g}" for _ in range(a_shell) for x in distances]
    return names, np.vstack([guesses, shells])


def searched(
    knee: str,
    problem: LaxityResiduals,
    method: str,
    options: argparse.Namespace,
    executor: Executor,
) -> list[Row]:
    """A row for each start, those in the store not computed again."""
    names, starts = starts_of(problem, knee, quick=options.quick)
    about = {
        "knee": knee_digest(problem.model.knee),
        "numbers": fingerprint(problem, method),
        "method": method,
        "budget": options.budget,
        "starts": digest(starts.tobytes()),
    }
    items = [(i, names[i], starts[i].tolist()) for i in range(len(names))]
    path = options.store / f"{knee}_{method}{'_quick' * options.quick}.sqlite"
    with open_work(path, about) as store:
        task = partial(search_row, problem, method, options.budget)
        return resumable_map(task, items, executor=executor, store=store)


def search_row(
    problem: LaxityResiduals, method: str, budget: int, item: tuple[int, str, Any]
) -> Row:
    """One search, what is at its end, and where least squares goes on to from there."""
    number, name, start = item
    truth = named_start(TRUTH, problem.parameters)
    end = fit(problem, start, method=method, seed=search_seed(SEED, number), budget=budget)
    kind = kind_of_end(problem, end)
    failed = end.outcome is Outcome.START_FAILED
    polished = end if failed else fit(problem, end.theta, seed=number)
    groups = unit_groups(problem.parameters)
    error = np.abs(end.theta - truth)
    simulated = problem.model.simulate(end.theta)
    rmse = laxity_rmse(simulated, problem.laxity)
    row: Row = rounded(
        {
            "start": name,
            "start_distance": float(distance(start, truth, problem.parameters)),
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


def best_after(history: Array, n: int) -> float:
    """Best objective within the first `n` simulations; infinite before the first prediction."""
    seen = history[history[:, 0] <= n, 1]
    return float(seen[-1]) if seen.size else np.inf


def fingerprint(problem: LaxityResiduals, method: str) -> str:
    """Digest of what a short search gives: code that gives other numbers has another one."""
    start = named_start("IG4", problem.parameters)
    end = fit(problem, start, method=method, seed=SEED, budget=60)
    return digest(str(rounded([*end.theta, end.objective, end.n_simulations], 8)).encode())


def say(text: str) -> None:
    """Tell how far it is."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


if __name__ == "__main__":
    main()
