"""Laxity that OpenSim made, intact and with a ligament removed: poses, and the joint fit."""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from experiment_replicates import rises_to_truth
from knees import knee
from requirement_rows import Measure, Row
from scipy.stats import chi2

from identknee.laxity.protocol import LOADS, Protocol, trial_name
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity, add_noise
from identknee.mechanics.pose import coordinates_from_pose
from identknee.model.laxity_model import LaxityModel
from identknee.subject.examples import FOLDER
from identknee.verbs.identification import identification

SUBJECT, CUT, MESH, SD, SEED, LEVEL = "lenhart2015_stable", "MCL", "medium", 0.3, 46, 0.95
STABLE_N_MM = 1.0  # a pose with less is one that facets of a mesh hold
SOLVED_N = 1.0


def measure(options: argparse.Namespace) -> Row:
    """Poses of OpenSim beside ours, and the rise of the deviance to each true parameter."""
    record = _record(options.opensim_python)
    laxity, lost = _laxity(record)
    own = LaxityModel(knee=knee(SUBJECT), protocol=laxity.protocol)
    found = own.predict(own.parameters.center, derivatives=False)
    apart = np.abs(found.coordinates - laxity.coordinates)
    noisy = add_noise(laxity, sd_mm=SD, sd_deg=SD, seed=SEED)
    setup = identification(knee(SUBJECT), noisy)
    p = own.parameters
    truth = dict(zip(p.names, p.center.tolist(), strict=True))
    fitted = rises_to_truth(setup, truth)
    outside = np.array(fitted["rises"]) > float(chi2.ppf(LEVEL, 1))
    cut = np.array(laxity.protocol.state) != "intact"
    note = (
        f"OpenSim {record['version']}, {SUBJECT}, {MESH} meshes, {CUT} removed, 0 deg, up to "
        f"4 N·m: {len(cut)} trials stable there, {lost} not solved or not stable; noise of {SD} mm "
        f"and deg added for the fit, deviance {fitted['deviance']:.0f} of {fitted['n_values']} "
        f"values; rises to the truth {', '.join(f'{x:.2f}' for x in fitted['rises'])}"
    )
    return Row(
        line="laxity made by OpenSim 4.6 with a ligament removed, trials that are stable there: "
        "joint fit of intact and cut: parameters within their intervals, poses to 0.1 mm and "
        "0.1 deg",
        measures=[
            _bar("largest difference of lengths", _most(apart[:, TRANSLATIONS]), "mm", 0.1),
            _bar("largest difference of angles", _most(apart[:, ROTATIONS]), "deg", 0.1),
            _bar("parameters outside their 95 % intervals", float(outside.sum()), "of 8", 0.0),
            _bar("trials that we lose", float((~found.is_converged).sum()), "", 0.0),
            Measure(
                what="trials with the ligament removed",
                value=float(cut.sum()),
                unit="",
                bar=4.0,
                at_least=True,
            ),
        ],
        notes=[note],
    )


def _record(python: str) -> dict[str, Any]:
    """What the script beside this one writes."""
    script = Path(__file__).parent / "opensim_knee.py"
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "record.json"
        command = [python, str(script), "--subject", str(FOLDER / SUBJECT), "--mesh", MESH]
        subprocess.run([*command, "--cut", CUT, "--out", str(out)], check=True)
        found: dict[str, Any] = json.loads(out.read_text("utf-8"))
    return found


def _laxity(record: dict[str, Any]) -> tuple[Laxity, int]:
    """The laxity of the trials that are stable in OpenSim, and how many are not."""
    rows = [
        (state, x)
        for state, solutions in record["states"].items()
        for x in solutions
        if x["solved"] and x["residual"] <= SOLVED_N and x["least_stiffness"] >= STABLE_N_MM
    ]
    trials = [x["trial"] for _, x in rows]
    flexion = np.array([x["flexion_deg"] for x in trials])
    loads = np.zeros((len(rows), len(LOADS)))
    loads[:, LOADS.index("varus_moment_Nm")] = [x["varus"] for x in trials]
    loads[:, LOADS.index("internal_moment_Nm")] = [x["internal"] for x in trials]
    names = [trial_name(a, load.tolist()) for a, load in zip(flexion, loads, strict=True)]
    cut = [state != "intact" for state, _ in rows]
    protocol = Protocol(
        name="opensim",
        trials=tuple(f"{x}_cut" if y else x for x, y in zip(names, cut, strict=True)),
        flexion_deg=flexion,
        loads=loads,
        state=tuple(state for state, _ in rows),
    )
    pose = np.array([x["pose"] for _, x in rows])
    pose[:, :2] = np.radians(pose[:, :2])
    total = sum(len(x) for x in record["states"].values())
    return Laxity(protocol=protocol, coordinates=coordinates_from_pose(pose)), total - len(rows)


def _bar(what: str, value: float, unit: str, bar: float) -> Measure:
    return Measure(what=what, value=value, unit=unit, bar=bar)


def _most(values: np.ndarray) -> float:
    return float(np.nanmax(values))
