"""Slow part of the study: the loads of the paper's Table 2, and ramps to where a branch ends.

Writes ``records/model_evaluation.json``.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import published, records
from common.problems import model_of
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.mechanics.pose import coordinates_from_pose

KNEES = ("reference", "lenhart2015_stable", "lenhart2015")
RAMP_FLEXION_DEG = (0.0, 30.0, 60.0)
# Load column, its largest value, and the step of a ramp to it.
RAMPS = (
    ("varus_moment_Nm", 10.0, 0.25),
    ("varus_moment_Nm", -10.0, -0.25),
    ("internal_moment_Nm", 10.0, 0.25),
    ("internal_moment_Nm", -10.0, -0.25),
    ("anterior_force_N", 134.0, 6.7),
    ("anterior_force_N", -100.0, -5.0),
)


def main() -> None:
    """Compute all and write the record."""
    options = records.parsed_options(__file__)
    knees = {name: study_knee(name) for name in KNEES}
    record = {
        **records.begun(options, KNEES, ramps=RAMPS, ramp_flexion_deg=RAMP_FLEXION_DEG),
        "coordinates": ik.laxity.COORDINATES,
    }
    with ik.runs.threads(options.workers) as executor:
        for name, knee in knees.items():
            began = time.perf_counter()
            record["knees"][name] = {
                "table2": table2(knee),
                "seed63": seed63(knee),
                "ramps": ramps(knee, executor),
                "contact_points": all_vertices(knee),
            }
            record["knees"][name]["seconds"] = rounded(time.perf_counter() - began, 3)
            write_record(options.record, record)
            print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)


def table2(knee: ik.Knee) -> Row:
    """Response to each row of Table 2 [mm or deg], with the outcome and margin of its trial."""
    model = ik.LaxityModel(knee=knee, protocol=ik.load_protocol("table2"))
    prediction = model.predict(model.parameters.center, derivatives=False)
    rows = [model.protocol.trials.index(row.trial) for row in published.TABLE2]
    return {
        "response": rounded(published.table2_laxity(model.simulate(model.parameters.center))),
        "outcome": [prediction.outcomes[i].value for i in rows],
        "margin_N_per_mm": rounded(prediction.margins[rows]),
        "unloaded": {
            trial: prediction.outcomes[i].value
            for i, trial in enumerate(model.protocol.trials)
            if model.protocol.is_unloaded[i]
        },
    }


def seed63(knee: ik.Knee) -> Row:
    """How the 63 trials end at the subject's own parameters.

    The pose a single step finds for those that continuation loses is kept, converged or not.
    """
    model = model_of(knee)
    prediction = model.predict(model.parameters.center, derivatives=False)
    single = replace(model, continuation="single-step")
    at_once = single.predict(model.parameters.center, derivatives=False)
    converged = prediction.is_converged
    return {
        "n_trials": model.protocol.n,
        "outcomes": {
            outcome.value: count
            for outcome in ik.Outcome
            if (count := prediction.outcomes.count(outcome))
        },
        "lowest_margin_N_per_mm": rounded(float(prediction.margins[converged].min())),
        "not_converged": [
            {
                "trial": model.protocol.trials[i],
                "outcome": prediction.outcomes[i].value,
                "single_step_outcome": at_once.outcomes[i].value,
                "single_step_coordinates": rounded(coordinates_from_pose(at_once.poses[i])),
            }
            for i in np.flatnonzero(~converged)
        ],
    }


def all_vertices(knee: ik.Knee) -> Row:
    """Table 2 with every tibial vertex as a contact point, beside the default."""
    model = ik.LaxityModel(knee=knee, protocol=ik.load_protocol("table2"), n_points=None)
    laxity = model.simulate(model.parameters.center)
    return {"response_all_vertices": rounded(published.table2_laxity(laxity))}


def ramps(knee: ik.Knee, executor: ik.runs.Executor) -> list[Row]:
    """Every ramp in small steps: poses, margins, and where it ended."""
    tasks = [(knee, flexion, *ramp) for flexion in RAMP_FLEXION_DEG for ramp in RAMPS]
    return list(executor.map(one_ramp, tasks))


def one_ramp(task: tuple[ik.Knee, float, str, float, float]) -> Row:
    """One ramp, followed as far as it goes."""
    knee, flexion, load, largest, step = task
    steps = np.append(np.arange(round(largest / step)) * step, largest)
    protocol = ramp_protocol(flexion, load, steps)
    model = ik.LaxityModel(knee=knee, protocol=protocol)
    prediction = model.predict(model.parameters.center, derivatives=False)
    row = {
        "flexion_deg": flexion,
        "load": load,
        "load_values": steps,
        "coordinates": prediction.coordinates,
        "margin_N_per_mm": np.where(prediction.is_converged, prediction.margins, np.nan),
        "outcome": "converged",
    }
    ended: Row = rounded({**row, **ending(model, prediction)})
    return ended


def ramp_protocol(flexion: float, load: str, steps: np.ndarray) -> ik.Protocol:
    """The trials of a ramp."""
    loads = np.zeros((len(steps), len(ik.laxity.LOADS)))
    loads[:, ik.laxity.LOADS.index(load)] = steps
    return ik.Protocol(
        name="ramp",
        trials=tuple(ik.laxity.trial_name(flexion, row.tolist()) for row in loads),
        flexion_deg=np.full(len(steps), flexion),
        loads=loads,
    )


def ending(model: ik.LaxityModel, prediction: ik.model.Prediction) -> Row:
    """Why a ramp does not reach its full load, and its last stable pose.

    The trials of a ramp that converge come first. The one after them carries the last stable pose
    on its way, the load of which follows from the share of the step that it reached.
    """
    failed = np.flatnonzero(~prediction.is_converged)
    if not failed.size:
        return {}
    first = int(failed[0])
    outcome = prediction.outcomes[first]
    ended: Row = {"outcome": outcome.value, "first_failing_trial": model.protocol.trials[first]}
    return {
        **ended,
        "last_stable_load": stable_load(model, first, float(prediction.reached[first])),
        "last_stable_pose": coordinates_from_pose(prediction.poses[first]),
        "last_stable_margin_N_per_mm": float(prediction.margins[first]),
    }


def stable_load(model: ik.LaxityModel, trial: int, reached: float) -> float:
    """Load of the last stable pose on the way to a trial, in the unit of its column."""
    column = int(np.flatnonzero(model.protocol.loads.any(axis=0))[0])
    goal = float(model.protocol.loads[trial, column])
    node = int(model.paths.trial_node[trial])
    before = int(model.paths.parent[node])
    if before < 0 or goal == 0.0:
        return 0.0
    goal_size = float(np.abs(model.paths.loads[node]).max())
    before_size = float(np.abs(model.paths.loads[before]).max())
    return goal * (before_size + reached * (goal_size - before_size)) / goal_size


if __name__ == "__main__":
    main()
