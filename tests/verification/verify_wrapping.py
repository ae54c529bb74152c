"""Lines around obstacles against OpenSim's wrap objects: lengths, moment arms and laxity."""

import argparse
import json
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from knees import knee
from requirement_rows import Measure, Row
from scipy.spatial.transform import Rotation

from identknee.laxity.protocol import LOADS, Protocol, trial_name
from identknee.laxity.table import ROTATIONS, TRANSLATIONS
from identknee.mechanics.ligament_tensions import ligament_tensions
from identknee.mechanics.pose import coordinates_from_pose
from identknee.model.laxity_model import LaxityModel, lines_in_bones
from identknee.runs.declare import Array
from identknee.subject.examples import opensim_file
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.subject.ligament import Ligament, Obstacle
from identknee.subject.opensim import bones_of, imported_knee
from identknee.subject.opensim_model import MM_PER_M, OsimModel
from identknee.subject.opensim_wrap import wrap_objects

IMPORTED, SUBJECT, MESH = "lenhart2015", "lenhart2015_stable", "medium"
N_POSES, SEED, STEP = 100, 55, 1e-4
WORST = "the value is the largest"
SOLVED_N, STABLE_N_MM = 1.0, 1.0
# Cylinders of our own on the stable knee: the medial and the lateral rim of the plateau.
OBSTACLES = {
    "MCL": Obstacle(
        bone="tibia", centre=np.array([4.0, -46.0, -27.0]), radius_mm=9.0,
        axis=np.array([1.0, 0.0, 0.1]), side=np.array([0.0, 0.0, -1.0]),
    ),
    "LCL": Obstacle(
        bone="tibia", centre=np.array([-6.0, -24.0, 39.0]), radius_mm=7.0,
        axis=np.array([1.0, 0.0, 0.0]), side=np.array([0.0, 0.0, 1.0]),
    ),
}  # fmt: skip
BALL, PUSHED = 6.0, 2.0  # mm; radius of a sphere, and how far it pushes a line aside


def measure(options: argparse.Namespace) -> Row:
    """Lengths and moment arms of 100 poses of each path, and the poses of nine trials."""
    own = knee(SUBJECT)
    wrapped = own.with_ligaments([replace(x, wrap=OBSTACLES.get(x.name)) for x in own.ligaments])
    imported = _imported_paths()
    balls = [replace(x, wrap=_ball(x)) for x in own.ligaments]
    groups = {
        "cylinders": [x for x in imported if x[1]["kind"] == "cylinder"]
        + [(x, _wrap(x)) for x in wrapped.ligaments if x.wrap is not None],
        "spheres": [(x, _wrap(x)) for x in balls],
        "ellipsoids by cylinders": [x for x in imported if x[1]["kind"] == "ellipsoid"],
    }
    poses = _poses()
    moved = [poses + sign * STEP * np.eye(6)[k] for k in (1, 2) for sign in (1.0, -1.0)]
    record = _record(options.opensim_python, wrapped, groups, np.concatenate([poses, *moved]))
    measures, start = [], 0
    lengths, *ends = np.split(np.array(record["lengths"]), 5)
    slopes = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=2) / (2.0 * STEP)
    arms = np.array(record["arms"])[: len(poses), :, 1:3]
    for name, paths in groups.items():
        which = slice(start, start + len(paths))
        start = which.stop
        found = _own_lengths([x for x, _ in paths], poses)
        bar = None if "ellipsoids" in name else 0.1
        for what, ours, theirs, unit in (
            ("lengths", found[0], lengths[:, which], "mm"),
            ("slopes of lengths", found[1][:, :, :2], slopes[:, which], "mm a radian"),
        ):
            measures.append(
                Measure(
                    what=f"{name}: largest difference of {what}",
                    value=float(np.abs(ours - theirs).max()),
                    unit=unit,
                    count=ours.shape[0] * ours.shape[1],
                    interval=WORST,
                    bar=bar,
                )
            )
        measures.append(
            Measure(
                what=f"{name}: OpenSim's moment arms against the slope of its own lengths",
                value=float(np.abs(arms[:, which] - slopes[:, which]).max()),
                unit="mm a radian",
            )
        )
    measures += _laxity(wrapped, record["solutions"])
    return Row(
        line="wrapped lengths and moment arms, cylinders against OpenSim 4.6's WrapCylinder, 100 "
        "poses of each path: 0.1 mm, 0.1 mm a radian; laxity with cylinders: 0.1 mm, 0.2 deg",
        measures=measures,
        notes=[
            f"OpenSim {record['version']}; paths of {IMPORTED} and of {SUBJECT}: "
            + ", ".join(f"{len(x)} around {y}" for y, x in groups.items())
            + "; ours is nowhere longer than OpenSim's around a cylinder, whose way is not quite "
            "the shortest there, and whose moment arms are not the slopes of its lengths"
        ],
    )


def _imported_paths() -> list[tuple[Ligament, dict[str, Any]]]:
    """The ligaments of the OpenSim model that wrap, and what OpenSim is given for each."""
    model = OsimModel(opensim_file(IMPORTED))
    bones = bones_of(model)
    objects = wrap_objects(model, {"femur": bones.femur, "tibia": bones.tibia})
    names = {
        x.get("name"): x.findtext("GeometryPath/PathWrapSet/objects/PathWrap/wrap_object")
        for x in model.all_of("Blankevoort1991Ligament")
    }
    found = []
    for x in imported_knee(IMPORTED).knee.ligaments:
        if x.wrap is not None:
            made = objects[str(names[x.name])]
            frame = made.frame
            wrap = {
                "kind": made.element.tag.removeprefix("Wrap").lower(),
                "bone": made.bone,
                "centre": (frame.translation * MM_PER_M).tolist(),
                "turns": _turns(frame.rotation),
                "slack": x.length,
            }
            if wrap["kind"] == "ellipsoid":
                wrap["radii"] = (model.vector(made.element, "dimensions") * MM_PER_M).tolist()
            else:
                wrap["radius"] = x.wrap.radius_mm
            found.append((x, wrap))
    return found


def _ball(ligament: Ligament) -> Obstacle:
    """A sphere of the tibia that pushes the middle of a ligament forward in the scanned pose."""
    along = (ligament.tibia - ligament.femur) / np.linalg.norm(ligament.tibia - ligament.femur)
    forward = np.eye(3)[0] - along[0] * along
    middle = 0.5 * (ligament.femur + ligament.tibia)
    centre = middle - (BALL - PUSHED) * forward / np.linalg.norm(forward)
    return Obstacle(bone="tibia", centre=centre, radius_mm=BALL)


def _wrap(ligament: Ligament) -> dict[str, Any]:
    """What OpenSim is given for an obstacle of ours."""
    wrap = ligament.wrap
    assert wrap is not None
    turn = np.eye(3)
    if wrap.axis is not None:
        along = wrap.axis / np.linalg.norm(wrap.axis)
        side = np.array([0.0, 0.0, 1.0]) if wrap.side is None else wrap.side
        out = side - (side @ along) * along
        out /= np.linalg.norm(out)
        turn = np.column_stack([out, np.cross(along, out), along])
    return {
        "kind": "sphere" if wrap.axis is None else "cylinder",
        "bone": wrap.bone,
        "centre": wrap.centre.tolist(),
        "turns": _turns(turn),
        "radius": wrap.radius_mm,
        "quadrant": "all" if wrap.side is None else "x",
        "slack": ligament.length / (1.0 + 0.01 * ligament.reference_strain_pct),
    }


def _turns(rotation: Array) -> list[float]:
    return [float(x) for x in Rotation.from_matrix(rotation).as_euler("XYZ")]


def _poses() -> Array:
    """Flexion, varus, internal [rad], x, y, z [mm] of random poses."""
    rng = np.random.default_rng(SEED)
    angles = np.radians(rng.uniform([0.0, -4.0, -12.0], [90.0, 4.0, 12.0], (N_POSES, 3)))
    return np.column_stack([angles, rng.uniform(-3.0, 3.0, (N_POSES, 3))])


def _own_lengths(ligaments: list[Ligament], poses: Array) -> tuple[Array, Array]:
    """Lengths and lengthening by varus and internal rotation."""
    own = knee(SUBJECT).with_ligaments(ligaments)
    own = replace(own, groups=(), priors={}, limits=())
    lines = lines_in_bones(own)
    none = np.zeros(len(ligaments))
    found = ligament_tensions(lines, poses[:, 0], poses[:, 1:], none, none)
    return (1.0 + found.strains) * lines.reference_length, found.lengthening


def _record(
    python: str, wrapped: Knee, groups: dict[str, list[Any]], poses: Array
) -> dict[str, Any]:
    script = Path(__file__).parent / "opensim_wraps.py"
    every = [x for own in groups.values() for x in own]
    paths = [
        {"name": f"line_{i}", "femur": x.femur.tolist(), "tibia": x.tibia.tolist(), "wrap": wrap}
        for i, (x, wrap) in enumerate(every)
    ]
    given = {
        "paths": paths,
        "poses": poses.tolist(),
        "subject_wraps": [_wrap(x) if x.wrap is not None else {} for x in wrapped.ligaments],
    }
    with tempfile.TemporaryDirectory() as scratch:
        folder, file, out = (Path(scratch) / x for x in ("subject", "paths.json", "record.json"))
        write_subject(wrapped, folder)
        file.write_text(json.dumps(given), "utf-8")
        command = [python, str(script), "--subject", str(folder), "--mesh", MESH]
        subprocess.run([*command, "--paths", str(file), "--out", str(out)], check=True)
        found: dict[str, Any] = json.loads(out.read_text("utf-8"))
    return found


def _laxity(wrapped: Knee, solutions: list[dict[str, Any]]) -> list[Measure]:
    kept = [
        x
        for x in solutions
        if x["solved"] and x["residual"] <= SOLVED_N and x["least_stiffness"] >= STABLE_N_MM
    ]
    loads = np.zeros((len(kept), len(LOADS)))
    loads[:, LOADS.index("varus_moment_Nm")] = [x["trial"]["varus"] for x in kept]
    loads[:, LOADS.index("internal_moment_Nm")] = [x["trial"]["internal"] for x in kept]
    flexion = np.array([x["trial"]["flexion_deg"] for x in kept])
    names = [trial_name(a, load.tolist()) for a, load in zip(flexion, loads, strict=True)]
    protocol = Protocol(name="opensim", trials=tuple(names), flexion_deg=flexion, loads=loads)
    model = LaxityModel(knee=wrapped, protocol=protocol)
    found = model.predict(model.parameters.start, derivatives=False)
    pose = np.array([x["pose"] for x in kept])
    pose[:, :2] = np.radians(pose[:, :2])
    apart = np.abs(found.coordinates - coordinates_from_pose(pose))
    straight = LaxityModel(knee=knee(SUBJECT), protocol=protocol)
    other = straight.predict(straight.parameters.start, derivatives=False)
    moved = np.abs(found.coordinates - other.coordinates)
    return [
        Measure(
            what="laxity with two cylinders: largest difference of lengths",
            value=float(np.nanmax(apart[:, TRANSLATIONS])), unit="mm", bar=0.1,
            count=len(kept), interval=WORST,
        ),
        Measure(
            what="laxity with two cylinders: largest difference of angles",
            value=float(np.nanmax(apart[:, ROTATIONS])), unit="deg", bar=0.2,
            count=len(kept), interval=WORST,
        ),
        Measure(
            what="what the cylinders change in our laxity, largest angle",
            value=float(np.nanmax(moved[:, ROTATIONS])), unit="deg",
        ),
        Measure(
            what="trials that OpenSim does not solve or finds unstable",
            value=float(len(solutions) - len(kept)), unit="",
        ),
    ]  # fmt: skip
