"""The peer: the same knee in OpenSim 4.6, solved for static equilibrium through scipy.

Blankevoort1991Ligament lines, ElasticFoundationForce between closed meshes, a CustomJoint with the
rotation order of the paper. OpenSim has no static solver for this, so scipy's least squares drives
the residual of its InverseDynamicsSolver to zero, trial by trial from the neighbouring load. Needs
opensim==4.6, scipy and trimesh; identknee is not imported.

    python tests/benchmarks/peer_opensim.py --subject FOLDER --mesh medium --out FILE.json
"""

import contextlib
import math
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import peers
import trimesh
from peers import Array, SearchEndedError, Subject, Timed, Trial
from scipy.optimize import least_squares

CONTACT_STIFFNESS = 1e10  # Pa/m, the paper's 10 GN/m3
TRANSITION_STRAIN = 0.06  # where the toe ends: twice the paper's epsilon_1
THICKNESS = 3.0  # mm; Simbody needs closed surfaces, so the open sheets are extruded back
# mm; far above rounding and far below a facet. A search that stalls because a facet's jump falls
# within the step, and is no solution yet, is taken up again with the coarser one.
DIFFERENCE_STEPS = (1e-4, 1e-2)
FLEXION_STEP = 10.0  # deg
METRES = 1e-3
COORDINATES = ("flexion", "varus", "internal", "x", "y", "z")


def extruded(sheet: trimesh.Trimesh, thickness: float) -> trimesh.Trimesh:
    """A closed surface: the sheet, its copy moved back along its normals, and walls between."""
    n = len(sheet.vertices)
    vertices = np.concatenate([sheet.vertices, sheet.vertices - thickness * sheet.vertex_normals])
    edges = sheet.edges
    ordered = np.sort(edges, axis=1)
    _, first, count = np.unique(ordered, axis=0, return_index=True, return_counts=True)
    a, b = edges[first[count == 1]].T
    walls = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    faces = np.concatenate([sheet.faces, sheet.faces[:, ::-1] + n, walls])
    solid = trimesh.Trimesh(vertices=vertices, faces=faces, process=False)
    if not solid.is_watertight:
        raise SystemExit("a sheet could not be closed by extrusion")
    return solid


class OpenSimKnee:
    """The model, its state and the generalised residual."""

    def __init__(self, subject: Subject, folder: Path) -> None:
        import opensim

        opensim.Logger.setLevelString("Off")
        self.opensim = opensim
        self.model = opensim.Model()
        self.model.setName("knee")
        self.model.setGravity(opensim.Vec3(0))
        self._add_joint()
        self._add_contact(subject, folder)
        self._add_ligaments(subject)
        self.state = self.model.initSystem()
        self.solver = opensim.InverseDynamicsSolver(self.model)
        order = [self.model.getCoordinateSet().get(i).getName() for i in range(6)]
        self.position = [order.index(name) for name in COORDINATES]
        self.rest = opensim.Vector(6, 0.0)

    def residual(self, flexion_deg: float, load: Array, x: Array) -> Array:
        """Generalised force that is missing [N], moments divided by 40 mm.

        `x` and the result are in flexed axes, OpenSim's joint in femoral ones.
        """
        turn = flexed_axes(flexion_deg)
        shift = turn @ x[2:] * METRES
        angles = [math.radians(flexion_deg), *(x[:2] / peers.MM_PER_RADIAN)]
        q = self.opensim.Vector(6, 0.0)
        for place, value in zip(self.position, [*angles, *shift], strict=True):
            q.set(place, float(value))
        self.state.setQ(q)
        self.state.setU(self.rest)
        needed = self.solver.solve(self.state, self.rest)
        force = np.array([needed.get(place) for place in self.position])
        moments = force[1:3] / METRES / peers.MM_PER_RADIAN
        balance: Array = np.concatenate([moments, turn.T @ force[3:]]) - load
        return balance

    def _add_joint(self) -> None:
        opensim = self.opensim
        tibia = opensim.Body("tibia", 1.0, opensim.Vec3(0), opensim.Inertia(0.01, 0.01, 0.01))
        self.model.addBody(tibia)
        axes = {"z": (0, 0, 1), "x": (1, 0, 0), "y": (0, 1, 0)}
        transform = opensim.SpatialTransform()
        parts = [
            (transform.updTransformAxis(i), name, axis, slope)
            for i, (name, axis, slope) in enumerate(
                [
                    ("flexion", "z", -1.0),
                    ("varus", "x", 1.0),
                    ("internal", "y", 1.0),
                    ("x", "x", 1.0),
                    ("y", "y", 1.0),
                    ("z", "z", 1.0),
                ]
            )
        ]
        for part, name, axis, slope in parts:
            names = opensim.ArrayStr()
            names.append(name)
            part.setCoordinateNames(names)
            part.setAxis(opensim.Vec3(*axes[axis]))
            part.set_function(opensim.LinearFunction(slope, 0.0))
        self.model.addJoint(
            opensim.CustomJoint(
                "knee",
                self.model.getGround(),
                opensim.Vec3(0),
                opensim.Vec3(0),
                tibia,
                opensim.Vec3(0),
                opensim.Vec3(0),
                transform,
            )
        )

    def _add_contact(self, subject: Subject, folder: Path) -> None:
        opensim = self.opensim
        zero = opensim.Vec3(0)
        tibia = self.model.getBodySet().get("tibia")
        for name, sheet in subject.meshes.items():
            path = folder / f"{name}.obj"
            solid = extruded(sheet, THICKNESS)
            solid.vertices *= METRES
            solid.export(path, digits=12)
            frame = self.model.getGround() if name == "femur" else tibia
            self.model.addContactGeometry(opensim.ContactMesh(str(path), zero, zero, frame, name))
        for name in subject.meshes:
            if name == "femur":
                continue
            force = opensim.ElasticFoundationForce()
            force.addGeometry("femur")
            force.addGeometry(name)
            force.setStiffness(CONTACT_STIFFNESS)
            force.setDissipation(0.0)
            force.setStaticFriction(0.0)
            force.setDynamicFriction(0.0)
            force.setViscousFriction(0.0)
            force.setName(f"contact_{name}")
            self.model.addForce(force)

    def _add_ligaments(self, subject: Subject) -> None:
        opensim = self.opensim
        tibia = self.model.getBodySet().get("tibia")
        for i, name in enumerate(subject.ligaments):
            line: Any = opensim.Blankevoort1991Ligament()
            line.setName(name)
            ends = ((self.model.getGround(), subject.femoral[i]), (tibia, subject.tibial[i]))
            for number, (frame, point) in enumerate(ends):
                place = opensim.Vec3(*(point * METRES))
                line.updGeometryPath().appendNewPathPoint(f"{name}_{number}", frame, place)
            line.set_linear_stiffness(float(subject.stiffness[i]))
            line.set_slack_length(float(subject.slack_length[i] * METRES))
            line.set_transition_strain(TRANSITION_STRAIN)
            line.set_damping_coefficient(0.0)
            self.model.addForce(line)


def flexed_axes(flexion_deg: float) -> Array:
    """Rz(-flexion): from the axes that turn with flexion to femoral ones."""
    c, s = math.cos(math.radians(flexion_deg)), math.sin(math.radians(flexion_deg))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def solve(knee: OpenSimKnee, trial: Trial, start: Array, limit_s: float) -> Timed:
    """Search the trial's equilibrium from `start`; the best point found is in the result."""
    timed = Timed(lambda x: knee.residual(trial.flexion_deg, trial.load, x), limit_s)

    def slopes(x: Array, step: float) -> Array:
        here = timed(x)
        columns = [timed(x + step * e) - here for e in np.eye(5)]
        return np.stack(columns, axis=1) / step

    x = start
    for step in DIFFERENCE_STEPS:
        with contextlib.suppress(SearchEndedError):
            jacobian = partial(slopes, step=step)
            tight = {"xtol": 1e-10, "ftol": 1e-12, "gtol": 1e-12, "max_nfev": 80}
            least_squares(timed, x, jac=jacobian, **tight)
        if timed.best_size <= peers.SOLVED_N:
            break
        x = timed.best
    return timed


def all_trials() -> list[Trial]:
    """The 21 trials of seed63 at 0 deg, then 9 of up to 4 N m at each of 30 and 60 deg."""
    trials: list[Trial] = []
    for flexion, largest in ((0.0, 10), (30.0, 4), (60.0, 4)):
        unloaded = len(trials)
        trials.append(Trial(flexion, 0.0, 0.0, after=None))
        trials += peers.rays(flexion, largest, unloaded)
    return trials


def main() -> None:
    """Run the benchmark."""
    options = peers.benchmark_parser(__doc__, limit_s=60.0).parse_args()
    subject = peers.read_subject(options.subject, options.mesh)
    with tempfile.TemporaryDirectory() as folder:
        knee = OpenSimKnee(subject, Path(folder))

        def flexed(trial: Trial) -> Array:
            """The unloaded pose 10 deg before; the time that takes is not the trial's."""
            pose = np.zeros(5)
            for angle in np.arange(0.0, trial.flexion_deg, FLEXION_STEP):
                unloaded = Trial(float(angle), 0.0, 0.0, after=None)
                pose = solve(knee, unloaded, pose, options.limit).best
            return pose

        trials = all_trials()[: options.trials]
        if options.start == "reference":
            trials = [replace(trial, after=None) for trial in trials]
        solutions = peers.run_trials(
            trials,
            lambda trial, start, limit_s: solve(knee, trial, start, limit_s),
            flexed,
            options.limit,
        )
        version = knee.opensim.GetVersion()
    peers.write_record(options, "OpenSim", version, subject, solutions)


if __name__ == "__main__":
    main()
