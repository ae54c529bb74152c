"""What the peers share: a subject read without identknee, the trials, and the record they write."""

import argparse
import json
import math
import platform
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Residual (5,) in N, moments divided by 40 mm, at x (5,) in mm, angles multiplied by 40 mm.
Residual = Callable[[Array], Array]

MESHES = Path(__file__).parent / "meshes"
MM_PER_RADIAN = 40.0
SCALE = np.array([MM_PER_RADIAN, MM_PER_RADIAN, 1.0, 1.0, 1.0])
ENOUGH_N = 1e-6  # what identknee's own equilibria must reach: no peer is asked for more
SOLVED_N = 1.0  # a residual above this is no solution by anyone's standard
DRIFT_MM = 10.0  # about 15 deg: a 2 N m step that moves farther has left its equilibrium


@dataclass(frozen=True)
class Subject:
    """Meshes (femur, tibia medial, tibia lateral) and line ligaments; mm and N."""

    name: str
    meshes: dict[str, trimesh.Trimesh]
    ligaments: tuple[str, ...]
    femoral: Array
    tibial: Array
    stiffness: Array
    strain: Array

    @property
    def slack_length(self) -> Array:
        """Equation 4 of the paper [mm]."""
        length: Array = np.linalg.norm(self.femoral - self.tibial, axis=1) / (1.0 + self.strain)
        return length


@dataclass(frozen=True)
class Trial:
    """A flexion angle and two moments [N m]; `after` is the trial it starts from."""

    flexion_deg: float
    varus: float
    internal: float
    after: int | None

    @property
    def load(self) -> Array:
        """Of (varus, internal, x, y, z), moments divided by 40 mm [N]."""
        return np.array([self.varus, self.internal, 0.0, 0.0, 0.0]) * 1e3 / MM_PER_RADIAN


@dataclass
class Solution:
    """How one trial went.

    The residual is in N, moments divided by 40 mm; the pose is varus, internal [deg], x, y, z [mm]
    in flexed axes.
    """

    trial: Trial
    seconds: float
    residual: float
    evaluations: int
    solved: bool
    reason: str
    pose: list[float] = field(default_factory=list)


class SearchEndedError(Exception):
    """The residual is small enough or the trial's time is up; the best so far counts."""


class Timed:
    """A residual that counts its calls, keeps the best point, and ends the search in time."""

    def __init__(self, residual: Residual, limit_s: float) -> None:
        self.residual, self.limit_s, self.start = residual, limit_s, time.perf_counter()
        self.evaluations, self.best, self.best_size = 0, np.zeros(5), math.inf

    def __call__(self, x: Array) -> Array:
        """The residual at x."""
        if self.seconds > self.limit_s:
            raise SearchEndedError
        value = self.residual(x)
        self.evaluations += 1
        size = float(np.linalg.norm(value))
        if size < self.best_size:
            self.best, self.best_size = np.array(x), size
        if size <= ENOUGH_N:
            raise SearchEndedError
        return value

    @property
    def seconds(self) -> float:
        """Since it was made."""
        return time.perf_counter() - self.start


def read_subject(folder: Path, mesh: str) -> Subject:
    """The subject in `folder` with its "full" meshes, or with coarser ones of lenhart2015."""
    with (folder / "subject.toml").open("rb") as file:
        content = tomllib.load(file)
    frames = content.get("frames", {}).values()
    if not all(np.allclose(f["axes"], np.eye(3)) and not np.any(f["origin"]) for f in frames):
        raise SystemExit(f"{folder}: the peers need both frames to be the common frame")
    files = {name: folder / relative for name, relative in content["surfaces"].items()}
    if mesh != "full":
        files = {name: MESHES / f"{name}_{mesh}.ply" for name in files}
    meshes = {name: trimesh.load_mesh(file) for name, file in files.items()}
    lines = content["ligaments"]
    return Subject(
        name=content["name"],
        meshes=meshes,
        ligaments=tuple(line["name"] for line in lines),
        femoral=np.array([line["femur"] for line in lines]),
        tibial=np.array([line["tibia"] for line in lines]),
        stiffness=1e3 * np.array([line["stiffness_kN"] for line in lines]),
        strain=1e-2 * np.array([line["reference_strain_pct"] for line in lines]),
    )


def rays(flexion_deg: float, largest_Nm: int, unloaded: int) -> Iterator[Trial]:
    """Varus, valgus, internal and external trials in 2 N m steps; `unloaded` is their first start.

    They are meant to follow the unloaded trial at once, which their numbers in `after` rely on.
    """
    number = unloaded
    for axis in range(2):
        for sign in (1.0, -1.0):
            previous = unloaded
            for size in range(2, largest_Nm + 1, 2):
                varus, internal = (sign * size, 0.0) if axis == 0 else (0.0, sign * size)
                yield Trial(flexion_deg, varus, internal, after=previous)
                number += 1
                previous = number


def benchmark_parser(description: str | None, *, limit_s: float) -> argparse.ArgumentParser:
    """The options that all peers have."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--subject", type=Path, required=True, help="folder with subject.toml")
    parser.add_argument("--mesh", choices=("full", "medium", "coarse"), default="medium")
    parser.add_argument("--trials", type=int, default=None, help="only the first so many")
    parser.add_argument("--limit", type=float, default=limit_s, help="seconds a trial may take")
    parser.add_argument(
        "--start",
        choices=("neighbour", "reference"),
        default="neighbour",
        help="where a trial's search begins: the pose of the load 2 N m smaller, or the pose zero",
    )
    parser.add_argument("--out", type=Path, required=True, help="JSON file to write")
    return parser


def run_trials(
    trials: list[Trial],
    solve: Callable[[Trial, Array, float], Timed],
    start_of: Callable[[Trial], Array],
    limit_s: float,
) -> list[Solution]:
    """Every trial solved from the pose of the one it comes after, or from `start_of`."""
    solutions: list[Solution] = []
    ends: list[Array] = []
    for trial in trials:
        start = start_of(trial) if trial.after is None else ends[trial.after]
        run = solve(trial, start, limit_s)
        ends.append(run.best)
        moved = float(np.linalg.norm(run.best - start))
        reason = "solved"
        if run.best_size > SOLVED_N:
            late = run.seconds > limit_s
            reason = "out of time" if late else f"residual above {SOLVED_N:g} N"
        elif trial.after is not None and moved > DRIFT_MM:
            reason = f"moved {moved:.0f} mm in one load step"
        pose = run.best / SCALE
        pose[:2] = np.degrees(pose[:2])
        solutions.append(
            Solution(
                trial=trial,
                seconds=run.seconds,
                residual=run.best_size,
                evaluations=run.evaluations,
                solved=reason == "solved",
                reason=reason,
                pose=pose.tolist(),
            )
        )
        print(
            f"{trial.flexion_deg:3.0f} deg, varus {trial.varus:+3.0f}, internal "
            f"{trial.internal:+3.0f} N m: {run.seconds:7.2f} s, {run.evaluations:4d} "
            f"evaluations, residual {run.best_size:9.2e} N, {reason}",
            flush=True,
        )
    return solutions


def write_record(
    options: argparse.Namespace,
    peer: str,
    version: str,
    subject: Subject,
    solutions: list[Solution],
) -> None:
    """Write what was measured, and sums over the trials, as JSON."""
    solved = [s for s in solutions if s.solved]
    by_flexion = {
        f"{angle:g}": {
            "trials": len(group),
            "solved": sum(s.solved for s in group),
            "seconds": sum(s.seconds for s in group),
        }
        for angle in sorted({s.trial.flexion_deg for s in solutions})
        for group in [[s for s in solutions if s.trial.flexion_deg == angle]]
    }
    record = {
        "peer": peer,
        "version": version,
        "python": platform.python_version(),
        "subject": subject.name,
        "mesh": options.mesh,
        "start": options.start,
        "triangles": {name: len(sheet.faces) for name, sheet in subject.meshes.items()},
        "n_trials": len(solutions),
        "n_solved": len(solved),
        "n_solved_to_1e-6_N": sum(s.residual <= ENOUGH_N for s in solved),
        "median_seconds_solved": float(np.median([s.seconds for s in solved])) if solved else None,
        "total_seconds": sum(s.seconds for s in solutions),
        "by_flexion_deg": by_flexion,
        "trials": [asdict(s) for s in solutions],
    }
    options.out.write_text(json.dumps(record, indent=1) + "\n")
