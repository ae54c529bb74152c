"""Slow part of the study: profiles of parameters, pairs, forces and laxities at several noises.

Writes ``records/profiles.json`` after each part. Finished items are kept in a store outside the
checkout, so that the same command resumes where it was stopped.
"""

import sys
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.problems import model_of, noisy_problem, truth_of
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.identify.profile.profile import profile, profile_parameters
from identknee.report.parameter_figures import nested
from identknee.runs.schema import to_plain

KNEES = ("reference", "lenhart2015_stable")
# mm and deg; the study's own, and those at which it asks what is still known.
NOISE = 0.5
NOISES = (0.3, 0.5, 1.0, 2.0, 4.0)
SEED = 1
# Data sets at each noise: a fifth as many on the real knee.
N_DATA_SETS = {"reference": 20, "lenhart2015_stable": 4}
LOADS = ("unloaded", "varus-10Nm", "varus10Nm", "internal-10Nm", "internal10Nm")
FLEXIONS = (0, 30, 60)
# Levels at which pairs are nested, beside their own.
NESTED = (0.5, 0.8)
UNTESTED = "anterior_drawer_mm"
Item = tuple[str, float, int]


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = records.parsed_options(__file__, "few trials and data sets")
    record = records.begun(options, KNEES, seed=SEED, noises_mm_deg=NOISES, n_data_sets=N_DATA_SETS)
    known = {"inputs": record["head"]["inputs"], "seed": SEED, "noises_mm_deg": NOISES}
    with records.working(options, quick=options.quick, **known) as kept:
        for name in KNEES:
            part = record["knees"][name] = described(name)
            own = (name, NOISE, SEED)
            part["profiles"] = kept(parameter_profiles, [own], f"{name} profiles")[0]
            pairs = [(own, x) for x in ligaments(name)]
            part["pairs"] = kept(pair_profile, pairs, f"{name} pairs")
            trials = forced_trials()[:2] if options.quick else forced_trials()
            by_trial = kept(forces, [(own, x) for x in trials], f"{name} forces")
            part["forces"] = [row for rows in by_trial for row in rows]
            drawer = ik.load_protocol("drawer").trials[: 1 if options.quick else None]
            part["untested"] = kept(untested, [(own, x) for x in drawer], f"{name} untested loads")
            n = 2 if options.quick else N_DATA_SETS[name]
            items = [(name, noise, seed) for noise in NOISES for seed in range(SEED, SEED + n)]
            part["noises"] = kept(open_ends, items, f"{name} noises")
            write_record(options.record, rounded(record))


@cache
def known_model(knee: str) -> ik.LaxityModel:
    """The model of a knee, made once in each process."""
    return model_of(study_knee(knee))


@cache
def problem_of(item: Item) -> ik.LaxityResiduals:
    """The noisy data of a knee."""
    knee, noise, seed = item
    return noisy_problem(known_model(knee), noise, seed)


@cache
def optimum_of(item: Item) -> ik.runs.Array:
    """The best fit to these data."""
    return ik.identify.best_fit(problem_of(item)).theta


def ligaments(knee: str) -> list[str]:
    """Names of the ligaments."""
    return [x.name for x in known_model(knee).knee.ligaments]


def forced_trials() -> list[str]:
    """Trials whose ligament forces are profiled."""
    return [f"flexion{flexion}_{load}" for flexion in FLEXIONS for load in LOADS]


def described(knee: str) -> Row:
    """Names, truth and units of the parameters."""
    parameters = known_model(knee).parameters
    return {
        "parameters": parameters.names,
        "truth": truth_of(parameters),
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
    names = (f"{ligament}.{ik.model.STIFFNESS}", f"{ligament}.{ik.model.STRAIN}")
    found = ik.identify.profile_pair(problem_of(data), optimum_of(data), names)
    return {
        "names": names,
        "optimum": found.optimum,
        "levels": [*NESTED, found.level],
        "edges": [found.contour(level) for level in (*NESTED, found.level)],
        "statuses": [x.status for x in found.rays],
        "n_simulations": found.n_simulations,
    }


def forces(item: tuple[Item, str]) -> list[Row]:
    """The force of every ligament in one trial."""
    data, trial = item
    problem = problem_of(data)
    truth = truth_of(problem.parameters)
    rows = []
    for ligament in ligaments(data[0]):
        force = ik.model.quantity_named(problem.model, f"{ligament}.tension_N@{trial}")
        found = profile(problem, optimum_of(data), force)
        rows.append(
            {"ligament": ligament, "trial": trial, **short(found, force.evaluate(truth)[0])}
        )
    return rows


def untested(item: tuple[Item, str]) -> Row:
    """The drawer under a load that the data lack."""
    data, trial = item
    problem = problem_of(data)
    model = problem.model.with_protocol(ik.load_protocol("drawer"))
    drawer = ik.model.quantity_named(model, f"{UNTESTED}@{trial}")
    found = profile(problem, optimum_of(data), drawer)
    truth = drawer.evaluate(truth_of(problem.parameters))[0]
    return {"trial": trial, **short(found, truth)}


def open_ends(item: Item) -> Row:
    """Which parameters of one data set have an interval, and how wide it is."""
    _, noise, seed = item
    problem = problem_of(item)
    truth = truth_of(problem.parameters)
    found = profile_parameters(problem, optimum_of(item))
    rows = [short(x, float(t)) for x, t in zip(found, truth, strict=True)]
    return {
        "noise": noise,
        "seed": seed,
        **{key: [row[key] for row in rows] for key in rows[0]},
    }


def short(of: ik.Profile, truth: float) -> Row:
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


def nested_plain(of: ik.Profile) -> list[Row]:
    """Nested sets of a profile."""
    return [{"level": level, "intervals": sets} for level, sets in nested(of).items()]


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")
    main()
