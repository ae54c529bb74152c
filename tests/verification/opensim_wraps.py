"""Paths around cylinders, spheres and ellipsoids in OpenSim 4.6, and laxity with such paths.

python tests/verification/opensim_wraps.py --subject FOLDER --paths FILE.json --out FILE.json

The ends, wrap objects and poses of the paths come from the file; the subject's ligaments may wrap
around cylinders. identknee is not imported.
"""

import json
import sys
import tempfile
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import peers
from opensim_knee import beginning, least_stiffness
from peer_opensim import COORDINATES, METRES, OpenSimKnee, flexed_axes, solve

LARGEST_NM = 4
# Both parts of a coordinate's number in the joint: what a moment arm in m, or of a shift, is in mm.
ARM_UNITS = (1.0 / METRES, 1.0 / METRES, 1.0 / METRES, 1.0, 1.0, 1.0)


class WrappedKnee(OpenSimKnee):
    """The knee of a subject whose ligaments wrap as asked."""

    def __init__(self, subject: peers.Subject, wraps: list[dict[str, Any]], folder: Path) -> None:
        self.wraps = wraps
        super().__init__(subject, folder)

    # What runs this has no typing_extensions.
    def _add_ligaments(self, subject: peers.Subject) -> None:  # type: ignore[explicit-override]
        super()._add_ligaments(subject)
        opensim = self.opensim
        for i, wrap in enumerate(self.wraps):
            if not wrap:
                continue
            name = f"wrap_{i}"
            made = getattr(opensim, f"Wrap{wrap['kind'].capitalize()}")()
            made.setName(name)
            made.set_translation(opensim.Vec3(*(np.array(wrap["centre"]) * METRES)))
            made.set_xyz_body_rotation(opensim.Vec3(*wrap["turns"]))
            made.set_quadrant(wrap.get("quadrant", "all"))
            if wrap["kind"] == "ellipsoid":
                made.set_dimensions(opensim.Vec3(*(np.array(wrap["radii"]) * METRES)))
            else:
                made.set_radius(wrap["radius"] * METRES)
            if wrap["kind"] == "cylinder":
                made.set_length(1.0)
            tibia = self.model.getBodySet().get("tibia")
            frame = self.model.getGround() if wrap["bone"] == "femur" else tibia
            frame.addWrapObject(made)
            line = opensim.Blankevoort1991Ligament.safeDownCast(
                self.model.getForceSet().get(subject.ligaments[i])
            )
            line.updGeometryPath().addPathWrap(made)
            line.set_slack_length(float(wrap["slack"] * METRES))

    def lengths(self, subject: peers.Subject, poses: np.ndarray) -> tuple[list[Any], list[Any]]:
        """Lengths [mm] and moment arms by coordinate of every path, in femoral axes."""
        lengths, arms = [], []
        coordinates = [self.model.getCoordinateSet().get(x) for x in COORDINATES]
        paths = [
            self.opensim.Blankevoort1991Ligament.safeDownCast(
                self.model.getForceSet().get(name)
            ).getGeometryPath()
            for name in subject.ligaments
        ]
        for pose in poses:
            q = self.opensim.Vector(6, 0.0)
            shift = flexed_axes(float(np.degrees(pose[0]))) @ pose[3:] * METRES
            for place, value in zip(self.position, [*pose[:3], *shift], strict=True):
                q.set(place, float(value))
            self.state.setQ(q)
            self.state.setU(self.rest)
            self.model.realizePosition(self.state)
            lengths.append([x.getLength(self.state) / METRES for x in paths])
            arms.append(
                [
                    [
                        -x.computeMomentArm(self.state, c) * unit
                        for c, unit in zip(coordinates, ARM_UNITS, strict=True)
                    ]
                    for x in paths
                ]
            )
        return lengths, arms


def main() -> None:
    """Write the lengths and moment arms of the paths, and the poses of the subject's trials."""
    parser = peers.benchmark_parser(__doc__, limit_s=90.0)
    parser.add_argument("--paths", type=Path, required=True)
    options = parser.parse_args()
    given = json.loads(options.paths.read_text("utf-8"))
    whole = peers.read_subject(options.subject, options.mesh)
    with tempfile.TemporaryDirectory() as folder:
        paths = given["paths"]
        lines = replace(
            whole,
            ligaments=tuple(x["name"] for x in paths),
            femoral=np.array([x["femur"] for x in paths]),
            tibial=np.array([x["tibia"] for x in paths]),
            stiffness=np.full(len(paths), 1e3),
            strain=np.zeros(len(paths)),
        )
        knee = WrappedKnee(lines, [x["wrap"] for x in paths], Path(folder))
        lengths, arms = knee.lengths(lines, np.array(given["poses"]))
    trials = [peers.Trial(0.0, 0.0, 0.0, after=None), *peers.rays(0.0, LARGEST_NM, 0)]
    with tempfile.TemporaryDirectory() as folder:
        knee = WrappedKnee(whole, given["subject_wraps"], Path(folder))
        found = peers.run_trials(
            trials, partial(solve, knee), partial(beginning, np.zeros(5)), options.limit
        )
        solved = [asdict(x) | {"least_stiffness": least_stiffness(knee, x)} for x in found]
        version = knee.opensim.GetVersion()
    record = {"version": version, "lengths": lengths, "arms": arms, "solutions": solved}
    options.out.write_text(json.dumps(record) + "\n", "utf-8")


if __name__ == "__main__":
    main()
