"""Slow part of the study: fits with a geometry that is a little wrong.

Writes ``records/geometry_uncertainty.json``. Finished fits are kept in a store outside the
checkout, so that the same command resumes where it was stopped.
"""

import sys
import time
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

import identknee as ik

KNEE = "reference"
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
# The best of so many fits, from the first of so many starts that have a prediction.
FITS, STARTS = 4, 40
DIGITS = 5


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = parsed_options(__file__, "two geometries of some levels", replicates=120)
    n = options.replicates = 2 if options.quick else options.replicates
    levels = LEVELS[::3] if options.quick else LEVELS
    record = begun(
        options, [KNEE], levels=levels, noise_mm=NOISE_MM, noise_deg=NOISE_DEG, seed=SEED
    )
    knee = study_knee(KNEE)
    # Replicate after replicate, so that more of them go on where fewer ended.
    tasks = [
        {"kind": kind, "size": size, "replicate": r} for r in range(n) for kind, size in levels
    ]
    began = time.perf_counter()
    known = {"inputs": record["head"]["inputs"], "levels": levels, "seed": SEED}
    with working(options, **known) as kept:
        rows = kept(partial(replicate_row, knee), tasks, "fits")
    setting = true_setting(knee)
    record["knees"][KNEE] = rounded(
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
    record["seconds_last_run"] = rounded(time.perf_counter() - began, 3)
    write_record(options.record, record)
    say(f"written: {options.record.name}, {len(rows)} fits")


def replicate_row(knee: ik.Knee, task: Row) -> Row:
    """One noisy data set, fitted with one wrong geometry: errors and likelihood ratios."""
    its = true_setting(knee)
    seeds = np.random.SeedSequence((SEED, task["replicate"])).spawn(2)
    generator = np.random.default_rng(seeds[0])
    assumed, loads = with_error(knee, its.model.protocol, task, generator)
    # The data come from the true knee under the loads as they are, and say what was meant.
    simulated = its.model.with_protocol(loads).simulate(its.truth)
    nominal = ik.Laxity(protocol=its.model.protocol, coordinates=simulated.coordinates)
    laxity = ik.add_noise(nominal, sd_mm=NOISE_MM, sd_deg=NOISE_DEG, seed=seeds[1])
    model = ik.LaxityModel(knee=assumed, protocol=its.model.protocol)
    evaluator = ik.calibrate.Evaluator(
        ik.LaxityResiduals(model=model, laxity=laxity, weighting="noise")
    )
    best = best_fit(evaluator, its.truth, generator)
    row: Row = {**task, "outcome": best.outcome.value, "n_measured": int(laxity.is_measured.sum())}
    if not best.evaluation.is_finite:
        return {**row, "theta": None, "n_simulations": evaluator.n_simulations}
    parameters = model.parameters
    wanted: list[tuple[ik.calibrate.Quantity, float]] = [
        (ik.calibrate.ParameterQuantity(parameters=parameters, name=name), float(value))
        for name, value in zip(parameters.names, its.truth, strict=True)
    ]
    wanted += [
        (ik.model.quantity_named(model, f"{ligament}.tension_N@{trial}"), float(force))
        for (ligament, trial), force in zip(its.peaks, its.peak_forces, strict=True)
    ]
    deviances, best = constrained_deviances(evaluator, best, wanted)
    theta = best.evaluation.theta
    prediction = model.predict(theta)
    tensions = ik.model.tensions_of(model, prediction)
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


def best_fit(
    evaluator: ik.calibrate.Evaluator, truth: ik.runs.Array, generator: np.random.Generator
) -> ik.calibrate.ConstrainedFit:
    """The best of a few fits: from the truth, and from places of the box around it."""
    found: list[ik.calibrate.ConstrainedFit] = []
    for start in (truth, *ik.checks.box_sample(evaluator.parameters, STARTS, generator)):
        ended = ik.calibrate.minimise(evaluator, start)
        if ended.evaluation.is_finite or not found:
            found.append(ended)
        if sum(x.evaluation.is_finite for x in found) == FITS:
            break
    return min(found, key=lambda x: x.evaluation.deviance)


def standard_deviations(jacobian: ik.runs.Array) -> ik.runs.Array:
    """Standard deviations of the parameters by the information matrix, shape ``(p,)``."""
    return np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))


if __name__ == "__main__":
    main()
