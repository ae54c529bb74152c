"""Intervals of a model that lacks the capsule: as it is, and with what it may get wrong."""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from requirement_rows import Measure, Row
from work_store import work_store

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.laxity.table import COORDINATES, add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.limit_residuals import standard_loads
from identknee.model.quantities import PredictedQuantity, ligament_forces, quantity_named
from identknee.runs.declare import Array, BoolArray
from identknee.subject.capsule import with_capsule
from identknee.subject.knee import Uncertainty
from identknee.verbs.identification import identification

KNEES = ("reference", "lenhart2015_stable")
SD, N, EVERY = 0.3, 20, 10
LOG_SD, SD_PCT = 0.2, 1.0
# Forces that are asked for [N].
LEAST = 5.0
# Half-width of a 95 % interval in standard deviations.
WIDTH = 1.96
SIZES = ("none", "smooth", "structures")
JUDGED, BAR = "structures", 0.9
# Trials that were not fitted, at other angles, whose coordinates are predicted.
OTHERS = [
    "70 N anterior force, 45 deg",
    "70 N posterior force, 15 deg",
    "6 Nm varus moment, 45 deg",
    "6 Nm valgus moment, 15 deg",
    "4 Nm internal moment, 15 deg",
    "4 Nm external moment, 45 deg",
]


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row, again after every few data sets."""
    del options
    done: list[dict[str, Any]] = []
    with work_store("discrepancy", {"n": N, "sizes": SIZES}) as store:
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
    parameters = {
        x: value
        for x, value in zip(model.parameters.names, theta.tolist(), strict=True)
        if x.split(".")[0] in names
    }
    others = model.with_protocol(standard_loads(OTHERS)).simulate(theta).coordinates
    return {x: _covered(own, laxity, x, parameters, forces, others) for x in SIZES}


def _measured(laxity: ik.Laxity) -> set[str]:
    return {laxity.protocol.trials[i] for i in np.flatnonzero(laxity.is_measured.all(axis=1))}


def _covered(
    own: ik.Knee,
    laxity: ik.Laxity,
    size: str,
    parameters: dict[str, float],
    forces: dict[str, float],
    others: Array,
) -> dict[str, Any]:
    stated = Uncertainty(structures=1.0) if size == "structures" else own.uncertainty
    setup = identification(own.with_uncertainty(stated), laxity, discrepancy=size)
    found = fit(setup.problem, setup.start)
    jacobian = setup.problem.jacobian(found.theta)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    names = list(setup.problem.parameters.names)
    true, places = np.array([*parameters.values()]), [names.index(x) for x in parameters]
    sds = np.sqrt(np.diag(covariance))

    def predicted(quantities: list[PredictedQuantity]) -> tuple[Array, Array]:
        values, slopes = zip(*(x.evaluate(found.theta) for x in quantities), strict=True)
        spread = np.einsum("ni,ij,nj->n", np.array(slopes), covariance, np.array(slopes))
        return np.array(values), np.sqrt(spread)

    asked = [
        x for x in ligament_forces(setup.model) if forces.get(f"{x.what}@{x.trial}", 0.0) >= LEAST
    ]
    tensions, spreads = predicted(asked)
    of_forces = _holds(tensions, spreads, np.array([forces[f"{x.what}@{x.trial}"] for x in asked]))
    of_parameters = _holds(found.theta[places], sds[places], true)
    under = setup.model.with_protocol(standard_loads(OTHERS))
    coordinates = [quantity_named(under, f"{x}@{trial}") for trial in OTHERS for x in COORDINATES]
    of_others = _holds(*predicted(coordinates), others.ravel())
    return {
        "deviance": found.deviance,
        "n": laxity.n_values,
        "parameters": [int(of_parameters.sum()), of_parameters.size],
        "forces": [int(of_forces.sum()), of_forces.size],
        "predictions": [int(of_others.sum()), of_others.size],
        "width_N": float(2.0 * WIDTH * np.median(spreads)),
        "rms_N": float(
            np.sqrt(np.mean((tensions - [forces[f"{x.what}@{x.trial}"] for x in asked]) ** 2))
        ),
    }


def _holds(values: np.ndarray, sds: np.ndarray, truth: np.ndarray) -> BoolArray:
    return np.asarray(np.abs(values - truth) <= WIDTH * sds)


def _row(done: list[dict[str, Any]]) -> Row:
    measures = []
    for size in SIZES:
        found = [x[size] for x in done]
        for what in ("parameters", "forces", "predictions"):
            held, asked = np.sum([x[what] for x in found], axis=0)
            is_judged = size == JUDGED and what != "parameters"
            measures.append(
                Measure(
                    what=f"{what} within their 95 % intervals, discrepancy {size}",
                    value=float(held / asked),
                    unit="1",
                    bar=BAR if is_judged else None,
                    at_least=is_judged,
                    count=int(asked),
                )
            )
        for what, key in (
            ("median width of a force's interval", "width_N"),
            ("error of forces, root mean square, median", "rms_N"),
        ):
            measures.append(
                Measure(
                    what=f"{what}, discrepancy {size}",
                    value=float(np.median([x[key] for x in found])),
                    unit="N",
                    count=len(found),
                )
            )
    return Row(
        line="a model that lacks the capsule: coverage of forces and predictions with "
        "--discrepancy structures >= 90 %",
        measures=measures,
        notes=[
            (
                f"{len(done)} data sets of {', '.join(KNEES)} with capsule, noise {SD} mm and deg, "
                "true ligaments drawn around the subject's; the model has no capsule."
            ),
            (
                f"Intervals to first order at the fit; forces above {LEAST:g} N in trials of "
                f"seed63; predictions of all coordinates of {len(OTHERS)} other trials at 15 and "
                "45 deg."
            ),
        ],
    )
