"""Intervals of a model that lacks the capsule, with a smooth error of the model and without."""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from requirement_rows import Measure, Row
from work_store import work_store

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.laxity.table import add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.quantities import ligament_forces
from identknee.runs.declare import BoolArray
from identknee.subject.capsule import with_capsule
from identknee.verbs.identification import identification

KNEES = ("reference", "lenhart2015_stable")
SD, N, EVERY = 0.3, 20, 10
LOG_SD, SD_PCT = 0.2, 1.0
# Forces that are asked for [N].
LEAST = 5.0
# Half-width of a 95 % interval in standard deviations.
WIDTH = 1.96
SIZES = ("none", "smooth")


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row, again after every few data sets."""
    del options
    done: list[dict[str, Any]] = []
    with work_store("discrepancy", {"n": N}) as store:
        tasks = [(name, i) for i in range(N) for name in KNEES]
        for k, (name, number) in enumerate(tasks):
            key = f"{name} {number}"
            if (found := store.get(key)) is None:
                found = _outcome(name, 380_000 + number)
                store.put_many({key: found})
            done.append(found)
            if (k + 1) % EVERY == 0:
                yield _row(done)


def _outcome(name: str, seed: int) -> dict[str, Any]:
    """Of how many parameters and forces the intervals hold the truth, and their widths."""
    own, generator = ik.read_subject(name), np.random.default_rng(seed)
    ligaments = [
        replace(
            x,
            stiffness_kN=x.stiffness_kN * float(np.exp(generator.normal(0.0, LOG_SD))),
            reference_strain_pct=x.reference_strain_pct + float(generator.normal(0.0, SD_PCT)),
        )
        for x in own.ligaments
    ]
    truth = with_capsule(own.with_ligaments(ligaments))
    model = LaxityModel(knee=truth, protocol=ik.load_protocol("seed63"))
    theta = np.array(model.parameters.start)
    exact = model.simulate(theta)
    laxity = add_noise(exact, sd_mm=SD, sd_deg=SD, seed=seed)
    names = [x.name for x in own.ligaments]
    prediction = model.predict_once(theta)
    forces = {
        f"{x.what}@{x.trial}": x.value(prediction)
        for x in ligament_forces(model)
        if x.what.split(".")[0] in names and x.trial in _measured(laxity)
    }
    parameters = dict(zip(model.parameters.names, theta, strict=True))
    return {x: _covered(own, laxity, x, parameters, forces) for x in SIZES}


def _measured(laxity: ik.Laxity) -> set[str]:
    return {laxity.protocol.trials[i] for i in np.flatnonzero(laxity.is_measured.all(axis=1))}


def _covered(
    own: ik.Knee,
    laxity: ik.Laxity,
    size: str,
    parameters: dict[str, float],
    forces: dict[str, float],
) -> dict[str, Any]:
    setup = identification(own, laxity, discrepancy=size)
    found = fit(setup.problem, setup.start)
    jacobian = setup.problem.jacobian(found.theta)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    true = np.array([parameters[x] for x in setup.problem.parameters.names])
    sds = np.sqrt(np.diag(covariance))
    asked, values, spreads = [], [], []
    for quantity in ligament_forces(setup.model):
        expected = forces.get(f"{quantity.what}@{quantity.trial}", 0.0)
        if expected < LEAST:
            continue
        value, slope = quantity.evaluate(found.theta)
        asked.append(expected)
        values.append(value)
        spreads.append(float(np.sqrt(slope @ covariance @ slope)))
    of_forces = _holds(np.array(values), np.array(spreads), np.array(asked))
    of_parameters = _holds(found.theta, sds, true)
    return {
        "deviance": found.deviance,
        "n": laxity.n_values,
        "parameters": [int(of_parameters.sum()), of_parameters.size],
        "forces": [int(of_forces.sum()), of_forces.size],
        "width_N": float(2.0 * WIDTH * np.median(spreads)),
    }


def _holds(values: np.ndarray, sds: np.ndarray, truth: np.ndarray) -> BoolArray:
    return np.asarray(np.abs(values - truth) <= WIDTH * sds)


def _row(done: list[dict[str, Any]]) -> Row:
    measures = []
    for size in SIZES:
        found = [x[size] for x in done]
        for what in ("parameters", "forces"):
            held, asked = np.sum([x[what] for x in found], axis=0)
            is_barred = size == "smooth" and what == "forces"
            measures.append(
                Measure(
                    what=f"{what} within their 95 % intervals, discrepancy {size}",
                    value=float(held / asked),
                    unit="1",
                    bar=0.9 if is_barred else None,
                    at_least=is_barred,
                    count=int(asked),
                )
            )
        measures.append(
            Measure(
                what=f"median width of a force's interval, discrepancy {size}",
                value=float(np.median([x["width_N"] for x in found])),
                unit="N",
                count=len(found),
            )
        )
    return Row(
        line="a model that lacks the capsule: coverage with a smooth error of the model",
        measures=measures,
        notes=[
            (
                f"{len(done)} data sets of {', '.join(KNEES)} with capsule, noise {SD} mm and deg, "
                "true ligaments drawn around the subject's; the model has no capsule."
            ),
            f"Intervals to first order at the fit; forces above {LEAST:g} N in trials of seed63.",
        ],
    )
