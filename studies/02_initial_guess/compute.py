"""Slow part of the study: fits from four initial guesses, and the trials that change branch.

Writes ``records/initial_guess.json`` after each part. Finished fits are kept in a store outside the
checkout, so that the same command resumes where it was stopped.
"""

import json
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.largest import largest_by
from common.problems import truth_of
from common.records import Row, rounded, study_knee, write_record

import identknee
import identknee as ik
from identknee.calibrate.fit import fit
from identknee.verbs.demo import parameter_error

KNEES = ("reference", "lenhart2015_stable")
STARTS = ("IG1", "IG2", "IG3", "IG4")
METHODS = ("complex", "least-squares")
SCENARIOS = (
    "anterior force",
    "posterior force",
    "varus moment",
    "valgus moment",
    "external moment",
    "internal moment",
)
OTHER_BRANCH_MM, OTHER_BRANCH_DEG = 0.1, 0.1
BOX_SEED, BOX_CHUNK = 0, 50


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """A knee with its synthetic data.

    Attributes
    ----------
    problem
        Residuals against the 63 trials simulated at the true parameters.
    model
        The model under these trials and the drawer forces.
    truth
        Theta of the synthetic data, shape ``(p,)``.
    at_truth
        Prediction of `model` there.
    """

    problem: ik.LaxityResiduals
    model: ik.LaxityModel
    truth: ik.runs.Array
    at_truth: ik.model.Prediction


@cache
def setting(knee_name: str) -> Setting:
    """The synthetic data of a knee, made once in each process."""
    protocol = ik.load_protocol("seed63")
    fitted = ik.LaxityModel(knee=study_knee(knee_name), protocol=protocol)
    model = fitted.with_protocol(ik.laxity.concatenate([protocol, ik.load_protocol("drawer")]))
    truth = truth_of(fitted.parameters)
    return Setting(
        problem=ik.LaxityResiduals(model=fitted, laxity=fitted.simulate(truth)),
        model=model,
        truth=truth,
        at_truth=model.predict(truth, derivatives=False),
    )


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = records.parsed_options(
        __file__, seeds=20, budget=ik.calibrate.BUDGET, box_samples=1000
    )
    record = records.begun(options, KNEES)
    inputs = record["head"]["inputs"]
    with (
        ik.runs.Store(options.store.with_suffix(".sqlite")) as store,
        ik.runs.process_pool(options.workers) as executor,
    ):
        for name in KNEES:
            records.say(f"{name}: profile")
            part: Row = {"profile": profile(name)}
            record["knees"][name] = part
            for method in METHODS:
                tasks = fit_tasks(name, method, options.seeds, options.budget)
                part[method] = finished(tasks, store, executor, inputs[name])
                write(record, options.record)
            records.say(f"{name}: branches")
            part["branches"] = branches(name, part, executor, options.box_samples)
            write(record, options.record)
    records.say(f"written: {options.record.name}")


def fit_tasks(knee_name: str, method: str, n_seeds: int, budget: int) -> list[Row]:
    """One task a fit; least squares draws nothing, so that one a start is enough."""
    n = n_seeds if method == "complex" else 1
    return [
        {
            "knee": knee_name,
            "method": method,
            "start": start,
            "seed": 1000 * (1 + STARTS.index(start)) + number,
            "budget": budget,
        }
        for start in STARTS
        for number in range(n)
    ]


def finished(
    tasks: list[Row], store: ik.runs.Store, executor: ik.runs.Executor, knee: str
) -> list[Row]:
    """Rows of all tasks, those in the store not computed again."""
    keys = [f"{sources()} {knee[:16]} {json.dumps(task, sort_keys=True)}" for task in tasks]
    known = store.keys()
    open_ = [(key, task) for key, task in zip(keys, tasks, strict=True) if key not in known]
    began = time.perf_counter()
    rows = executor.map(fit_row, [task for _, task in open_])
    for number, ((key, task), row) in enumerate(zip(open_, rows, strict=True), 1):
        store.put_many({key: row})
        records.say(
            f"{task['knee']} {task['method']} {number}/{len(open_)} {task['start']} "
            f"{row['outcome']} objective {row['objective']:.3g} "
            f"({time.perf_counter() - began:.0f} s)"
        )
    return [store.get(key) for key in keys]


def fit_row(task: Row) -> Row:
    """One fit, its kinematics and ligament forces against the truth; Complex also polished."""
    its = setting(task["knee"])
    start = ik.calibrate.named_start(task["start"], its.problem.parameters)
    ended = fit(its.problem, start, method=task["method"], seed=task["seed"], budget=task["budget"])
    row = {
        "start": task["start"],
        "seed": task["seed"],
        **end_of(its, ended),
        **errors(its, ended.theta),
    }
    if task["method"] == "complex":
        row["polished"] = end_of(its, fit(its.problem, ended.theta, method="least-squares"))
    checked: Row = rounded(row)
    return checked


def end_of(its: Setting, ended: ik.calibrate.Fit) -> Row:
    """Where a fit ended, how far from the truth, and what it cost."""
    error = parameter_error(ended.theta, its.truth)
    return {
        "theta": ended.theta,
        "error_kN": error.stiffness_kN,
        "error_pct": error.strain_pct,
        "objective": ended.objective,
        "outcome": ended.outcome.value,
        "n_simulations": ended.n_simulations,
        "seconds": ended.seconds,
    }


def errors(its: Setting, theta: ik.runs.Array) -> Row:
    """Kinematic errors over the 63 trials, differences of tension over these and the drawers."""
    prediction = its.model.predict(theta, derivatives=False)
    measured = its.problem.laxity
    simulated = ik.Laxity(
        protocol=measured.protocol, coordinates=prediction.coordinates[: measured.n]
    )
    kinematic = ik.laxity_rmse(simulated, measured)
    differences = np.abs(
        ik.model.tensions_of(its.model, prediction) - ik.model.tensions_of(its.model, its.at_truth)
    )
    flexion = its.model.protocol.flexion_deg
    return {
        "n_not_converged": int((~prediction.is_converged).sum()),
        "rmse_mm": kinematic.mm,
        "rmse_deg": kinematic.deg,
        "rmse_by_flexion": kinematic.by_flexion,
        "tension_by_flexion_N": largest_by(
            differences, flexion.tolist(), angles(its.model.protocol)
        ),
        "tension_by_scenario_N": largest_by(
            differences, ik.laxity.load_scenarios(its.model.protocol), SCENARIOS
        ),
    }


def angles(protocol: ik.Protocol) -> list[float]:
    """Its flexion angles [deg], ascending."""
    return [float(x) for x in np.unique(protocol.flexion_deg)]


def profile(knee_name: str) -> Row:
    """Coordinates, tensions and margins at the truth, and the names that go with all arrays."""
    its = setting(knee_name)
    protocol = its.model.protocol
    tensions = ik.model.tensions_of(its.model, its.at_truth)
    row: Row = rounded(
        {
            "parameters": its.model.parameters.names,
            "ligaments": [x.name for x in its.model.knee.ligaments],
            "starts": {x: ik.calibrate.named_start(x, its.model.parameters) for x in STARTS},
            "truth": its.truth,
            "flexion_angles_deg": angles(protocol),
            "scenarios": SCENARIOS,
            "coordinates": ik.laxity.COORDINATES,
            "trials": protocol.trials,
            "flexion_deg": protocol.flexion_deg,
            "loads": protocol.loads,
            "at_truth": its.at_truth.coordinates,
            "largest_tension_by_flexion_N": largest_by(
                tensions, protocol.flexion_deg.tolist(), angles(protocol)
            ),
            "largest_tension_by_scenario_N": largest_by(
                tensions, ik.laxity.load_scenarios(protocol), SCENARIOS
            ),
            "margin_N_per_mm": its.at_truth.margins,
        }
    )
    return row


def branches(knee_name: str, part: Row, executor: ik.runs.Executor, n_samples: int) -> Row:
    """How many of the 63 trials a single step puts on another branch, at several thetas."""
    its = setting(knee_name)
    parameters = its.problem.parameters
    ends = [row["theta"] for row in part["complex"]]
    sample = ik.checks.box_sample(parameters, n_samples, np.random.default_rng(BOX_SEED))
    sets = {
        "reference": its.truth[None],
        "IG4": ik.calibrate.named_start("IG4", parameters)[None],
        "ends of the Complex fits": np.array(ends),
        "box k +-50 %, eps_r +-3 %": sample,
    }
    return {name: branch_counts(knee_name, thetas, executor) for name, thetas in sets.items()}


def branch_counts(knee_name: str, thetas: ik.runs.Array, executor: ik.runs.Executor) -> Row:
    """Trials by how their single step ended, beside the canonical answer, summed over `thetas`."""
    chunks = [(knee_name, thetas[i : i + BOX_CHUNK]) for i in range(0, len(thetas), BOX_CHUNK)]
    kinds = np.concatenate(list(executor.map(branch_kinds, chunks)))
    trials = setting(knee_name).problem.laxity.protocol.trials
    other = kinds == KINDS.index("other_branch")
    by_trial = other.sum(axis=0)
    most = [i for i in np.argsort(-by_trial, kind="stable")[:5] if by_trial[i]]
    return {
        "n_thetas": len(thetas),
        "n_trials": int(kinds.size),
        **{kind: int((kinds == i).sum()) for i, kind in enumerate(KINDS)},
        "thetas_with_another_branch": int(other.any(axis=1).sum()),
        "most_often": {trials[i]: int(by_trial[i]) for i in most},
    }


KINDS = ("same", "other_branch", "single_step_failed", "canonical_failed", "both_failed")


def branch_kinds(task: tuple[str, ik.runs.Array]) -> np.ndarray:
    """Index into `KINDS` of each trial at each theta, shape ``(n_thetas, n_trials)``."""
    canonical = setting(task[0]).problem.model
    single = replace(canonical, continuation="single-step")
    kinds = np.empty((len(task[1]), canonical.protocol.n), np.int64)
    for row, theta in zip(kinds, task[1], strict=True):
        one = canonical.predict(theta, derivatives=False)
        other = single.predict(theta, derivatives=False)
        change = np.abs(one.coordinates - other.coordinates)
        differs = (change[:, ik.laxity.TRANSLATIONS] > OTHER_BRANCH_MM).any(axis=1)
        differs |= (change[:, ik.laxity.ROTATIONS] > OTHER_BRANCH_DEG).any(axis=1)
        row[:] = np.select(
            [
                one.is_converged & other.is_converged,
                one.is_converged,
                other.is_converged,
            ],
            [differs.astype(np.int64), 2, 3],
            default=4,
        )
    return kinds


@cache
def sources() -> str:
    """Digest of the code behind the numbers: a store gives back nothing that other code made."""
    folder = Path(identknee.__file__).parent
    packages = ("mechanics", "subject", "laxity", "model", "calibrate")
    files: Iterable[Path] = (x for name in packages for x in sorted((folder / name).rglob("*.*")))
    content = b"".join(x.read_bytes() for x in files if x.suffix in {".py", ".toml"})
    return ik.runs.digest(content + Path(__file__).read_bytes())[:16]


def write(record: Row, path: Path) -> None:
    """Write the record with its counts of fits and failures."""
    rows = list(all_fits(record))
    record["counts"] = {
        "fits": len(rows),
        "simulations": sum(row["n_simulations"] for row in rows),
        "fit_hours": rounded(sum(row["seconds"] for row in rows) / 3600.0, 3),
        "without_prediction": sum(row["outcome"] == "start_failed" for row in rows),
        "ends_with_lost_trials": sum(row["n_not_converged"] > 0 for row in rows),
    }
    write_record(path, record)


def all_fits(record: Row) -> Iterator[Row]:
    """Rows of all fits in the record."""
    for part in record["knees"].values():
        for method in METHODS:
            yield from part.get(method, [])


if __name__ == "__main__":
    main()
