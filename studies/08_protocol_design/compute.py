"""Slow part of the study: trials chosen by five criteria, by chance, and tried on noisy data.

Writes ``records/protocol_design.json`` after each part. Finished items are kept in a store outside
the checkout, so that the same command resumes where it was stopped.
"""

import sys
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.problems import noisy_problem, truth_of
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.identify.design import design
from identknee.identify.design_criteria import Criterion

KNEES = ("reference", "lenhart2015_stable")
VARUS_VALGUS = "varus-valgus"
MADE = ("table2", VARUS_VALGUS, "seed63")
NOISE = 0.5  # mm and deg
SEED = 1
N_TRIALS = 6
N_RANDOM = 20
N_DATA_SETS = {"reference": 20, "lenhart2015_stable": 4}
Case = tuple[str, str]


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = records.parsed_options(__file__, "one protocol, one data set")
    settings = {"seed": SEED, "noise_mm_deg": NOISE, "n_trials": N_TRIALS}
    record = records.begun(options, KNEES, n_random=N_RANDOM, n_data_sets=N_DATA_SETS, **settings)
    record["knees"] = {name: described(name) for name in KNEES}
    known = {"inputs": record["head"]["inputs"], **settings}
    criteria = ik.identify.CRITERIA[-1:] if options.quick else ik.identify.CRITERIA
    with records.working(options, quick=options.quick, **known) as kept:
        for name in KNEES:
            for made in MADE[:1] if options.quick else MADE:
                case, label = (name, made), f"{name} {made}"
                found = kept(advice, [(case, x) for x in criteria], f"{label} criteria")
                part: Row = {"advice": dict(zip(criteria, found, strict=True))}
                best = part["advice"]["width"]
                n_random = 1 if options.quick else N_RANDOM
                sets = [(case, best, seed) for seed in range(n_random)]
                part["random"] = kept(by_chance, sets, f"{label} random")
                n = 1 if options.quick else N_DATA_SETS[name]
                sets = [(case, best, seed) for seed in range(SEED + 1, SEED + 1 + n)]
                part["redone"] = kept(redone, sets, f"{label} data sets")
                record["knees"][name]["made"][made] = part
                write_record(options.record, rounded(record))


@cache
def protocol_of(made: str) -> ik.Protocol:
    """The trials made."""
    if made != VARUS_VALGUS:
        return ik.load_protocol(made)
    seed63 = ik.load_protocol("seed63")
    return seed63.select(seed63.loads[:, ik.laxity.LOADS.index("internal_moment_Nm")] == 0)


@cache
def model_of(case: Case) -> ik.LaxityModel:
    """The model of a knee under the trials made."""
    return ik.LaxityModel(knee=study_knee(case[0]), protocol=protocol_of(case[1]))


@cache
def problem_of(case: Case, seed: int) -> ik.LaxityResiduals:
    """The trials made, with noise."""
    return noisy_problem(model_of(case), NOISE, seed)


@cache
def candidates_of(case: Case) -> ik.model.CandidateLaxity:
    """The trials to choose from."""
    problem = problem_of(case, SEED)
    return ik.model.CandidateLaxity(
        model=problem.model,
        laxity=problem.laxity,
        protocol=ik.laxity.candidate_trials(problem.laxity.protocol),
        sd=ik.model.typical_errors(problem.laxity),
        free=problem.parameters.with_fixed((), problem.parameters.center),
    )


@cache
def optimum_of(case: Case) -> ik.runs.Array:
    """The best fit to the first data set."""
    return ik.identify.best_fit(problem_of(case, SEED)).theta


def described(knee: str) -> Row:
    """Names, truth and bounds of the parameters; the trials of each protocol."""
    parameters = model_of((knee, MADE[0])).parameters
    return {
        "parameters": parameters.names,
        "truth": truth_of(parameters),
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
        "best": [x.optimum_value for x in found.before.values()],
        "chosen": found.chosen,
        "trials": found.trials,
        "excluded": [x.name for x in found.excluded],
        "at_fit": [x.name for x in found.excluded if x.at_fit],
        "alone": [None if np.isnan(x) else x for x in found.alone],
        "losses": found.losses,
        "predicted": open_as_none(found.predicted),
        "before": [ends(x) for x in found.before.values()],
        "after": [ends(x) for x in found.after.values()],
        "statuses": [[x.lower_status.value, x.upper_status.value] for x in found.before.values()],
        "statuses_after": [
            [x.lower_status.value, x.upper_status.value] for x in found.after.values()
        ],
        "n_simulations": found.n_simulations,
        "seconds": time.perf_counter() - began,
        "lengths": lengths(case, tuple(found.after.values())),
        "lengths_before": lengths(case, tuple(found.before.values())),
        **gains(found),
    }


def gains(found: ik.identify.ChosenTrials) -> Row:
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
    whole = ik.identify.WithTrials(
        problem=problem_of(case, SEED),
        candidates=candidates,
        chosen=tuple(chosen),
        measured=measured,
    )
    after = ik.identify.profile_quantities(whole, theta, targets_of(case, best))
    return {
        "trials": [candidates.names[i] for i in chosen],
        "lengths": lengths(case, after),
        "n_open": sum((x.lower is None) + (x.upper is None) for x in after),
    }


def redone(item: tuple[Case, Row, int]) -> Row:
    """The advice tried on a new noisy data set: profiles with the added trials and without."""
    case, best, seed = item
    problem, candidates = problem_of(case, seed), candidates_of(case)
    truth, chosen = truth_of(model_of(case).parameters), tuple(best["chosen"])
    measured, _ = candidates.predict(truth, chosen)
    noise = np.random.default_rng([SEED, seed]).standard_normal(measured.shape)
    whole = ik.identify.WithTrials(
        problem=problem, candidates=candidates, chosen=chosen, measured=measured + noise
    )
    row: Row = {"seed": seed}
    for name, of in (("without", problem), ("with", whole)):
        found = ik.identify.profile_quantities(of, fit(of, truth).theta, targets_of(case, best))
        row[name] = {"ends": [ends(x) for x in found], "lengths": lengths(case, found)}
    return row


def targets_of(case: Case, best: Row) -> list[ik.calibrate.ParameterQuantity]:
    """The parameters that the advice was asked for."""
    parameters = model_of(case).parameters
    return [
        ik.calibrate.ParameterQuantity(parameters=parameters, name=name) for name in best["targets"]
    ]


def ends(of: ik.Profile) -> list[float | None]:
    """Both ends of the set; None for an open one."""
    return [of.lower, of.upper]


def lengths(case: Case, profiles: Sequence[ik.Profile]) -> list[float]:
    """Length of each interval within the box, to which an open end extends."""
    parameters = model_of(case).parameters
    found = []
    for x in profiles:
        i = parameters.index(x.name)
        low = parameters.lower[i] if x.lower is None else x.lower
        high = parameters.upper[i] if x.upper is None else x.upper
        found.append(float(high - low))
    return found


def open_as_none(predicted: ik.runs.Array) -> list[Any]:
    """Predicted ends as lists; None for open ones."""
    return [[[None if np.isnan(x) else x for x in t] for t in step] for step in predicted.tolist()]


if __name__ == "__main__":
    main()
