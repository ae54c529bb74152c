"""Slow part of the study: fits whose geometry is a little wrong and said to be.

Writes ``records/uncertain_geometry.json``. Finished fits are kept in a store outside the checkout,
so that the same command resumes where it was stopped.
"""

import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common.records import (
    Row,
    begun,
    parsed_options,
    rounded,
    say,
    study_knee,
    working,
    write_record,
)
from common.wrong_geometry import constrained_deviances, true_setting, with_error
from scipy.spatial.transform import Rotation

import identknee as ik
from identknee.runs.errors import NotComputable
from identknee.subject.knee import Uncertainty
from identknee.verbs.identification import identification

KNEE = "reference"
NOISE_MM, NOISE_DEG = 0.5, 0.5
SEED = 14
# Sd of each coordinate of each insertion [mm], and of the turn [deg] and shift [mm] of each bone's
# frame about and along each of its axes.
LEVELS: tuple[tuple[float, float], ...] = (
    (0.0, 0.0),
    (1.0, 0.0),
    (2.0, 0.0),
    (4.0, 0.0),
    (8.0, 0.0),
    (0.0, 2.0),
    (2.0, 2.0),
)
DIGITS = 5


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = parsed_options(__file__, "two geometries of some levels", replicates=40, diagnosed=4)
    n = options.replicates = 2 if options.quick else options.replicates
    n_diagnosed = options.diagnosed = 0 if options.quick else options.diagnosed
    levels = LEVELS[:3] if options.quick else LEVELS
    record = begun(
        options, [KNEE], levels=levels, noise_mm=NOISE_MM, noise_deg=NOISE_DEG, seed=SEED
    )
    knee = study_knee(KNEE)
    # Replicate after replicate, so that more of them go on where fewer ended.
    tasks = [
        {"insertions_mm": mm, "frames": frames, "replicate": r}
        for r in range(n)
        for mm, frames in levels
    ]
    began = time.perf_counter()
    known = {"inputs": record["head"]["inputs"], "levels": levels, "seed": SEED}
    with working(options, **known) as kept:
        rows = kept(partial(replicate_row, knee), tasks, "fits")
        diagnosed = [x for x in tasks if x["replicate"] < n_diagnosed]
        verdicts = kept(partial(verdict_row, knee), diagnosed, "diagnoses")
    its = true_setting(knee)
    record["knees"][KNEE] = rounded(
        {
            "parameters": list(its.model.parameters.names),
            "truth": its.truth,
            "forces": [f"{x}@{trial}" for x, trial in its.peaks],
            "true_forces": its.peak_forces,
            "fits": rows,
            "verdicts": verdicts,
        },
        DIGITS,
    )
    record["seconds_last_run"] = rounded(time.perf_counter() - began, 3)
    write_record(options.record, record)
    say(f"written: {options.record.name}, {len(rows)} fits")


def given(knee: ik.Knee, task: Row) -> tuple[ik.Knee, ik.Laxity]:
    """The knee as it is given, saying how wrong it may be, and noisy data of the true one."""
    its = true_setting(knee)
    size, frames = task["insertions_mm"], task["frames"]
    seeds = np.random.SeedSequence((SEED, task["replicate"])).spawn(2)
    generator = np.random.default_rng(seeds[0])
    assumed, _ = with_error(
        knee, its.model.protocol, {"kind": "insertions", "size": size}, generator
    )
    assumed = replace(
        assumed,
        femur_frame=moved(assumed.femur_frame, frames, generator),
        tibia_frame=moved(assumed.tibia_frame, frames, generator),
    )
    stated = Uncertainty(insertions_mm=size, registration_deg=frames, registration_mm=frames)
    laxity = ik.add_noise(
        its.model.simulate(its.truth), sd_mm=NOISE_MM, sd_deg=NOISE_DEG, seed=seeds[1]
    )
    return assumed.with_uncertainty(stated), laxity


def moved(frame: ik.subject.Frame, size: float, generator: np.random.Generator) -> ik.subject.Frame:
    """A frame turned about its own axes by normal angles [deg] and shifted along them [mm]."""
    turn = Rotation.from_rotvec(np.radians(size) * generator.normal(size=3)).as_matrix()
    shift = size * generator.normal(size=3)
    return ik.subject.Frame(origin=frame.origin + frame.axes.T @ shift, axes=turn.T @ frame.axes)


def replicate_row(knee: ik.Knee, task: Row) -> Row:
    """One data set fitted on one given knee: errors, claimed widths and likelihood ratios."""
    began = time.perf_counter()
    its = true_setting(knee)
    names = its.model.parameters.names
    assumed, laxity = given(knee, task)
    try:
        setup = identification(assumed, laxity)
    except NotComputable:
        return {**task, "theta": None}
    evaluator = ik.calibrate.Evaluator(setup.problem)
    parameters = evaluator.parameters
    true_ligaments = np.array(parameters.center)
    true_ligaments[[parameters.index(x) for x in names]] = its.truth
    ends = [ik.calibrate.minimise(evaluator, x) for x in (setup.start, true_ligaments)]
    best = min(ends, key=lambda x: x.evaluation.deviance)
    if not best.evaluation.is_finite:
        return {**task, "theta": None}
    forces = [
        ik.model.quantity_named(setup.model, f"{ligament}.tension_N@{trial}")
        for ligament, trial in its.peaks
    ]
    wanted: list[tuple[ik.calibrate.Quantity, float]] = [
        (ik.calibrate.ParameterQuantity(parameters=parameters, name=name), float(value))
        for name, value in zip(names, its.truth, strict=True)
    ]
    wanted += list(zip(forces, map(float, its.peak_forces), strict=True))
    deviances, best = constrained_deviances(evaluator, best, wanted)
    theta = best.evaluation.theta
    covariance = np.linalg.pinv(best.evaluation.information, hermitian=True)
    values, gradients = zip(*(x.evaluate(theta) for x, _ in wanted), strict=True)
    sds = [float(np.sqrt(max(x @ covariance @ x, 0.0))) for x in gradients]
    return {
        **task,
        "outcome": best.outcome.value,
        "theta": values[: len(names)],
        "forces": values[len(names) :],
        "sd": sds,
        "deviance": best.evaluation.deviance,
        "ratios": [x - best.evaluation.deviance for x in deviances],
        "n_trials": int(setup.laxity.is_measured.any(axis=1).sum()),
        "n_simulations": evaluator.n_simulations,
        "seconds": time.perf_counter() - began,
    }


def verdict_row(knee: ik.Knee, task: Row) -> Row:
    """What a diagnosis of the same knee and data says."""
    assumed, laxity = given(knee, task)
    found = ik.diagnose(assumed, laxity, seed=SEED)
    return {**task, "verdict": found.verdict.value, "causes": [x.name for x in found.causes]}


if __name__ == "__main__":
    main()
