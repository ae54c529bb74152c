"""Equilibria of trials along their load paths: the interface of the compiled kernel.

The path to a trial depends on that trial alone, not on the others of its protocol: from the
scanned pose in steps of flexion, then along a straight line from no load to the full one. Trials
share the nodes their paths have in common.
"""

import threading
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from identknee.mechanics.distance_field import MOST_ROUNDING, ContactLaw, DistanceField
from identknee.mechanics.memory import (
    GRID,
    LINE,
    N_LISTED,
    NO_EQUILIBRIUM,
    PATH,
    PLACED,
    ROTATION_SCALE,
    SOLVER,
    ContactArrays,
    Equilibria,
    EvaluationMemory,
    MeniscusArrays,
    NodeArrays,
    Workspace,
    read_only,
    record,
)
from identknee.runs.declare import Array, IntArray, array, declared, entry, frozen, frozen_integers


@declared
class Menisci:
    """The medial and the lateral meniscus as wedges between plateaus and femur, in tibial axes.

    A point i of a plateau's periphery stores the energy ``1/2 k A_i max(0, h_i - phi)^2``, where
    phi is its distance to the femur, A_i its area, k the stiffness of its meniscus and h_i the
    height of the wedge: how far from the femur it begins to press. The touch is rounded by the
    parabola of contact.
    """

    points: Array = array("Places on the plateaus", "point", "axis", unit="mm")
    areas: Array = array("Tributary areas", "point", unit="mm2")
    heights: Array = array("Distance to the femur at which each begins to press", "point")
    side: IntArray = array("0 on the medial side, 1 on the lateral one", "point", dtype=int)
    stiffness: Array = array(
        "Pressure per compression of the medial and of the lateral meniscus", "2", unit="N/mm3"
    )
    field: DistanceField | None = entry(
        "Distance to the femur in the frame of the contact's field, up to larger distances; None "
        "where there are no points"
    )

    def at(self, values: Array) -> "Menisci":
        """The menisci at `values`: stiffness of each side [N/mm3], and added height [mm]."""
        return replace(self, stiffness=values[:2], heights=self.heights + values[2])

    def arrays(self) -> MeniscusArrays:
        """The points as the kernel takes them."""
        grid = record(GRID)
        coefficients = np.zeros(0)
        if self.field is not None:
            coefficients = self.field.coefficients.reshape(-1)
            grid.origin, grid.spacing = self.field.origin, self.field.spacing
            grid.shape = self.field.coefficients.shape
        arrays = MeniscusArrays(
            points=np.ascontiguousarray(self.points.T),
            areas=self.areas,
            heights=self.heights,
            side=self.side,
            stiffness=self.stiffness,
            coefficients=coefficients,
            grid=grid,
        )
        return read_only(arrays)


# The law of a meniscus of one N/mm3.
UNIT_LAW = ContactLaw(modulus=1.0, rounding=MOST_ROUNDING)
NO_MENISCI = Menisci(
    points=np.zeros((0, 3)),
    areas=np.zeros(0),
    heights=np.zeros(0),
    side=np.zeros(0, np.int64),
    stiffness=np.zeros(2),
    field=None,
)


Continuation = Literal["continuation", "single-step"]
FLEXION_STEP = np.radians(10.0)
LOAD_STEP = 2000.0 / ROTATION_SCALE  # N, or N mm per rotation scale: 2 N m
NEAR = 30.0  # mm, or 43 deg of rotation: an equilibrium farther from a measured pose is another one
FREE = 1e9  # mm; no limit
_SCALE = np.array([ROTATION_SCALE, ROTATION_SCALE, 1.0, 1.0, 1.0])


@declared
class LoadPaths:
    """Nodes (flexion, load), each with the node it is reached from."""

    flexion: Array = entry("Flexion of each node [rad], shape ``(n_nodes,)``")
    loads: Array = entry(
        "Generalised loads of (varus, internal [N mm], x, y, z [N]), shape ``(n_nodes, 5)``"
    )
    parent: IntArray = entry(
        "Index of the node before, -1 where the path begins, shape ``(n_nodes,)``"
    )
    trial_node: IntArray = entry("The node of each trial, shape ``(n_trials,)``")
    farthest: float = entry(
        "How far from its start the search may end where a path begins, rotations times 40 mm [mm]",
        default=FREE,
    )
    is_released: bool = entry(
        "Whether a spring holds the knee where its path begins, and lets go of it while the "
        "equilibrium is followed",
        default=False,
    )


def load_paths(
    flexion: Array, loads: Array, start_flexion: float, continuation: Continuation = "continuation"
) -> LoadPaths:
    """The paths to trials at `flexion` [rad] (n,) under `loads` (n, 5), from `start_flexion` [rad].

    With ``"single-step"`` every trial starts at the scanned pose and bears its whole load at once.
    """
    # Models of one protocol with other effects have the same paths, hundreds in a diagnosis.
    plain = np.asarray(flexion, float).tobytes(), np.asarray(loads, float).tobytes()
    return _load_paths(*plain, float(start_flexion), continuation)


@lru_cache(maxsize=32)
def _load_paths(
    flexion: bytes, loads: bytes, start_flexion: float, continuation: Continuation
) -> LoadPaths:
    tree = _Tree()
    trial_node = []
    for angle, load in zip(
        np.frombuffer(flexion), np.frombuffer(loads).reshape(-1, 5), strict=True
    ):
        if continuation == "single-step":
            trial_node.append(tree.node(-1, float(angle), load))
        else:
            node, goal = tree.node(-1, start_flexion, np.zeros(5)), float(angle)
            for turned in _steps(goal - start_flexion, FLEXION_STEP):
                node = tree.node(node, start_flexion + turned, np.zeros(5))
            size = float(np.linalg.norm(load / _SCALE))
            for reached in _steps(size, LOAD_STEP):
                node = tree.node(node, goal, load * (reached / size))
            trial_node.append(node)
    return LoadPaths(
        flexion=frozen(tree.flexion, None, name="flexion"),
        loads=frozen(np.reshape(tree.loads, (-1, 5)), None, 5, name="loads"),
        parent=frozen_integers(tree.parent),
        trial_node=frozen_integers(trial_node),
    )


def paths_of_release(flexion: Array, loads: Array) -> LoadPaths:
    """Paths of one node each: trials at `flexion` [rad] (n,) bear their whole `loads` (n, 5).

    A spring holds each knee where its path begins. The equilibrium is followed while the spring
    becomes softer, so that it is the one that belongs to that pose, wherever a search would end.
    """
    n = len(flexion)
    return LoadPaths(
        flexion=frozen(flexion, n, name="flexion"),
        loads=frozen(loads, n, 5, name="loads"),
        parent=frozen_integers(np.full(n, -1)),
        trial_node=frozen_integers(np.arange(n)),
        farthest=NEAR,
        is_released=True,
    )


class _Tree:
    """Nodes of the paths; trials share a node of equal flexion, load and parent."""

    def __init__(self) -> None:
        self.flexion: list[float] = []
        self.loads: list[Array] = []
        self.parent: list[int] = []
        self._known: dict[tuple[int, float, tuple[float, ...]], int] = {}

    def node(self, parent: int, flexion: float, load: Array) -> int:
        key = (parent, round(flexion, 12), tuple(np.round(load, 9)))
        if key not in self._known:
            self._known[key] = len(self.flexion)
            self.flexion.append(flexion)
            self.loads.append(np.asarray(load, float))
            self.parent.append(parent)
        return self._known[key]


def _steps(whole: float, step: float) -> list[float]:
    """Multiples of `step` below `whole`, then `whole` itself; nothing where it is zero."""
    if abs(whole) < 1e-9 * step:
        return []
    full = int(np.ceil(abs(whole) / step - 1e-9))
    return [*(np.sign(whole) * step * k for k in range(1, full)), whole]


class _Kept(threading.local):
    """The workspace that a thread used last."""

    size = (-1, -1)
    last: Workspace


_kept = _Kept()


def kept_workspace(n_points: int, n_columns: int) -> Workspace:
    """The calling thread's workspace, without the evaluations of its last simulation."""
    if _kept.size != (n_points, n_columns):
        _kept.last, _kept.size = workspace(n_points, n_columns), (n_points, n_columns)
    _forget(_kept.last.evaluation)
    return _kept.last


def workspace(n_points: int, n_columns: int = 0) -> Workspace:
    """Working memory for `n_points` contact points and `n_columns` sensitivities."""
    n = n_points + 1
    evaluation = EvaluationMemory(
        placed=record(PLACED),
        expansion=np.zeros((17, n)),
        listed=np.zeros((4, n)),
        cells=np.zeros(n, np.uint32),
        eighths=np.zeros(n, np.uint32),
        touching=np.zeros(n, np.uint32),
        pushes=np.zeros((7, n)),
        which=np.zeros(n, np.uint32),
        moved=np.zeros((3, n)),
    )
    _forget(evaluation)
    return Workspace(
        evaluation=evaluation,
        solver=record(SOLVER),
        path=record(PATH),
        columns=np.zeros((5, n_columns)),
    )


def _forget(evaluation: EvaluationMemory) -> None:
    placed = evaluation.placed
    placed.counts[:] = 0
    placed.counts[N_LISTED] = -1
    placed.pose[:] = np.inf
    placed.expanded[:] = np.inf
    placed.hold = 0.0


_meniscus_arrays = lru_cache(maxsize=8)(Menisci.arrays)
TRANSITION_STRAIN = 0.03
# Number of columns of each property of a line, in the order of `LineLigaments.table`.
_WIDTHS = {
    **{"femoral": 3, "tibial": 3, "obstacle_centre": 3, "obstacle_axis": 3},
    **{"reference_length": 1, "transition": 1, "wrap_offset": 1, "wrap_place": 1},
    **{"obstacle_radius": 1, "obstacle_is_tibial": 1},
}
LINE_COLUMNS = sum(_WIDTHS.values())
# Sensitivities to menisci (medial and lateral stiffness, height) and to the contact law.
N_OF_MENISCI, N_OF_LAW, N_SIDES = 3, 2, 2


@declared
class ContactPoints:
    """Points of the tibial surface that carry contact, in tibial axes."""

    points: Array = array("Places", "point", "axis", unit="mm")
    areas: Array = array("Tributary areas", "point", unit="mm2")
    compartment: IntArray = array("Which tibial surface each belongs to", "point", dtype=int)
    law: ContactLaw | None = entry(
        "The contact law, with sensitivities to it; the paper's, without them, where None",
        default=None,
    )
    menisci: Menisci | None = entry(
        "The menisci, with sensitivities to them and to the law; None without",
        default=None,
    )

    @property
    def n_columns(self) -> int:
        """How many sensitivities there are beside those to the lines."""
        if self.menisci is not None:
            return N_OF_MENISCI + N_OF_LAW
        return 0 if self.law is None else N_OF_LAW

    @property
    def n_points(self) -> int:
        """How many points there are, with those of the menisci."""
        return len(self.points) + (0 if self.menisci is None else len(self.menisci.points))

    @property
    def n_compartments(self) -> int:
        """How many tibial surfaces there are."""
        return int(self.compartment.max()) + 1

    def arrays(self) -> ContactArrays:
        """The points as the kernel takes them."""
        law = self.law or ContactLaw()
        menisci = NO_MENISCI if self.menisci is None else self.menisci
        arrays = ContactArrays(
            points=np.ascontiguousarray(self.points.T),
            radius=float(np.linalg.norm(self.points, axis=1).max()),
            stiffness=law.modulus * self.areas,
            compartment=self.compartment,
            law=(float(law.exponent), float(law.rounding)),
            menisci=_meniscus_arrays(menisci),
        )
        return read_only(arrays)


@declared
class LineLigaments:
    """Line ligaments: insertions in femoral and tibial axes, and what does not change in a fit."""

    femoral: Array = entry("Femoral insertions [mm], shape ``(m, 3)``")
    tibial: Array = entry("Tibial insertions, likewise")
    reference_length: Array = entry("Length in the scanned pose [mm], shape ``(m,)``")
    transition: Array | float = entry(
        "Strain at which the force-strain curve has half its final slope, shape ``(m,)``; negative "
        "for a spring, linear in tension and compression",
        default=TRANSITION_STRAIN,
    )
    wrap_offset: Array | float = entry(
        "How far each line is pushed aside along femoral z, as by a bone [mm], shape ``(m,)``",
        default=0.0,
    )
    wrap_place: Array | float = entry(
        "Where it is pushed, as a share of the way from the tibia to the femur, shape ``(m,)``",
        default=0.5,
    )
    obstacle_radius: Array | float = entry(
        "Radius of the cylinder or sphere that each line wraps around [mm], 0 for none, shape "
        "``(m,)``",
        default=0.0,
    )
    obstacle_is_tibial: Array | float = entry(
        "Whether it is fixed to the tibia, 1 or 0, shape ``(m,)``", default=0.0
    )
    obstacle_centre: Array | float = entry(
        "A point of its axis in the axes of its bone [mm], shape ``(m, 3)``", default=0.0
    )
    obstacle_axis: Array | float = entry(
        "Unit vector along the axis, about which a line turns by the right hand on its way from "
        "femur to tibia; zero for a sphere; shape ``(m, 3)``",
        default=0.0,
    )

    def __post_init__(self) -> None:
        m = len(self.femoral)
        for name, width in _WIDTHS.items():
            shape = (m,) if width == 1 else (m, width)
            values = getattr(self, name)
            values = np.full(shape, values) if np.ndim(values) == 0 else values
            object.__setattr__(self, name, frozen(values, *shape, name=name))

    def take(self, which: IntArray) -> "LineLigaments":
        """Some of the lines, in the order asked for."""
        return LineLigaments(**{x: getattr(self, x)[which] for x in _WIDTHS})

    def with_obstacles_of(self, bone: int) -> IntArray:
        """Which lines have an obstacle that is the femur's (0) or the tibia's (1)."""
        is_own = np.asarray(self.obstacle_is_tibial) == bone
        return np.flatnonzero((np.asarray(self.obstacle_radius) > 0.0) & is_own)

    def table(self) -> Array:
        """The properties of each line, shape ``(m, LINE_COLUMNS)``.

        Femoral and tibial insertion, centre and axis of the obstacle, then those of one number.
        """
        return np.column_stack([getattr(self, x) for x in _WIDTHS])

    @staticmethod
    def of_table(rows: Array) -> "LineLigaments":
        """The lines of a table as `table` gives it."""
        ends = np.cumsum([0, *_WIDTHS.values()]).tolist()
        parts = zip(_WIDTHS.items(), ends[:-1], strict=True)
        return LineLigaments(
            **{
                name: rows[:, at] if width == 1 else rows[:, at : at + width]
                for (name, width), at in parts
            }
        )

    def arrays(self, stiffness: Array, reference_strain: Array) -> Any:
        """The ligaments with stiffness [N] and reference strain, as the kernel takes them.

        An array of `identknee.mechanics.memory.LINE`.
        """
        lines = np.recarray(len(self.femoral), LINE)
        lines.stiffness, lines.reference_strain = stiffness, reference_strain
        for name in _WIDTHS:
            lines[name] = getattr(self, name)
        return lines


def solve(
    paths: LoadPaths,
    start: Array,
    contact: ContactPoints,
    field: DistanceField,
    ligaments: Any,
    *,
    derivatives: bool = True,
    guesses: Array | None = None,
) -> Equilibria:
    """The equilibria at the nodes of `paths`, beginning the search at the pose `start`.

    Parameters
    ----------
    start
        Varus, internal [rad], x, y, z [mm], shape ``(5,)``, or one for each node, ``(n_nodes, 5)``.
        Those of nodes reached from others are not looked at.
    ligaments
        As `LineLigaments.arrays` gives them.
    guesses
        Poses to try first, shape ``(n_nodes, 5)``. A guess is kept only if the equilibrium found
        from it agrees with its neighbour's tangents, as one found without must.
    """
    # The compiler takes half a second to load.
    from identknee.mechanics.kernel import simulate_path

    n, m = len(paths.flexion), len(ligaments)
    found = Equilibria(
        poses=np.zeros((n, 5)),
        hessians=np.zeros((n, 5, 5)),
        sensitivities=np.zeros((n, 5, 2 * m + contact.n_columns)),
        gradient_by_flexion=np.zeros((n, 5)),
        codes=np.full(n, NO_EQUILIBRIUM),
        residuals=np.zeros(n),
        reached=np.zeros(n),
        contact_sums=np.zeros((n, 39)),
        centres=np.zeros((n, contact.n_compartments, 7)),
        menisci=np.zeros((n, N_SIDES, 7)),
        solves=np.zeros(n, np.int64),
    )
    # In C order, since the compiler makes another version of its code for each memory order.
    simulate_path(
        _node_arrays(paths),
        np.array(np.broadcast_to(start, (n, 5)), order="C"),
        np.zeros((n, 5)) if guesses is None else np.array(guesses, order="C"),
        guesses is not None,
        _contact_arrays(contact),
        _field_arrays(field),
        ligaments,
        derivatives,
        kept_workspace(contact.n_points, found.sensitivities.shape[2]),
        found,
    )
    return found


# Many simulations share the same paths.
@lru_cache(maxsize=4)
def _node_arrays(paths: LoadPaths) -> NodeArrays:
    return read_only(
        NodeArrays(
            paths.flexion,
            paths.loads,
            paths.parent,
            float(paths.farthest),
            paths.is_released,
        )
    )


_contact_arrays = lru_cache(maxsize=8)(ContactPoints.arrays)
_field_arrays = lru_cache(maxsize=4)(DistanceField.arrays)


def stability_margins(hessians: Array) -> Array:
    """Smallest eigenvalue of each Hessian [N/mm], rotations scaled by 40 mm; shape ``(n,)``."""
    return np.linalg.eigvalsh(hessians / _SCALE[:, None] / _SCALE)[:, 0]
