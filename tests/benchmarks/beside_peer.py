"""A peer and the model on the same trials of the same knee, in one run."""

import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from knees import knee
from requirement_rows import Measure, median_of

from identknee.laxity.protocol import LOADS, Protocol, trial_name
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.examples import FOLDER

HERE = Path(__file__).parent
SUBJECT = "lenhart2015_stable"
MESH = "medium"
RUNS = 100


def peer_record(python: str, script: str, *options: str) -> dict[str, Any]:
    """What a peer's script writes after solving its trials."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "record.json"
        command = [python, str(HERE / script), "--subject", str(FOLDER / SUBJECT), "--mesh", MESH]
        subprocess.run([*command, *options, "--out", str(out)], check=True)
        record: dict[str, Any] = json.loads(out.read_text("utf-8"))
    return record


def compared(record: dict[str, Any], flexion_deg: float, bar: float) -> list[Measure]:
    """How many times as long the peer took for a trial that it solved at one flexion angle."""
    at_angle = [x for x in record["trials"] if x["trial"]["flexion_deg"] == flexion_deg]
    solved = [x for x in at_angle if x["solved"]]
    seconds = np.array([x["seconds"] for x in solved])
    model = LaxityModel(knee=knee(SUBJECT), protocol=_protocol(at_angle))
    own = _seconds_a_trial(model)
    where = f"{flexion_deg:g} deg"
    measures = [
        median_of(
            "times as fast a trial, ours with sensitivities",
            seconds / own,
            "",
            bar=bar,
            at_least=True,
        ),
        median_of(f"{record['version']}, seconds a trial solved at {where}", seconds, "s"),
        Measure(what="ours, a trial", value=1000.0 * own, unit="ms", count=RUNS),
        Measure(what=f"trials solved at {where}", value=len(solved), unit=f"of {len(at_angle)}"),
    ]
    for angle, group in record["by_flexion_deg"].items():
        if float(angle) != flexion_deg:
            failed = group["trials"] - group["solved"]
            what = f"trials not solved at {angle} deg"
            measures.append(Measure(what=what, value=failed, unit=f"of {group['trials']}"))
    return measures


def agreement(record: dict[str, Any], flexion_deg: float) -> str:
    """How far the peer's poses are from the model's, in a sentence."""
    solved = [
        x for x in record["trials"] if x["solved"] and x["trial"]["flexion_deg"] == flexion_deg
    ]
    model = LaxityModel(knee=knee(SUBJECT), protocol=_protocol(solved))
    poses = np.array(model.predict(model.parameters.center, derivatives=False).poses)
    poses[:, :2] = np.degrees(poses[:, :2])
    difference = np.abs(poses - np.array([x["pose"] for x in solved]))
    angles, lengths = difference[:, :2].max(axis=1), difference[:, 2:].max(axis=1)
    return (
        f"{record['peer']}'s poses differ from ours by {np.median(angles):.2f} deg and "
        f"{np.median(lengths):.2f} mm in the median of the trials solved at {flexion_deg:g} deg, "
        f"by {angles.max():.2f} deg and {lengths.max():.2f} mm at most; its residuals there are at "
        f"most {max(x['residual'] for x in solved):.2g} N; {SUBJECT}, {MESH} meshes "
        f"({sum(record['triangles'].values()):,} triangles), ours "
        f"{len(model.joint.contact.points):,} contact points"
    )


def _protocol(trials: list[dict[str, Any]]) -> Protocol:
    flexion = np.array([x["trial"]["flexion_deg"] for x in trials])
    loads = np.zeros((len(trials), len(LOADS)))
    loads[:, LOADS.index("varus_moment_Nm")] = [x["trial"]["varus"] for x in trials]
    loads[:, LOADS.index("internal_moment_Nm")] = [x["trial"]["internal"] for x in trials]
    names = tuple(
        trial_name(angle, row.tolist()) for angle, row in zip(flexion, loads, strict=True)
    )
    return Protocol(name="the peer's", trials=names, flexion_deg=flexion, loads=loads)


def _seconds_a_trial(model: LaxityModel) -> float:
    theta: Array = model.parameters.center
    if not model.predict(theta).all_converged:
        raise AssertionError
    seconds = []
    for _ in range(RUNS):
        began = time.perf_counter()
        model.predict(theta)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds)) / model.protocol.n
