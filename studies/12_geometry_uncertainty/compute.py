"""Slow part of the study: fits with a geometry that is a little wrong.

Writes ``records/geometry_uncertainty.json``. Finished fits are kept in a store outside the
checkout, so that the same command resumes where it was stopped.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from scipy.spatial.transform import Rotation

from identknee.calibrate.constrained import Constrained, minimise, solve_constrained
from identknee.calibrate.evaluation import Evaluator
from identknee.calibrate.quantity import ParameterQuantity, Quantity
from identknee.calibrate.starts import named_start
from identknee.laxity.noise import add_noise
from identknee.laxity.protocol import LOADS, Protocol, load_protocol
from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.quantities import LigamentForce
from identknee.model.residuals import LaxityResiduals
from identknee.model.stability import box_sample
from identknee.model.tensions import tensions_of
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
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee

HERE = Path(__file__).parent
RECORD = HERE / "records" / "geometry_uncertainty.json"
COMMAND = "python studies/12_geometry_uncertainty/compute.py"
KNEE = "reference"
TRUTH = "IG1"  # Table 1 of the paper: its first initial guess is the reference itself.
NOISE_MM, NOISE_DEG = 0.5, 0.5
SEED = 12
# Kind of error and its sizes: insertions [mm, sd of each coordinate of each insertion], rotations
# [deg, about a random axis]: of the applied moments, and of the tibial frame (loads and angles).
LEVELS: tuple[tuple[str, float], ...] = (
    ("none", 0.0),
    ("insertions", 1.0),
    ("insertions", 2.0),
    ("insertions", 3.0),
    ("load axes", 1.0),
    ("load axes", 3.0),
    ("load axes", 5.0),
    ("tibial frame", 1.0),
    ("tibial frame", 3.0),
    ("tibial frame", 5.0),
)
MOMENTS = (LOADS.index("varus_moment_Nm"), LOADS.index("internal_moment_Nm"))
# The best of so many fits, from the first of so many starts that have a prediction.
FITS, STARTS = 4, 40
DIGITS = 5
Row = dict[str, Any]


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = parsed_options()
    n = 2 if options.quick else options.replicates
    levels = LEVELS[::3] if options.quick else LEVELS
    knee = study_knee(KNEE)
    # Replicate after replicate, so that more of them go on where fewer ended.
    tasks = [
        {"kind": kind, "size": size, "replicate": r} for r in range(n) for kind, size in levels
    ]
    about = {"knee": knee_digest(knee), "levels": levels, "seed": SEED}
    began = time.perf_counter()
    with (
        open_work(options.store, about) as store,
        process_pool(options.workers) as executor,
    ):
        rows = resumable_map(
            partial(replicate_row, knee),
            tasks,
            executor=executor,
            store=store,
            name="fits",
            description="fitting with a wrong geometry",
        )
    setting = true_setting(knee)
    record = {
        "head": record_head(
            COMMAND + (" --quick" if options.quick else f" --replicates {n}"),
            settings={
                "replicates": n,
                "levels": levels,
                "noise_mm": NOISE_MM,
                "noise_deg": NOISE_DEG,
                "seed": SEED,
                "workers": options.workers,
            },
            inputs={KNEE: knee_digest(knee)},
        ),
        "knees": {
            KNEE: rounded(
                {
                    "parameters": list(setting.model.parameters.names),
                    "truth": setting.truth,
                    "forces": [f"{x}@{trial}" for x, trial in setting.peaks],
                    "true_forces": setting.peak_forces,
                    "n_residuals": int(setting.model.protocol.n * 5),
                    "fits": rows,
                },
                DIGITS,
            )
        },
        "seconds_last_run": rounded(time.perf_counter() - began, 3),
    }
    write_record(options.record, record)
    say(f"written: {options.record.name}, {len(rows)} fits")


def parsed_options() -> argparse.Namespace:
    """What was asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    cache_folder = platformdirs.user_cache_path("identknee") / "studies"
    store = cache_folder / "geometry_uncertainty.sqlite"
    parser.add_argument("--store", type=Path, default=store, help="keeps finished fits")
    parser.add_argument("--record", type=Path, default=RECORD, help="the file to write")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--replicates", type=int, default=120, help="geometries a level")
    parser.add_argument("--quick", action="store_true", help="two geometries of some levels")
    return parser.parse_args()


class TrueSetting:
    """The knee as it is, its parameters, and its largest ligament forces.

    Attributes
    ----------
    model
        The model under the 63 trials.
    truth
        True theta, shape ``(p,)``.
    tensions
        Of every ligament in every trial [N], shape ``(n, m)``.
    peaks
        Of each ligament its name and the trial that loads it most.
    peak_forces
        The forces there [N], shape ``(m,)``.
    """

    def __init__(self, knee: Knee) -> None:
        self.model = LaxityModel(knee=knee, protocol=load_protocol("seed63"))
        self.truth = named_start(TRUTH, self.model.parameters)
        self.tensions = tensions_of(self.model, self.model.predict(self.truth))
        most = self.tensions.argmax(axis=0)
        self.peaks = [
            (ligament.name, self.model.protocol.trials[trial])
            for ligament, trial in zip(knee.ligaments, most, strict=True)
        ]
        self.peak_forces = self.tensions.max(axis=0)


@cache
def true_setting(knee: Knee) -> TrueSetting:
    """The setting of a knee, made once in each process."""
    return TrueSetting(knee)


def replicate_row(knee: Knee, task: Row) -> Row:
    """One noisy data set, fitted with one wrong geometry: errors and likelihood ratios."""
    its = true_setting(knee)
    seeds = np.random.SeedSequence((SEED, task["replicate"])).spawn(2)
    generator = np.random.default_rng(seeds[0])
    assumed, loads = with_error(knee, its.model.protocol, task, generator)
    # The data come from the true knee under the loads as they are, and say what was meant.
    simulated = its.model.with_protocol(loads).simulate(its.truth)
    nominal = Laxity(protocol=its.model.protocol, coordinates=simulated.coordinates)
    laxity = add_noise(nominal, sd_mm=NOISE_MM, sd_deg=NOISE_DEG, seed=seeds[1])
    model = LaxityModel(knee=assumed, protocol=its.model.protocol)
    evaluator = Evaluator(LaxityResiduals(model=model, laxity=laxity, weighting="noise"))
    best = best_fit(evaluator, its.truth, generator)
    row: Row = {**task, "outcome": best.outcome.value, "n_measured": int(laxity.is_measured.sum())}
    if not best.evaluation.is_finite:
        return {**row, "theta": None, "n_simulations": evaluator.n_simulations}
    parameters = model.parameters
    wanted: list[tuple[Quantity, float]] = [
        (ParameterQuantity(parameters=parameters, name=name), float(value))
        for name, value in zip(parameters.names, its.truth, strict=True)
    ]
    wanted += [
        (LigamentForce(model=model, ligament=ligament, trial=trial), float(force))
        for (ligament, trial), force in zip(its.peaks, its.peak_forces, strict=True)
    ]
    deviances, best = constrained_deviances(evaluator, best, wanted)
    theta = best.evaluation.theta
    prediction = model.predict(theta)
    tensions = tensions_of(model, prediction)
    at = [its.model.protocol.trials.index(trial) for _, trial in its.peaks]
    return {
        **row,
        "outcome": best.outcome.value,
        "theta": theta,
        "at_bound": [bool(x) for x in (theta <= parameters.lower) | (theta >= parameters.upper)],
        "sd": standard_deviations(best.evaluation.jacobian),
        "deviance": best.evaluation.deviance,
        "ratios": [x - best.evaluation.deviance for x in deviances],
        "forces": tensions[at, range(len(at))],
        "force_rms_N": np.sqrt(np.mean((tensions - its.tensions) ** 2, axis=0)),
        "n_simulations": evaluator.n_simulations,
    }


def with_error(
    knee: Knee, protocol: Protocol, task: Row, generator: np.random.Generator
) -> tuple[Knee, Protocol]:
    """The geometry assumed in the fit, and the loads really applied."""
    size = float(task["size"])
    if task["kind"] == "insertions":
        moved = [
            replace(
                x,
                femur=x.femur + generator.normal(0.0, size, 3),
                tibia=x.tibia + generator.normal(0.0, size, 3),
            )
            for x in knee.ligaments
        ]
        return knee.with_ligaments(moved), protocol
    axis = generator.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(size) * axis / np.linalg.norm(axis)).as_matrix()
    if task["kind"] == "tibial frame":
        frame = Frame(origin=knee.tibia_frame.origin, axes=turn @ knee.tibia_frame.axes)
        return replace(knee, tibia_frame=frame), protocol
    loads = np.array(protocol.loads)
    # About floating axis and tibial axis; what falls on the flexion axis is held by the rig.
    loads[:, MOMENTS] = loads[:, MOMENTS] @ turn[:2, :2].T
    return knee, replace(protocol, loads=loads)


def best_fit(evaluator: Evaluator, truth: Array, generator: np.random.Generator) -> Constrained:
    """The best of a few fits: from the truth, and from places of the box around it."""
    found = []
    for start in (truth, *box_sample(evaluator.parameters, STARTS, generator)):
        ended = minimise(evaluator, start)
        if ended.evaluation.is_finite or not found:
            found.append(ended)
        if sum(x.evaluation.is_finite for x in found) == FITS:
            break
    return min(found, key=lambda x: x.evaluation.deviance)


def constrained_deviances(
    evaluator: Evaluator, best: Constrained, wanted: Sequence[tuple[Quantity, float]]
) -> tuple[list[float], Constrained]:
    """Lowest deviance with each quantity at its true value, and the best fit seen on the way."""
    deviances = []
    for quantity, target in wanted:
        start = best.evaluation.theta
        found = solve_constrained(evaluator, start, quantity=quantity, target=target)
        reached = found.is_on_target and found.evaluation.is_finite
        deviances.append(found.evaluation.deviance if reached else np.inf)
        if reached and found.evaluation.deviance < best.evaluation.deviance:
            again = minimise(evaluator, found.evaluation.theta)
            if again.evaluation.deviance < best.evaluation.deviance:
                best = again
    return deviances, best


def standard_deviations(jacobian: Array) -> Array:
    """Of the parameters by the information matrix, shape ``(p,)``."""
    return np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))


def say(text: str) -> None:
    """Tell how far it is."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


if __name__ == "__main__":
    main()
