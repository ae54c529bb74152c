"""A laxity test on a virtual knee: everything that acts in it, and where the tibia goes."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from identknee.blind import energy, equilibrium
from identknee.blind.energy import FemurGrid, TibialSurface, VirtualKnee
from identknee.laxity.protocol import Protocol
from identknee.runs.declare import Array, IntArray, declared, entry
from identknee.runs.errors import InputError, ValueRefused
from identknee.runs.files import cache_folder, prepare_folder
from identknee.subject.knee import Knee
from identknee.subject.surface import Surface

SPACING_MM = 0.9
# Distances are cut off here, and the grid reaches this far beyond the surface [mm].
BAND_MM = 5.0
# The same of the grid for pads, which are higher than contact is deep.
WIDE_BAND_MM = 10.0
# Vertices that share in the distance to a place, and the width of their weights over the edge.
NEIGHBOURS = 24
WIDTH = 0.8
BLOCK = 20000
FORMAT = 2


@declared
class DistanceGrid:
    """Signed distance to the femoral surface at the nodes of a grid in the femur's frame."""

    values: Array = entry(
        "Distance at the nodes [mm], negative inside, cut off at the band, shape ``(a, b, c)``"
    )
    origin: Array = entry("Position of the first node [mm], shape ``(3,)``")
    spacing: float = entry("Distance between nodes [mm]")


def distance_grid(knee: Knee, band: float = BAND_MM) -> DistanceGrid:
    """The grid of a knee's femur, kept on disk between calls under a digest of the surface.

    The closed form is used where the knee has one. Otherwise the distance at a place is the
    average of its distances to the tangent planes of the vertices around, with Gaussian weights
    (an implicit moving least squares surface), which rounds the facets off. Beyond the rim of an
    open surface it is the plain distance, so that nothing is inside there.

    References
    ----------
    .. [1] Kolluri (2008), ACM Trans. Algorithms 4(2), 18. https://doi.org/10.1145/1361192.1361195
    """
    local = Surface(vertices=knee.femur_frame.to_local(knee.femur.vertices), faces=knee.femur.faces)
    origin = local.vertices.min(axis=0) - band - 2.0 * SPACING_MM
    counts = np.ceil((local.vertices.max(axis=0) + band - origin) / SPACING_MM) + 2.0
    name = hashlib.sha256(f"{FORMAT} {SPACING_MM} {band} {NEIGHBOURS} {WIDTH}".encode())
    name.update(local.vertices.tobytes() + local.faces.tobytes())
    name.update(repr(knee.femur_distance).encode() if knee.femur_distance is not None else b"")
    path = cache_folder() / "blind" / f"femur-{name.hexdigest()[:24]}.npy"
    values = _kept(path)
    if values is None:
        nodes = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
        places = origin + SPACING_MM * nodes.reshape(-1, 3)
        if knee.femur_distance is None:
            distance = _from_vertices(local, places, band)
        else:
            distance = knee.femur_distance(knee.femur_frame.to_common(places))
        values = np.clip(distance, -band, band).reshape(nodes.shape[:3])
        _keep(path, values)
    return DistanceGrid(values=values, origin=origin, spacing=SPACING_MM)


def distances(grid: DistanceGrid, places: Array) -> Array:
    """Distance of places (n, 3) of the femur's frame [mm], ``(n,)``, linear between nodes."""
    at = ((places - grid.origin) / grid.spacing).T
    outside = float(np.abs(grid.values).max())
    found = map_coordinates(grid.values, at, order=1, mode="constant", cval=outside)
    return np.asarray(found)


def vertex_normals(surface: Surface) -> Array:
    """Unit outward normal of each vertex, shape ``(n, 3)``: of the triangles around, by area."""
    weighted = surface.normals * surface.areas[:, None]
    total = np.zeros_like(surface.vertices)
    for corner in range(3):
        np.add.at(total, surface.faces[:, corner], weighted)
    length = np.linalg.norm(total, axis=1)
    return np.asarray(total / np.where(length > 0.0, length, 1.0)[:, None])


def _from_vertices(surface: Surface, places: Array, band: float = BAND_MM) -> Array:
    normals = vertex_normals(surface)
    corners = surface.vertices[surface.faces]
    edge = float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
    is_rim = np.zeros(len(normals), bool)
    is_rim[surface.boundary_edges.ravel()] = True
    tree = cKDTree(surface.vertices)
    nearest, number = tree.query(places)
    offset = places - surface.vertices[number]
    height = (offset * normals[number]).sum(axis=1)
    aside = np.linalg.norm(offset - height[:, None] * normals[number], axis=1)
    is_beyond = is_rim[number] & (aside > edge)
    result: Array = np.where(is_beyond, nearest, np.sign(height) * nearest)
    close = np.flatnonzero((nearest < band) & ~is_beyond)
    for start in range(0, len(close), BLOCK):
        block = close[start : start + BLOCK]
        distance, around = tree.query(places[block], k=min(NEIGHBOURS, len(normals)))
        result[block] = _averaged(surface, normals, places[block], (distance, around), edge)
    return result


def _averaged(
    surface: Surface, normals: Array, places: Array, found: tuple[Array, IntArray], edge: float
) -> Array:
    """Distances to the tangent planes of the vertices found, averaged."""
    distance, around = found
    excess = distance**2 - distance[:, :1] ** 2
    weights = np.exp(-excess / (WIDTH * edge * (1.0 + distance[:, :1])) ** 2)
    heights = ((places[:, None] - surface.vertices[around]) * normals[around]).sum(axis=2)
    return np.asarray((weights * heights).sum(axis=1) / weights.sum(axis=1))


def _kept(path: Path) -> Array | None:
    try:
        values: Array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return values


def _keep(path: Path, values: Array) -> None:
    """Write the grid for the next call; without a place to write it is built again each time."""
    try:
        prepare_folder(path.parent)
    except InputError:
        return
    temporary = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        np.save(temporary, values)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)


# Contact: pressure = MODULUS depth (depth / 0.3 mm)^(EXPONENT - 1).
MODULUS = 8.6
EXPONENT = 1.25
TOE_STRAIN = 0.03
N_MM_PER_N_M = 1000.0
# How far an equilibrium may lie from the pose it is sought from [rad, mm].
FARTHEST_TURN, FARTHEST_SHIFT = 0.2, 6.0
# Columns of a line.
REFERENCE_LENGTH, STIFFNESS, REFERENCE_STRAIN, TOE, LIFT, LIFT_SHARE = range(6, 12)
LINE_COLUMNS = 12
FEMUR_END, TIBIA_END = slice(0, 3), slice(3, 6)


class ExperimentOutcome(Enum):
    """How a trial of the virtual test ended; each with its sentence."""

    FOUND = "A stable equilibrium was found along the load."
    STUCK = "No minimum of the energy was found."
    SNAPPED = "The tibia leapt under a small step of the load."


_ENDS = {
    equilibrium.FOUND: ExperimentOutcome.FOUND,
    equilibrium.STUCK: ExperimentOutcome.STUCK,
    equilibrium.SNAPPED: ExperimentOutcome.SNAPPED,
}


@declared
class Experiment:
    """A knee in a rig; an effect is a copy of it with something changed.

    Lengths in mm, forces in N, moments in N mm, angles in rad; femoral and tibial places each in
    the frame of their bone.
    """

    points: Array = entry("Places where contact is summed on the tibia, shape ``(p, 3)``")
    areas: Array = entry("Their areas [mm2]")
    grid: DistanceGrid = entry("Distance to the femur")
    start: tuple[Array, Array] = entry(
        "Rotation and position of the tibia in the femur in the scanned pose"
    )
    lines: Array = entry(
        "One row a line: femoral end, tibial end, reference length, stiffness [N], reference "
        "strain, toe strain, and how far it is pushed along the tibial z axis and at which share "
        "of its way down; shape ``(l, 12)``. The knee's own come first"
    )
    protocol: Protocol = entry("Trials with their stated flexion and loads")
    loads: Array = entry(
        "Loads that act at the full stated load, shape ``(n, 5)``: varus and internal moment, "
        "anterior, distraction and lateral force"
    )
    preload: Array = entry("Loads that act where none is stated, shape ``(5,)``")
    flexion_offset: float = entry("Added to the stated flexion angle")
    modulus: float = entry("Pressure at a depth of 0.3 mm over that depth [N/mm3]")
    exponent: float = entry("Power of the depth")
    weights: Array = entry(
        "Forces of fixed direction in the femur and the tibial place they act at, ``(w, 6)``"
    )
    springs: Array = entry(
        "Femoral places held across the plateau, the tibial places where they rest, and how "
        "stiffly [N/mm]; shape ``(s, 7)``"
    )
    torsion: tuple[float, float] = entry(
        "Stiffness [N mm/rad] and rest angle of a spring about the tibial axis"
    )
    pads: Array = entry(
        "Places on the tibia that carry an elastic pad, how stiff each is [N/mm] and how high, "
        "``(q, 5)``"
    )
    wide: Callable[[], DistanceGrid] = entry("Makes the grid of distances that pads need")
    femur_turn: Array = entry(
        "Rotation vector from the femoral frame to the one the rig assumes, in the femoral frame"
    )
    tibia_turn: Array = entry(
        "Rotation vector from the tibial frame to the one the rig assumes, in the tibial frame"
    )
    added: Array = entry("What the rig reads too much [mm, deg], shape ``(n, 5)``")

    def with_theta(self, theta: Array) -> "Experiment":
        """A copy with other stiffnesses [kN] and reference strains [%] of the knee's own lines."""
        m = len(theta) // 2
        lines = self.lines.copy()
        lines[:m, STIFFNESS] = theta[:m] * 1000.0
        lines[:m, REFERENCE_STRAIN] = theta[m:] * 0.01
        return replace(self, lines=lines)

    def arrays(self) -> VirtualKnee:
        """The knee as compiled functions take it."""
        law = np.array([self.modulus, self.exponent])
        wide = self.wide() if len(self.pads) else self.grid
        return VirtualKnee(
            surface=TibialSurface(points=self.points, areas=self.areas, law=law),
            field=FemurGrid(self.grid.values, self.grid.origin, self.grid.spacing),
            lines=self.lines,
            weights=self.weights,
            springs=self.springs,
            torsion=np.array(self.torsion),
            pads=self.pads,
            wide=FemurGrid(wide.values, wide.origin, wide.spacing),
        )


@declared
class ExperimentRun:
    """The results of an experiment."""

    coordinates: Array = entry(
        "As the rig reads them, in the order and units of a laxity table, shape ``(n, 5)``; NaN "
        "where there is none"
    )
    ends: tuple[ExperimentOutcome, ...] = entry("How each trial ended")
    poses: tuple[tuple[Array, Array], ...] = entry(
        "Rotation and position of the tibia of each trial"
    )
    hessians: Array = entry(
        "Second derivatives of the energy by the tangent step [N/mm], shape ``(n, 5, 5)``"
    )

    @property
    def is_complete(self) -> bool:
        """Whether every trial has its equilibrium."""
        return all(end is ExperimentOutcome.FOUND for end in self.ends)


def experiment_of(knee: Knee, protocol: Protocol, exponent: float = EXPONENT) -> Experiment:
    """The experiment on a knee with nothing hidden, at the subject's own ligament values."""
    around = [x.name for x in knee.ligaments if x.wrap is not None]
    if around:
        raise ValueRefused(
            f"blind cases are of straight ligaments, and {', '.join(around)} wrap",
            "leave their obstacles out",
        )
    femur, tibia = knee.femur_frame, knee.tibia_frame
    surfaces = [_subdivided(Surface(vertices=tibia.to_local(x.vertices), faces=x.faces))
                for x in knee.tibia]  # fmt: skip
    lines = np.zeros((len(knee.ligaments), LINE_COLUMNS))
    for line, x in zip(lines, knee.ligaments, strict=True):
        line[FEMUR_END], line[TIBIA_END] = femur.to_local(x.femur), tibia.to_local(x.tibia)
        line[REFERENCE_LENGTH], line[STIFFNESS] = x.length, 1000.0 * x.stiffness_kN
        line[REFERENCE_STRAIN], line[TOE] = 0.01 * x.reference_strain_pct, TOE_STRAIN
    return Experiment(
        points=np.concatenate([x.vertices for x in surfaces]),
        areas=np.concatenate([x.vertex_areas for x in surfaces]),
        grid=distance_grid(knee),
        start=(femur.axes @ tibia.axes.T, femur.to_local(tibia.origin)),
        lines=lines,
        protocol=protocol,
        loads=_acting(protocol),
        preload=np.zeros(5),
        flexion_offset=0.0,
        modulus=MODULUS,
        exponent=exponent,
        weights=np.zeros((0, 6)),
        springs=np.zeros((0, 7)),
        torsion=(0.0, 0.0),
        pads=np.zeros((0, 5)),
        wide=partial(distance_grid, knee, WIDE_BAND_MM),
        femur_turn=np.zeros(3),
        tibia_turn=np.zeros(3),
        added=np.zeros((protocol.n, 5)),
    )


def run_experiment(experiment: Experiment, near: ExperimentRun | None = None) -> ExperimentRun:
    """The run of an experiment: from the unloaded pose of each flexion along the load.

    Parameters
    ----------
    experiment
        What is tested.
    near
        A complete run of nearly the same experiment. Equilibria are sought from its poses then,
        and a trial whose pose leaps from there has none.
    """
    return _along_paths(experiment) if near is None else _from_poses(experiment, near)


def parameter_derivatives(experiment: Experiment, run: ExperimentRun, n_lines: int) -> Array:
    """Change of the poses' coordinates [mm, deg] with stiffness [kN] and strain [%].

    Those of the first `n_lines` lines, by the implicit function theorem; ``(n, 5, 2 n_lines)``.
    """
    slopes = np.empty((len(run.poses), 5, 2 * n_lines))
    flexion = _flexion(experiment)
    for i, (R, t) in enumerate(run.poses):
        forces = _line_parameter_derivatives(R, t, experiment.lines[:n_lines])
        tangent = -np.linalg.solve(run.hessians[i], forces)
        slopes[i] = _coordinate_derivatives(R, t, flexion[i]) @ tangent
    slopes[:, 3:] *= 180.0 / np.pi
    return slopes


def _subdivided(surface: Surface) -> Surface:
    """The surface with every triangle cut into four at the middles of its edges."""
    edges, number = np.unique(np.sort(surface.edges, axis=1), axis=0, return_inverse=True)
    n = len(surface.vertices)
    a, b, c = surface.faces.T
    ab, bc, ca = (number.ravel().reshape(-1, 3) + n).T
    faces = np.concatenate(
        [np.c_[a, ab, ca], np.c_[ab, b, bc], np.c_[ca, bc, c], np.c_[ab, bc, ca]]
    )
    middles = surface.vertices[edges].mean(axis=1)
    return Surface(vertices=np.r_[surface.vertices, middles], faces=faces)


def _acting(protocol: Protocol) -> Array:
    loads = protocol.loads[:, [1, 0, 2, 3, 4]].copy()
    loads[:, :2] *= N_MM_PER_N_M
    return loads


def _flexion(experiment: Experiment) -> Array:
    return np.asarray(np.radians(experiment.protocol.flexion_deg) + experiment.flexion_offset)


def _read(experiment: Experiment, poses: list[tuple[Array, Array] | None]) -> Array:
    """Coordinates as the rig reads them [mm, deg]; NaN where there is no pose."""
    result = np.full((len(poses), 5), np.nan)
    femur = energy.turned(experiment.femur_turn)
    tibia = energy.turned(experiment.tibia_turn)
    for i, pose in enumerate(poses):
        if pose is not None:
            R, t = pose
            result[i] = energy.grood_suntay(np.ascontiguousarray(femur.T @ R @ tibia), femur.T @ t)[
                :5
            ]
    result[:, 3:] *= 180.0 / np.pi
    return result + experiment.added


def _run(experiment: Experiment, found: list[tuple[Any, ...]]) -> ExperimentRun:
    poses = [(x[1], x[2]) if x[0] == equilibrium.FOUND else None for x in found]
    return ExperimentRun(
        coordinates=_read(experiment, poses),
        ends=tuple(_ENDS[x[0]] for x in found),
        poses=tuple((x[1], x[2]) for x in found),
        hessians=np.array([x[3] for x in found]),
    )


def _from_poses(experiment: Experiment, near: ExperimentRun) -> ExperimentRun:
    angles, knee = _flexion(experiment), experiment.arrays()
    found = [
        _from_pose(pose, angles[i], experiment.loads[i], knee) for i, pose in enumerate(near.poses)
    ]
    return _run(experiment, found)


def _from_pose(
    pose: tuple[Array, Array], flexion: float, load: Array, knee: VirtualKnee
) -> tuple[Any, ...]:
    """State of the equilibrium next to a pose."""
    is_found, R, t, H = equilibrium.minimum(*pose, flexion, load, knee)
    cosine = 0.5 * (np.trace(pose[0].T @ R) - 1.0)
    is_near = cosine > np.cos(FARTHEST_TURN) and np.linalg.norm(t - pose[1]) < FARTHEST_SHIFT
    return (equilibrium.FOUND if is_found and is_near else equilibrium.STUCK), R, t, H


def _along_paths(experiment: Experiment) -> ExperimentRun:
    angles, knee = _flexion(experiment), experiment.arrays()
    found: list[Any] = [None] * experiment.protocol.n
    for flexion, rest in _unloaded(experiment, np.unique(angles)).items():
        base = _followed(rest, (flexion, flexion), (np.zeros(5), experiment.preload), knee)
        for ray in _rays(experiment, np.flatnonzero(angles == flexion)):
            state, load = base, experiment.preload
            for i in ray:
                state = _followed(state, (flexion, flexion), (load, experiment.loads[i]), knee)
                load, found[i] = experiment.loads[i], state
    return _run(experiment, found)


def _followed(
    state: tuple[Any, ...],
    flexions: tuple[float, float],
    loads: tuple[Array, Array],
    knee: VirtualKnee,
) -> tuple[Any, ...]:
    """The state at the end of a path; one that failed earlier stays as it is."""
    if state[0] != equilibrium.FOUND:
        return state
    result: tuple[Any, ...] = equilibrium.follow(
        state[1], state[2], np.array(flexions), np.array(loads), knee
    )
    return result


def _unloaded(experiment: Experiment, angles: Array) -> dict[float, tuple[Any, ...]]:
    """State of the unloaded knee at each flexion angle, walked to from extension."""
    knee = experiment.arrays()
    is_found, R, t, H = equilibrium.minimum(*experiment.start, 0.0, np.zeros(5), knee)
    extension = (equilibrium.FOUND if is_found else equilibrium.STUCK, R, t, H)
    states = {}
    no_load = (np.zeros(5), np.zeros(5))
    for side in (angles[angles >= 0.0], angles[angles < 0.0][::-1]):
        state, last = extension, 0.0
        for angle in side:
            state = _followed(state, (last, float(angle)), no_load, knee)
            states[float(angle)], last = state, float(angle)
    return states


def _rays(experiment: Experiment, trials: IntArray) -> list[list[int]]:
    """Trials of one flexion in groups of one direction of the stated load, the smallest first."""
    stated = _acting(experiment.protocol) / [1000.0, 1000.0, 20.0, 20.0, 20.0]
    sizes = np.linalg.norm(stated, axis=1)
    groups: dict[tuple[float, ...], list[int]] = {}
    for i in sorted(trials.tolist(), key=lambda i: sizes[i]):
        direction = stated[i] / sizes[i] if sizes[i] > 0.0 else stated[i]
        groups.setdefault(tuple(np.round(direction, 6) + 0.0), []).append(i)
    return list(groups.values())


def _line_parameter_derivatives(R: Array, t: Array, lines: Array) -> Array:
    """Change of the gradient with stiffness [kN] and strain [%], the pose held; ``(5, 2 l)``."""
    axes = energy.joint_axes(R)
    columns = []
    for line in lines:
        length, arm, slope = energy.line_path(R, t, line)
        stretch = length / line[REFERENCE_LENGTH]
        strain = stretch * (1.0 + line[REFERENCE_STRAIN]) - 1.0
        force, rise, _ = energy.smooth_tension(strain, line[TOE])
        unit = np.r_[axes @ np.cross(arm, slope) / energy.LEVER, slope]
        columns.append((1000.0 * force * unit, 0.01 * line[STIFFNESS] * rise * stretch * unit))
    return np.asarray(np.array(columns).transpose(2, 1, 0).reshape(5, -1))


def tensions(experiment: Experiment, run: ExperimentRun, n_lines: int) -> Array:
    """Tension of the first `n_lines` lines in every trial of a run [N], shape ``(n, n_lines)``."""
    rows = []
    for R, t in run.poses:
        row = []
        for line in experiment.lines[:n_lines]:
            length, _, _ = energy.line_path(R, t, line)
            strain = length / line[REFERENCE_LENGTH] * (1.0 + line[REFERENCE_STRAIN]) - 1.0
            row.append(line[STIFFNESS] * energy.smooth_tension(strain, line[TOE])[0])
        rows.append(row)
    return np.array(rows)


def _coordinate_derivatives(R: Array, t: Array, flexion: float) -> Array:
    """Change of the coordinates [mm, rad] with a tangent step [mm], shape ``(5, 5)``."""
    size = equilibrium.DIFFERENCE
    columns = []
    for step in size * np.eye(5):
        ahead = energy.grood_suntay(*energy.moved(R, t, step, flexion))
        behind = energy.grood_suntay(*energy.moved(R, t, -step, flexion))
        columns.append((ahead - behind)[:5] / (2.0 * size))
    return np.array(columns).T
