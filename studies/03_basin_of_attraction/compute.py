"""Slow part of the study: sweeps of starts by least squares and Complex, and the cliffs between.

Writes ``records/basin_of_attraction.json``. Finished searches are kept in stores outside the
checkout, so that the same command resumes where it was stopped.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from identknee.calibrate.fit import fit
from identknee.calibrate.starts import named_start
from identknee.identify.starts_design import shell_starts, sobol_starts
from identknee.identify.sweep import Sweep, sweep
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.report.study_records import knee_digest, rounded, study_knee
from identknee.runs.arrays import Array
from identknee.runs.executors import Executor, process_pool
from identknee.runs.files import digest
from identknee.runs.resume import open_work
from identknee.subject.knee import Knee

HERE = Path(__file__).parent
RECORD = HERE / "records" / "basin_of_attraction.json"
COMMAND = "python studies/03_basin_of_attraction/compute.py"
TRUTH = "IG1"  # Table 1 of the paper: its first initial guess is the reference itself.
GUESSES = ("IG1", "IG2", "IG3", "IG4")
# kN and %: as the paper counts the distance of its guesses, which are at 0, 0.5, 1.25 and 3.6.
DISTANCES = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.6, 4.5, 6.0)
SEED = 3
Row = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One sweep of the study: which starts, by which optimizer, how many on each knee.

    Attributes
    ----------
    name
        In the record.
    design
        ``"shells"`` around the truth, ``"bounds"`` for Sobol points, ``"guesses"`` for the paper's
        initial guesses, each with as many seeds.
    method
        The optimizer.
    numbers
        How many starts on each knee; seeds a guess for ``"guesses"``.
    """

    name: str
    design: str
    method: str
    numbers: dict[str, int]


KNEES = ("reference", "lenhart2015_stable", "lenhart2015")


def part(name: str, design: str, method: str, *numbers: int) -> Part:
    """A part with its numbers in the order of `KNEES`."""
    of_knee = dict(zip(KNEES, numbers, strict=True))
    return Part(name=name, design=design, method=method, numbers=of_knee)


PARTS = (
    part("shells_least_squares", "shells", "least-squares", 10_000, 2000, 300),
    part("bounds_least_squares", "bounds", "least-squares", 10_000, 2000, 300),
    part("guesses_complex", "guesses", "complex", 20, 4, 4),
    part("shells_complex", "shells", "complex", 500, 100, 40),
)


def main() -> None:
    """Compute what the stores do not hold yet and write the record."""
    options = parsed_options()
    with process_pool(options.workers) as executor:
        for wanted in PARTS:
            for name in KNEES:
                if (knee := study_knee(name)) is not None:
                    swept(name, problem_of(knee), wanted, options, executor)


def parsed_options() -> argparse.Namespace:
    """What was asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    store = platformdirs.user_cache_path("identknee") / "studies" / "basin_of_attraction"
    parser.add_argument("--store", type=Path, default=store, help="folder of finished searches")
    parser.add_argument("--record", type=Path, default=RECORD, help="the file to write")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="a hundredth of the starts")
    return parser.parse_args()


def problem_of(knee: Knee) -> LaxityResiduals:
    """The 63 trials simulated at the true parameters, without noise, in mm and deg."""
    model = LaxityModel(knee=knee, protocol=load_protocol("seed63"))
    truth = named_start(TRUTH, model.parameters)
    return LaxityResiduals(model=model, laxity=model.simulate(truth))


def starts_of(problem: LaxityResiduals, design: str, n: int) -> Array:
    """The starts of a design, shape ``(n, p)``; `n` a guess for ``"guesses"``."""
    parameters = problem.parameters
    if design == "shells":
        truth = named_start(TRUTH, parameters)
        return shell_starts(parameters, n, center=truth, distances=DISTANCES, seed=SEED)
    if design == "bounds":
        return sobol_starts(parameters, n, seed=SEED)
    return np.repeat([named_start(x, parameters) for x in GUESSES], n, axis=0)


def swept(
    knee: str,
    problem: LaxityResiduals,
    wanted: Part,
    options: argparse.Namespace,
    executor: Executor,
) -> Sweep:
    """The sweep of a part on a knee, from its store as far as it is there."""
    n = wanted.numbers[knee]
    n = max(1, n // 100) if options.quick else n
    starts = starts_of(problem, wanted.design, n)
    about = {
        "knee": knee_digest(problem.model.knee),
        "numbers": fingerprint(problem),
        "design": wanted.design,
        "distances": DISTANCES,
        "method": wanted.method,
        "starts": len(starts),
        "seed": SEED,
    }
    began = time.perf_counter()
    path = options.store / f"{knee}_{wanted.name}{'_quick' * options.quick}.sqlite"
    with open_work(path, about) as store:
        found = sweep(
            problem, starts, method=wanted.method, seed=SEED, executor=executor, store=store
        )
    say(f"{knee}: {found} ({time.perf_counter() - began:.0f} s)")
    return found


def fingerprint(problem: LaxityResiduals) -> str:
    """Digest of what two short searches give: code that gives other numbers has another one."""
    start = named_start("IG4", problem.parameters)
    ends = [
        fit(problem, start, method=x, seed=SEED, budget=60) for x in ("least-squares", "complex")
    ]
    return digest(
        str(rounded([[*x.theta, x.objective, x.n_simulations] for x in ends], 8)).encode()
    )


def say(text: str) -> None:
    """Tell how far it is."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


if __name__ == "__main__":
    main()
