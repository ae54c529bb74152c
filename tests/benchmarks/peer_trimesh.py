"""The same equilibria as a Python user would solve them: trimesh queries and scipy's root finder.

Signed depth of every tibial vertex by trimesh.proximity.closest_point and the normal of the closest
femoral triangle, tributary areas, line ligaments, finite-difference Jacobian. Needs scipy and
trimesh with rtree; identknee is not imported.

    python tests/benchmarks/peer_trimesh.py --subject FOLDER --mesh medium --out FILE.json
"""

import contextlib
import math

import numpy as np
import peers
import scipy
import trimesh
from peers import Array, SearchEndedError, Subject, Timed, Trial
from scipy.optimize import root
from scipy.spatial.transform import Rotation

PRESSURE = 10.0  # N/mm3
TRANSITION_STRAIN = 0.03
DEEPEST = 5.0  # mm; farther behind the sheet is past its rim
DIFFERENCE_STEP = 1e-4  # mm; far above rounding, far below a facet


class TrimeshKnee:
    """The femur, the tibial vertices with their areas, and the generalised residual."""

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self.femur = subject.meshes["femur"]
        tibia = [mesh for name, mesh in subject.meshes.items() if name != "femur"]
        self.points = np.concatenate([mesh.vertices for mesh in tibia])
        self.areas = np.concatenate(
            [
                np.bincount(
                    mesh.faces.ravel(), np.repeat(mesh.area_faces / 3.0, 3), len(mesh.vertices)
                )
                for mesh in tibia
            ]
        )

    def residual(self, flexion_deg: float, load: Array, x: Array) -> Array:
        """Generalised force that is missing [N], moments divided by 40 mm."""
        rotation, translation, turns = placement(flexion_deg, x)
        places = self.points @ rotation.T + translation
        closest, away, triangle = trimesh.proximity.closest_point(  # type: ignore[no-untyped-call]
            self.femur, places
        )
        normals = self.femur.face_normals[triangle]
        height = np.einsum("ij,ij->i", places - closest, normals)
        depth = np.where((height < 0.0) & (away < DEEPEST), -height, 0.0)
        points = [self.points, self.subject.tibial]
        forces = [(PRESSURE * self.areas * depth)[:, None] * normals]
        offset = self.subject.femoral - (self.subject.tibial @ rotation.T + translation)
        length = np.linalg.norm(offset, axis=1)
        strain = np.maximum(length / self.subject.slack_length - 1.0, 0.0)
        toe = strain**2 / (4.0 * TRANSITION_STRAIN)
        linear = strain - TRANSITION_STRAIN
        tension = self.subject.stiffness * np.where(strain < 2 * TRANSITION_STRAIN, toe, linear)
        forces.append((tension / length)[:, None] * offset)
        where, force = np.concatenate(points), np.concatenate(forces)
        moments = [np.sum(force * (where @ turn.T)) / peers.MM_PER_RADIAN for turn in turns]
        total: Array = np.concatenate([moments, rotation_z(flexion_deg).T @ force.sum(axis=0)])
        return total + load


def rotation_z(flexion_deg: float) -> Array:
    """Rz(-flexion)."""
    return turn_about(2, -math.radians(flexion_deg))


def turn_about(axis: int, angle: float) -> Array:
    """The rotation by `angle` [rad] about coordinate axis `axis`."""
    matrix: Array = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
    return matrix


def placement(flexion_deg: float, x: Array) -> tuple[Array, Array, tuple[Array, Array]]:
    """Rotation, translation, and the rotation's derivatives by varus and by internal rotation."""
    varus, internal = x[:2] / peers.MM_PER_RADIAN
    flexed, about_x, about_y = (
        rotation_z(flexion_deg),
        turn_about(0, varus),
        turn_about(1, internal),
    )
    cross_x, cross_y = np.cross(np.eye(3), [1.0, 0, 0]), np.cross(np.eye(3), [0, 1.0, 0])
    turns = (flexed @ cross_x @ about_x @ about_y, flexed @ about_x @ cross_y @ about_y)
    return flexed @ about_x @ about_y, flexed @ x[2:], turns


def solve(knee: TrimeshKnee, trial: Trial, start: Array, limit_s: float) -> Timed:
    """Search the trial's equilibrium from `start`; the best point found is in the result."""
    timed = Timed(lambda x: knee.residual(trial.flexion_deg, trial.load, x), limit_s)

    def slopes(x: Array) -> Array:
        here = timed(x)
        columns = [timed(x + DIFFERENCE_STEP * e) - here for e in np.eye(5)]
        return np.stack(columns, axis=1) / DIFFERENCE_STEP

    with contextlib.suppress(SearchEndedError):
        root(timed, start, jac=slopes, method="hybr", options={"xtol": 1e-10, "maxfev": 200})
    return timed


def main() -> None:
    """Run the benchmark: no load, 4 N m varus and 4 N m internal at 0 deg."""
    options = peers.benchmark_parser(__doc__, limit_s=300.0).parse_args()
    subject = peers.read_subject(options.subject, options.mesh)
    knee = TrimeshKnee(subject)
    after = 0 if options.start == "neighbour" else None
    trials = [
        Trial(0.0, 0.0, 0.0, after=None),
        Trial(0.0, 4.0, 0.0, after=after),
        Trial(0.0, 0.0, 4.0, after=after),
    ]
    solutions = peers.run_trials(
        trials[: options.trials],
        lambda trial, start, limit_s: solve(knee, trial, start, limit_s),
        lambda _: np.zeros(5),
        options.limit,
    )
    version = f"trimesh {trimesh.__version__}, scipy {scipy.__version__}"
    peers.write_record(options, "trimesh and scipy", version, subject, solutions)


if __name__ == "__main__":
    main()
