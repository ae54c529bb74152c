"""Slow part of the study: profiles of parameters, pairs, forces and laxities at several noises.

Writes ``records/profiles.json`` after each part. Finished items are kept in a store outside the
checkout, so that the same command resumes where it was stopped.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from identknee.calibrate.starts import named_start
from identknee.identify.optimum import best_fit
from identknee.identify.profile.pairs import profile_pair
from identknee.identify.profile.profile import profile
from identknee.identify.profile.profiles import profile_parameters
from identknee.identify.profile.result import Profile
from identknee.laxity.noise import add_noise
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import STIFFNESS, STRAIN
from identknee.model.quantities import LigamentForce, PredictedLaxity
from identknee.model.residuals import LaxityResiduals
from identknee.report.profile_groups import PAIR_LEVELS, nested
from identknee.report.study_records import (
    knee_digest,
    record_head,
    rounded,
    study_knee,
    write_record,
)
from identknee.runs.arrays import Array
from identknee.runs.executors import process_pool
from identknee.runs.plain_records import to_plain
from identknee.runs.resume import open_work, resumable_map

HERE = Path(__file__).parent
RECORD = HERE / "records" / "profiles.json"
COMMAND = "python studies/04_profiles/compute.py"
KNEES = ("reference", "lenhart2015_stable")
TRUTH = "IG1"  # Table 1 of the paper: its first initial guess is the reference itself.
# mm and deg; the study's own, and those at which it asks what is still known.
NOISE = 0.5
NOISES = (0.3, 0.5, 1.0, 2.0, 4.0)
SEED = 1
# Data sets at each noise: a fifth as many on the real knee.
N_DATA_SETS = {"reference": 20, "lenhart2015_stable": 4}
LOADS = ("unloaded", "varus-10Nm", "varus10Nm", "internal-10Nm", "internal10Nm")
FLEXIONS = (0, 30, 60)
UNTESTED = "anterior_drawer_mm"
Row = dict[str, Any]
Item = tuple[str, float, int]


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = parsed_options()
    knees = {name: study_knee(name) for name in KNEES}
    digests = {name: knee_digest(knee) for name, knee in knees.items()}
    settings: Row = {"seed": SEED, "noises_mm_deg": NOISES, "quick": options.quick}
    record: Row = {
        "head": record_head(
            f"{COMMAND} --workers {options.workers}",
            settings={**settings, "n_data_sets": N_DATA_SETS, "workers": options.workers},
            inputs=digests,
        ),
        "knees": {},
    }
    about = {"study": "04_profiles", **settings, "inputs": digests}
    with open_work(options.store, about) as store, process_pool(options.workers) as executor:
        for name in knees:
            part = record["knees"][name] = described(name)

            def kept(
                work: Callable[[Any], Any], items: Sequence[Any], part_name: str, knee: str = name
            ) -> list[Any]:
                began = time.perf_counter()
                found = resumable_map(
                    work, items, executor=executor, store=store, name=f"{knee} {part_name}"
                )
                print(f"{knee}: {part_name}, {time.perf_counter() - began:.0f} s", flush=True)
                return found

            own = (name, NOISE, SEED)
            part["profiles"] = kept(parameter_profiles, [own], "profiles")[0]
            part["pairs"] = kept(pair_profile, [(own, x) for x in ligaments(name)], "pairs")
            trials = forced_trials()[:2] if options.quick else forced_trials()
            by_trial = kept(forces, [(own, x) for x in trials], "forces")
            part["forces"] = [row for rows in by_trial for row in rows]
            drawer = load_protocol("drawer").trials[: 1 if options.quick else None]
            part["untested"] = kept(untested, [(own, x) for x in drawer], "untested loads")
            n = 2 if options.quick else N_DATA_SETS[name]
            items = [(name, noise, seed) for noise in NOISES for seed in range(SEED, SEED + n)]
            part["noises"] = kept(open_ends, items, "noises")
            write_record(options.record, rounded(record))
    print(f"written: {options.record.name}")


def parsed_options() -> argparse.Namespace:
    """What was asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    store = platformdirs.user_cache_path("identknee") / "studies" / "profiles.sqlite"
    parser.add_argument("--store", type=Path, default=store, help="keeps finished profiles")
    parser.add_argument("--record", type=Path, default=RECORD, help="the file to write")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="few trials and data sets")
    return parser.parse_args()


@cache
def model_of(knee: str) -> LaxityModel:
    """The model of a knee under the 63 trials, made once in each process."""
    return LaxityModel(knee=study_knee(knee), protocol=load_protocol("seed63"))


@cache
def problem_of(item: Item) -> LaxityResiduals:
    """The 63 trials simulated at the true parameters with noise, in units of that noise."""
    knee, noise, seed = item
    model = model_of(knee)
    clean = model.simulate(named_start(TRUTH, model.parameters))
    noisy = add_noise(clean, sd_mm=noise, sd_deg=noise, seed=seed)
    return LaxityResiduals(model=model, laxity=noisy, weighting="noise")


@cache
def optimum_of(item: Item) -> Array:
    """The best fit to these data."""
    return best_fit(problem_of(item)).theta


def ligaments(knee: str) -> list[str]:
    """Names of the ligaments."""
    return [x.name for x in model_of(knee).knee.ligaments]


def forced_trials() -> list[str]:
    """Trials whose ligament forces are profiled."""
    return [f"flexion{flexion}_{load}" for flexion in FLEXIONS for load in LOADS]


def described(knee: str) -> Row:
    """Names, truth and units of the parameters."""
    parameters = model_of(knee).parameters
    return {
        "parameters": parameters.names,
        "truth": named_start(TRUTH, parameters),
        "upper_bound": parameters.upper,
        "lower_bound": parameters.lower,
    }


def parameter_profiles(item: Item) -> list[Row]:
    """The profile of every parameter."""
    found = profile_parameters(problem_of(item), optimum_of(item))
    return [{**to_plain(x), "nested": nested_plain(x)} for x in found]


def pair_profile(item: tuple[Item, str]) -> Row:
    """Stiffness with reference strain of one ligament."""
    data, ligament = item
    names = (f"{ligament}.{STIFFNESS}", f"{ligament}.{STRAIN}")
    found = profile_pair(problem_of(data), optimum_of(data), names)
    return {
        "names": names,
        "optimum": found.optimum,
        "levels": [*PAIR_LEVELS, found.level],
        "edges": [found.contour(level) for level in (*PAIR_LEVELS, found.level)],
        "statuses": [x.status for x in found.rays],
        "n_simulations": found.n_simulations,
    }


def forces(item: tuple[Item, str]) -> list[Row]:
    """The force of every ligament in one trial."""
    data, trial = item
    problem = problem_of(data)
    truth = named_start(TRUTH, problem.parameters)
    rows = []
    for ligament in ligaments(data[0]):
        force = LigamentForce(model=problem.model, ligament=ligament, trial=trial)
        found = profile(problem, optimum_of(data), force)
        rows.append(
            {"ligament": ligament, "trial": trial, **short(found, force.evaluate(truth)[0])}
        )
    return rows


def untested(item: tuple[Item, str]) -> Row:
    """The drawer under a load that the data lack."""
    data, trial = item
    problem = problem_of(data)
    model = problem.model.with_protocol(load_protocol("drawer"))
    drawer = PredictedLaxity(model=model, coordinate=UNTESTED, trial=trial)
    found = profile(problem, optimum_of(data), drawer)
    truth = drawer.evaluate(named_start(TRUTH, problem.parameters))[0]
    return {"trial": trial, **short(found, truth)}


def open_ends(item: Item) -> Row:
    """Which parameters of one data set have an interval, and how wide it is."""
    _, noise, seed = item
    problem = problem_of(item)
    truth = named_start(TRUTH, problem.parameters)
    found = profile_parameters(problem, optimum_of(item))
    rows = [short(x, float(t)) for x, t in zip(found, truth, strict=True)]
    return {
        "noise": noise,
        "seed": seed,
        **{key: [row[key] for row in rows] for key in rows[0]},
    }


def short(of: Profile, truth: float) -> Row:
    """What is kept of a profile whose curve is not drawn."""
    return {
        "truth": truth,
        "value": of.optimum_value,
        "lower": of.lower,
        "upper": of.upper,
        "lower_status": of.lower_status,
        "upper_status": of.upper_status,
        "verdict": of.verdict,
        "practical_level": of.practical_level,
        "n_intervals": len(of.intervals),
        "n_simulations": of.n_simulations,
        "n_points": len(of.values),
    }


def nested_plain(of: Profile) -> list[Row]:
    """Nested sets of a profile."""
    return [{"level": level, "intervals": sets} for level, sets in nested(of).items()]


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")
    main()
