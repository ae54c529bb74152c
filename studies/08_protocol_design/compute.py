"""Slow part of the study: trials chosen by five criteria, by chance, and tried on noisy data.

Writes ``records/protocol_design.json`` after each part. Finished items are kept in a store outside
the checkout, so that the same command resumes where it was stopped.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from identknee.calibrate.fit import fit
from identknee.calibrate.quantity import ParameterQuantity
from identknee.calibrate.starts import named_start
from identknee.identify.design.added_trials import WithTrials
from identknee.identify.design.criteria import CRITERIA, Criterion
from identknee.identify.design.design import Design, design
from identknee.identify.optimum import best_fit
from identknee.identify.profile.profiles import profile_quantities
from identknee.identify.profile.result import Profile
from identknee.laxity.candidates import candidate_trials
from identknee.laxity.noise import add_noise
from identknee.laxity.protocol import LOADS, Protocol, load_protocol
from identknee.model.candidate_laxity import CandidateLaxity, typical_errors
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
from identknee.runs.executors import process_pool
from identknee.runs.resume import open_work, resumable_map

HERE = Path(__file__).parent
RECORD = HERE / "records" / "protocol_design.json"
COMMAND = "python studies/08_protocol_design/compute.py"
KNEES = ("reference", "lenhart2015_stable")
TRUTH = "IG1"  # Table 1 of the paper: its first initial guess is the reference itself.
VARUS_VALGUS = "varus-valgus"
MADE = ("table2", VARUS_VALGUS, "seed63")
NOISE = 0.5  # mm and deg
SEED = 1
N_TRIALS = 6
N_RANDOM = 20
N_DATA_SETS = {"reference": 20, "lenhart2015_stable": 4}
Row = dict[str, Any]
Case = tuple[str, str]


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = parsed_options()
    knees = {name: study_knee(name) for name in KNEES}
    digests = {name: knee_digest(knee) for name, knee in knees.items()}
    settings: Row = {"seed": SEED, "noise_mm_deg": NOISE, "n_trials": N_TRIALS}
    record: Row = {
        "head": record_head(
            f"{COMMAND} --workers {options.workers}",
            settings={**settings, "n_random": N_RANDOM, "n_data_sets": N_DATA_SETS},
            inputs=digests,
        ),
        "knees": {name: described(name) for name in knees},
    }
    about = {
        "study": "08_protocol_design",
        **settings,
        "quick": options.quick,
        "inputs": digests,
    }
    with open_work(options.store, about) as store, process_pool(options.workers) as executor:

        def kept(work: Callable[[Any], Row], items: Sequence[Any], name: str) -> list[Row]:
            began = time.perf_counter()
            found = resumable_map(work, items, executor=executor, store=store, name=name)
            print(f"{name}, {time.perf_counter() - began:.0f} s", flush=True)
            return found

        for name in knees:
            for made in MADE[:1] if options.quick else MADE:
                case = (name, made)
                part: Row = {}
                record["knees"][name]["made"][made] = part
                label = f"{name} {made}"
                criteria = CRITERIA[-1:] if options.quick else CRITERIA
                found = kept(advice, [(case, x) for x in criteria], f"{label} criteria")
                part["advice"] = dict(zip(criteria, found, strict=True))
                best = part["advice"]["width"]
                n_random = 1 if options.quick else N_RANDOM
                sets = [(case, best, seed) for seed in range(n_random)]
                part["random"] = kept(by_chance, sets, f"{label} random")
                n = 1 if options.quick else N_DATA_SETS[name]
                sets = [(case, best, seed) for seed in range(SEED + 1, SEED + 1 + n)]
                part["redone"] = kept(redone, sets, f"{label} data sets")
                write_record(options.record, rounded(record))
    print(f"written: {options.record.name}")


def parsed_options() -> argparse.Namespace:
    """What was asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    store = platformdirs.user_cache_path("identknee") / "studies" / "protocol_design.sqlite"
    parser.add_argument("--store", type=Path, default=store, help="keeps finished designs")
    parser.add_argument("--record", type=Path, default=RECORD, help="the file to write")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="one protocol, one data set")
    return parser.parse_args()


@cache
def protocol_of(made: str) -> Protocol:
    """The trials made."""
    if made != VARUS_VALGUS:
        return load_protocol(made)
    seed63 = load_protocol("seed63")
    return seed63.select(seed63.loads[:, LOADS.index("internal_moment_Nm")] == 0)


@cache
def model_of(case: Case) -> LaxityModel:
    """The model of a knee under the trials made."""
    return LaxityModel(knee=study_knee(case[0]), protocol=protocol_of(case[1]))


def truth_of(case: Case) -> Array:
    """The parameters that the data are made with."""
    return named_start(TRUTH, model_of(case).parameters)


@cache
def problem_of(case: Case, seed: int) -> LaxityResiduals:
    """The trials made, simulated at the truth with noise, in units of that noise."""
    model = model_of(case)
    noisy = add_noise(model.simulate(truth_of(case)), sd_mm=NOISE, sd_deg=NOISE, seed=seed)
    return LaxityResiduals(model=model, laxity=noisy, weighting="noise")


@cache
def candidates_of(case: Case) -> CandidateLaxity:
    """The trials to choose from."""
    problem = problem_of(case, SEED)
    return CandidateLaxity(
        model=problem.model,
        laxity=problem.laxity,
        protocol=candidate_trials(problem.laxity.protocol),
        sd=typical_errors(problem.laxity),
        free=problem.parameters.with_fixed((), problem.parameters.center),
    )


@cache
def optimum_of(case: Case) -> Array:
    """The best fit to the first data set."""
    return best_fit(problem_of(case, SEED)).theta


def described(knee: str) -> Row:
    """Names, truth and bounds of the parameters; the trials of each protocol."""
    parameters = model_of((knee, MADE[0])).parameters
    return {
        "parameters": parameters.names,
        "truth": truth_of((knee, MADE[0])),
        "lower_bound": parameters.lower,
        "upper_bound": parameters.upper,
        "made": {},
    }


def advice(item: tuple[Case, Criterion]) -> Row:
    """Trials chosen by one criterion, with what was predicted of them and what they achieve."""
    case, criterion = item
    problem, candidates = problem_of(case, SEED), candidates_of(case)
    began = time.perf_counter()
    found = design(problem, optimum_of(case), candidates, n_trials=N_TRIALS, criterion=criterion)
    return {
        "n_made": problem.laxity.n,
        "n_candidates": len(found.names),
        "targets": found.targets,
        "best": [x.optimum_value for x in found.before],
        "chosen": found.chosen,
        "trials": found.trials,
        "excluded": [x.name for x in found.excluded],
        "at_fit": [x.name for x in found.excluded if x.at_fit],
        "alone": [None if np.isnan(x) else x for x in found.alone],
        "losses": found.losses,
        "predicted": open_as_none(found.predicted),
        "before": [ends(x) for x in found.before],
        "after": [ends(x) for x in found.after],
        "statuses": [[x.lower_status.value, x.upper_status.value] for x in found.before],
        "statuses_after": [[x.lower_status.value, x.upper_status.value] for x in found.after],
        "n_simulations": found.n_simulations,
        "seconds": time.perf_counter() - began,
        "lengths": lengths(case, found.after),
        "lengths_before": lengths(case, found.before),
        **gains(found),
    }


def gains(found: Design) -> Row:
    """How much the targets' intervals shrink by each candidate alone, on geometric mean [%]."""
    change = (found.alone - found.losses[0]) / len(found.targets)
    return {"gains": [None if np.isnan(x) else 100.0 * (1.0 - np.exp(x)) for x in change]}


def by_chance(item: tuple[Case, Row, int]) -> Row:
    """As many trials drawn at random from the same candidates, without repeats."""
    case, best, seed = item
    candidates = candidates_of(case)
    offered = [i for i, name in enumerate(candidates.names) if name not in set(best["excluded"])]
    chosen = np.random.default_rng([SEED, seed]).choice(offered, N_TRIALS, replace=False).tolist()
    theta = optimum_of(case)
    measured, _ = candidates.predict(theta, chosen)
    whole = WithTrials(
        problem=problem_of(case, SEED),
        candidates=candidates,
        chosen=tuple(chosen),
        measured=measured,
    )
    after = profile_quantities(whole, theta, targets_of(case, best))
    return {
        "trials": [candidates.names[i] for i in chosen],
        "lengths": lengths(case, after),
        "n_open": sum((x.lower is None) + (x.upper is None) for x in after),
    }


def redone(item: tuple[Case, Row, int]) -> Row:
    """The advice tried on a new noisy data set: profiles with the added trials and without."""
    case, best, seed = item
    problem, candidates = problem_of(case, seed), candidates_of(case)
    truth, chosen = truth_of(case), tuple(best["chosen"])
    measured, _ = candidates.predict(truth, chosen)
    noise = np.random.default_rng([SEED, seed]).standard_normal(measured.shape)
    whole = WithTrials(
        problem=problem, candidates=candidates, chosen=chosen, measured=measured + noise
    )
    row: Row = {"seed": seed}
    for name, of in (("without", problem), ("with", whole)):
        found = profile_quantities(of, fit(of, truth).theta, targets_of(case, best))
        row[name] = {"ends": [ends(x) for x in found], "lengths": lengths(case, found)}
    return row


def targets_of(case: Case, best: Row) -> list[ParameterQuantity]:
    """The parameters that the advice was asked for."""
    parameters = model_of(case).parameters
    return [ParameterQuantity(parameters=parameters, name=name) for name in best["targets"]]


def ends(of: Profile) -> list[float | None]:
    """Both ends of the set; None for an open one."""
    return [of.lower, of.upper]


def lengths(case: Case, profiles: Sequence[Profile]) -> list[float]:
    """Length of each interval within the box, to which an open end extends."""
    parameters = model_of(case).parameters
    found = []
    for x in profiles:
        i = parameters.index(x.name)
        low = parameters.lower[i] if x.lower is None else x.lower
        high = parameters.upper[i] if x.upper is None else x.upper
        found.append(float(high - low))
    return found


def open_as_none(predicted: Array) -> list[Any]:
    """Predicted ends as lists; None for open ones."""
    return [[[None if np.isnan(x) else x for x in t] for t in step] for step in predicted.tolist()]


if __name__ == "__main__":
    main()
