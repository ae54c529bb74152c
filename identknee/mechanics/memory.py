"""Groups of named arrays that compiled code reads and writes, and the memory of a thread.

Compiled code accepts named tuples like other tuples.
"""

from typing import Any, NamedTuple, TypeVar

import numpy as np

from identknee.runs.declare import Array, BitArray, IndexArray, IntArray, ReachArray

# How the search for an equilibrium ended.
CONVERGED, FOLD, NO_EQUILIBRIUM, UNCONSTRAINED = range(4)
# Places in the counters of an evaluation.
N_LISTED, N_TOUCHING, N_EVALUATIONS, N_LISTINGS, N_EXPANDED, N_PUSHING = range(6)

# One radian of rotation weighs as much as so many millimetres wherever the two are compared.
ROTATION_SCALE = 40.0
# Bits 0-7 of the `reach` of a cell of the distance field: each eighth that may hold contact where
# the law has no rounding; from this bit on the same where it has.
FIRST_ROUNDED = 8
MOST_HALVINGS = 10  # of the way from one node of the load path to the next
# A spring that holds the knee is released from 0 to 1. A knee without equilibrium is held at the
# largest of HOLDS well below the release at which it gives way; the first equilibrium is sought at
# each of BEGINNINGS until there is one.
HOLDS = np.array([0.9, 0.7, 0.5, 0.3, 0.2, 0.1])
BEGINNINGS = np.array([0.1, 0.01, 0.001])
NEAR_CELLS = 1  # a cell is near when a cell this many away, along any axis, may hold contact


Group = TypeVar("Group", bound=tuple[Any, ...])


def read_only(group: Group) -> Group:
    """The group with read-only views of its arrays.

    The compiler makes another version of its code for writable arrays, and an array that was
    read-only is writable after it was pickled.
    """
    views = [x.view() if isinstance(x, np.ndarray) else x for x in group]
    for view in views:
        if isinstance(view, np.ndarray):
            view.flags.writeable = False
    return type(group)(*views)


class MeniscusArrays(NamedTuple):
    """The points of the menisci, in tibial axes; none where a knee has none.

    Attributes
    ----------
    points
        [mm], shape ``(3, m)``.
    areas
        Tributary areas [mm2], shape ``(m,)``.
    heights
        How far from the femur each begins to press [mm], shape ``(m,)``.
    side
        0 for the medial meniscus, 1 for the lateral one, shape ``(m,)``.
    stiffness
        Of the medial and of the lateral one [N/mm3], shape ``(2,)``.
    coefficients, grid
        A distance field that reaches farther than that of contact, as in `FieldArrays`; its frame
        is that of contact's.
    """

    points: Array
    areas: Array
    heights: Array
    side: IntArray
    stiffness: Array
    coefficients: Array
    grid: Any


class ContactArrays(NamedTuple):
    """The contact points, in tibial axes.

    Attributes
    ----------
    points
        [mm], shape ``(3, n)``.
    radius
        Distance of the farthest point from the tibial origin [mm].
    stiffness
        Contact modulus times tributary area [N/mm], shape ``(n,)``.
    compartment
        Index of the tibial surface that each point belongs to, shape ``(n,)``.
    law
        Exponent and rounding [mm] of the contact law.
    menisci
        The points of the menisci, which press beside contact.
    """

    points: Array
    radius: float
    stiffness: Array
    compartment: IntArray
    law: tuple[float, float]
    menisci: MeniscusArrays


def record(kind: np.dtype[Any]) -> Any:
    """A record of zeros."""
    return np.zeros(1, kind).view(np.recarray)[0]


# Where the distance field is: its first node [mm], the distance between nodes [mm], their number
# along x, y and z; whether the femoral frame of poses and ligaments is another than the field's,
# the rotation from that frame into the field's (9), and its origin there [mm].
GRID = np.dtype(
    [
        ("origin", float, 3),
        ("spacing", float),
        ("shape", np.int64, 3),
        ("is_apart", np.int64),
        ("turn", float, 9),
        ("shift", float, 3),
    ]
)


class FieldArrays(NamedTuple):
    """The distance field; see `identknee.mechanics.distance_field.DistanceField`.

    Attributes
    ----------
    coefficients, reach, near
        Those of all nodes, flat.
    grid
        Where they are, a record of `GRID`.
    """

    coefficients: Array
    reach: ReachArray
    near: BitArray
    grid: Any


# A line ligament: insertions [mm], stiffness [N], reference strain, reference length [mm],
# transition strain (negative for a spring that pushes too), how far the line is pushed aside [mm]
# and at which share of the way from the tibia; the obstacle that it wraps around: its radius [mm],
# 0 for none, whether it is the tibia's, centre [mm] and axis in the axes of its bone. A line goes
# around the axis of a cylinder by the right hand, from femur to tibia; that of a sphere is zero.
LINE = np.dtype(
    [
        ("femoral", float, 3),
        ("tibial", float, 3),
        ("stiffness", float),
        ("reference_strain", float),
        ("reference_length", float),
        ("transition", float),
        ("wrap_offset", float),
        ("wrap_place", float),
        ("obstacle_radius", float),
        ("obstacle_is_tibial", float),
        ("obstacle_centre", float, 3),
        ("obstacle_axis", float, 3),
    ]
)
# What one line needs: length, gradient and Hessian of its course, and, around an obstacle, its
# point, its end, and centre and axis of the obstacle.
COURSE = np.dtype(
    [
        ("shape", float, 10),
        ("point", float, 3),
        ("end", float, 3),
        ("centre", float, 3),
        ("axis", float, 3),
    ]
)


class NodeArrays(NamedTuple):
    """A tree of load paths; see `identknee.mechanics.equilibria.LoadPaths`.

    Attributes
    ----------
    flexion
        [rad], shape ``(n,)``.
    loads
        Generalised loads, shape ``(n, 5)``.
    parent
        The node each is reached from; the search begins anew at -1; shape ``(n,)``.
    farthest
        How far from its start such a search may end [mm].
    is_released
        Whether a spring holds the knee there that lets go while the equilibrium is followed.
    """

    flexion: Array
    loads: Array
    parent: IntArray
    farthest: float
    is_released: bool


class Segment(NamedTuple):
    """The straight way from one node of a load path to the next.

    Attributes
    ----------
    flexion_before, flexion_after
        [rad].
    load_before, load_after
        Generalised loads, shape ``(5,)``.
    """

    flexion_before: float
    flexion_after: float
    load_before: Array
    load_after: Array


# What follows up to the workspace is of fixed size, and kept in records, whose fields compiled code
# reads and writes by name.

# A pose, the energy's derivatives there (`gradient_by_flexion` is d gradient / d flexion), and how
# an equilibrium moves along the present segment of the load path.
POINT = np.dtype(
    [
        ("pose", float, 5),
        ("gradient", float, 5),
        ("hessian", float, (5, 5)),
        ("gradient_by_flexion", float, 5),
        ("tangent", float, 5),
    ]
)
# What the search for one minimum needs: Cholesky factor of the Hessian, right-hand side and
# solution of a linear system, the point tried, the one looked at next on the way to it, and the
# pose the search began at.
SOLVER = np.dtype(
    [
        ("factor", float, (5, 5)),
        ("right", float, 5),
        ("step", float, 5),
        ("trial", POINT),
        ("candidate", POINT),
        ("start", float, 5),
    ]
)
# What following a branch along one segment needs: the last equilibrium accepted, and that found
# next; those found too far away for one step, one closer than the other, kept until they are near
# enough, and where on the segment they are; the load at `there`, and its change on the segment; the
# last poses of a release before each of `HOLDS`, and how far it was there.
PATH = np.dtype(
    [
        ("here", POINT),
        ("there", POINT),
        ("far", POINT, MOST_HALVINGS + 1),
        ("goals", float, MOST_HALVINGS + 1),
        ("load", float, 5),
        ("change", float, 5),
        ("kept", float, (len(HOLDS), 5)),
        ("kept_at", float, len(HOLDS)),
    ]
)
# The pose evaluated last, and that where the contact was expanded; rotation and translation of the
# tibia there, in femoral axes and in the frame of the distance field, and those for which points
# were listed; the stiffness of a spring that holds the knee at a pose [N/mm], and that pose; how
# the coordinates move the tibia, as `identknee.mechanics.energy.motion_axes` writes it; the sums
# over the elements, as `identknee.mechanics.elements.write_sums` writes them, and over the menisci
# alone; length, gradient (3) and Hessian (6) of a line; how many points are listed (-1: no list
# yet) and may touch, how many evaluations, listings and evaluations of the expansion were made, and
# how many points of contact and then of menisci may push, at the places `N_LISTED` to `N_PUSHING`.
PLACED = np.dtype(
    [
        ("pose", float, 5),
        ("expanded", float, 5),
        ("rotation", float, 9),
        ("translation", float, 3),
        ("field_rotation", float, 9),
        ("field_translation", float, 3),
        ("listed_pose", float, 12),
        ("hold", float),
        ("held_at", float, 5),
        ("axes", float, (9, 3)),
        ("sums", float, 39),
        ("pressed", float, 39),
        ("course", COURSE),
        ("counts", np.int64, 6),
    ]
)


class EvaluationMemory(NamedTuple):
    """What evaluating one pose needs; n is the number of points, with menisci's, and one more.

    Attributes
    ----------
    placed
        The pose evaluated last and what belongs to it, a record of `PLACED`.
    expansion
        Of each point that may push, those of menisci last: its place in tibial axes (3), that in
        the field where its distance was looked up (3), its stiffness, and there the distance [mm],
        less the height of a meniscus, with its gradient (3) and Hessian (xx yy zz xy xz yz), shape
        ``(17, n)``.
    listed
        Points near enough to touch soon (3), and their stiffness, shape ``(4, n)``.
    cells, eighths
        First spline coefficient of each point's cell, and the eighth of the cell, shape ``(n,)``.
    touching
        Contact point of each contact element, then meniscus point of each of those, ``(n,)``.
    pushes
        Of each of these elements at one pose: its place relative to the tibial origin (3), the
        gradient of its energy by that (3) [N], and the depth that the law feels [mm], ``(7, n)``.
    which
        Contact point of each listed one, shape ``(n,)``.
    moved
        Place of listed points in their cells, from 0 to 1, shape ``(3, n)``.
    """

    placed: Any
    expansion: Array
    listed: Array
    cells: IndexArray
    eighths: IndexArray
    touching: IndexArray
    pushes: Array
    which: IndexArray
    moved: Array


class Workspace(NamedTuple):
    """Memory of one thread for one simulation.

    Attributes
    ----------
    evaluation, solver, path
        Of its three nested loops; the last two are records of `SOLVER` and `PATH`.
    columns
        How the gradient changes with each parameter, a column each.
    """

    evaluation: EvaluationMemory
    solver: Any
    path: Any
    columns: Array


class Equilibria(NamedTuple):
    """What the kernel finds at every node of the load paths.

    Attributes
    ----------
    poses
        Last stable pose on the way to each node: varus, internal [rad], x, y, z [mm], ``(n, 5)``.
    hessians
        Second derivatives of the energy there, ``(n, 5, 5)``.
    sensitivities
        d pose / d (stiffness [N], reference strain), ``(n, 5, 2m)``; with menisci then d pose / d
        (medial, lateral stiffness [N/mm3], height [mm]); under a stated contact law or with menisci
        last d pose / d (logarithm of the modulus, exponent). Zero where not converged.
    gradient_by_flexion
        d gradient of the energy / d flexion, shape ``(n, 5)``.
    codes
        Outcome codes of the kernel, ``(n,)``.
    residuals
        Size of the gradient before the last, unmeasured step [N], ``(n,)``.
    reached
        Share of the step from the parent that was reached, or how far the spring that holds the
        knee has let go there, ``(n,)``.
    contact_sums
        Sums over the elements of contact and menisci, as
        `identknee.mechanics.elements.write_sums` writes them, ``(n, 39)``; zero without
        sensitivities to the contact law.
    centres
        Contact force [N], its centre in tibial and femoral axes [mm], ``(n, compartments, 7)``.
    menisci
        The same of the menisci, ``(n, 2, 7)``; zero where there are none.
    solves
        Equilibrium searches made for each node, ``(n,)``.
    """

    poses: Array
    hessians: Array
    sensitivities: Array
    gradient_by_flexion: Array
    codes: IntArray
    residuals: Array
    reached: Array
    contact_sums: Array
    centres: Array
    menisci: Array
    solves: IntArray
