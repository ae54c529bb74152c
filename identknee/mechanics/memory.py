"""What the compiled code reads and writes, by name: arrays in groups, and one thread's memory.

Compiled code takes named tuples as it takes others. Single numbers travel as arrays of one, which
leaves the machine code, and so the last bits of every sum, as it is.
"""

from typing import NamedTuple

from identknee.runs.arrays import Array, BitArray, IndexArray, IntArray, ReachArray

# How the search for an equilibrium ended.
CONVERGED, FOLD, NO_EQUILIBRIUM, UNCONSTRAINED = range(4)
# Places in the counters of an evaluation.
N_LISTED, N_TOUCHING, N_EVALUATIONS, N_LISTINGS, N_EXPANDED = range(5)

# What stands at the head of a call's table, in words of so many bytes: the state of the call, then
# whether its helper is to leave.
WORD, HEAD = 8, 2
# An ordinary call before and after it ran; a helper that is away, looks for an offer, has one, took
# it.
ALONE, ENDED, ASLEEP, AWAKE, OFFERED, TAKEN = range(6)

# One radian of rotation weighs as much as so many millimetres wherever the two are compared.
ROTATION_SCALE = 40.0
# Bits 0-7 of the `reach` of a cell of the distance field: each eighth that may hold contact where
# the law has no rounding; from this bit on the same where it has.
FIRST_ROUNDED = 8
MOST_HALVINGS = 10  # of the way from one node of the load path to the next
NEAR_CELLS = 1  # a cell is near when a cell this many away, along any axis, may hold contact


class Share(NamedTuple):
    """What one thread is to do of the nodes of the load paths.

    Attributes
    ----------
    nodes
        The nodes, piece after piece: the root, the trunk, early branches, late ones.
    ends
        Where each piece ends, shape ``(pieces,)``.
    n_early
        How many of the pieces are early branches, shape ``(1,)``.
    begun
        Of all threads: how many early branches and how many late ones are begun, and whether the
        trunk is solved, shape ``(3,)``.
    helpers
        Addresses of the helpers' tables, shape ``(helpers,)``.
    is_helper
        Whether this thread is a helper, shape ``(1,)``.
    """

    nodes: IntArray
    ends: IntArray
    n_early: IntArray
    begun: IntArray
    helpers: IntArray
    is_helper: IntArray


class ContactArrays(NamedTuple):
    """The contact points, in tibial axes.

    Attributes
    ----------
    points
        [mm], shape ``(3, n)``.
    radius
        Distance of the farthest from the tibial origin [mm], shape ``(1,)``.
    stiffness
        Contact modulus times tributary area [N/mm], shape ``(n,)``.
    compartment
        Which tibial surface each belongs to, shape ``(n,)``.
    exponent
        Exponent of the contact law, shape ``(1,)``.
    rounding
        Its rounding [mm], shape ``(1,)``.
    """

    points: Array
    radius: Array
    stiffness: Array
    compartment: IntArray
    exponent: Array
    rounding: Array


class FieldArrays(NamedTuple):
    """The distance field; see `identknee.mechanics.distance_field.DistanceField`.

    Attributes
    ----------
    coefficients, reach, near
        Those of all nodes, flat.
    origin
        [mm], shape ``(3,)``.
    spacing
        [mm], shape ``(1,)``.
    shape
        Numbers of nodes, shape ``(3,)``.
    is_apart
        Whether the femoral frame of poses and ligaments is another than the field's, ``(1,)``.
    turn, shift
        Rotation from that frame into the field's (9) and its origin there [mm] (3).
    """

    coefficients: Array
    reach: ReachArray
    near: BitArray
    origin: Array
    spacing: Array
    shape: IntArray
    is_apart: IntArray
    turn: Array
    shift: Array


class LigamentArrays(NamedTuple):
    """The line ligaments.

    Attributes
    ----------
    femoral, tibial
        Insertions [mm], shape ``(m, 3)``.
    properties
        Stiffness [N], reference strain, reference length [mm], transition strain (negative for a
        spring that pushes too), how far the line is pushed aside [mm] and at which share of the way
        from the tibia, shape ``(m, 6)``.
    """

    femoral: Array
    tibial: Array
    properties: Array


class NodeArrays(NamedTuple):
    """A tree of load paths; see `identknee.mechanics.load_paths.LoadPaths`.

    Attributes
    ----------
    flexion
        [rad], shape ``(n,)``.
    loads
        Generalised loads, shape ``(n, 5)``.
    parent
        The node each is reached from; the search begins anew at -1; shape ``(n,)``.
    farthest
        How far from its start such a search may end [mm], shape ``(1,)``.
    """

    flexion: Array
    loads: Array
    parent: IntArray
    farthest: Array


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


class State(NamedTuple):
    """An equilibrium, and where it goes.

    Attributes
    ----------
    pose
        Shape ``(5,)``.
    hessian
        Second derivatives of the energy, shape ``(5, 5)``.
    gradient_by_flexion
        d gradient / d flexion, shape ``(5,)``.
    tangent
        How the pose moves along the present segment, shape ``(5,)``.
    """

    pose: Array
    hessian: Array
    gradient_by_flexion: Array
    tangent: Array


class Point(NamedTuple):
    """A pose, and the energy's derivatives there.

    Attributes
    ----------
    pose
        Shape ``(5,)``.
    gradient
        Shape ``(5,)``.
    hessian
        Shape ``(5, 5)``.
    gradient_by_flexion
        d gradient / d flexion, shape ``(5,)``.
    """

    pose: Array
    gradient: Array
    hessian: Array
    gradient_by_flexion: Array


class SolverMemory(NamedTuple):
    """What the search for one minimum needs.

    Attributes
    ----------
    factor
        Cholesky factor of the Hessian, shape ``(5, 5)``.
    right
        Right-hand side of a linear system, shape ``(5,)``.
    step
        Its solution, shape ``(5,)``.
    trial
        The point tried.
    candidate
        The point looked at next on the way to it.
    start
        The pose the search began at, shape ``(5,)``.
    gradient
        The energy's gradient where the search is, shape ``(5,)``.
    columns
        How the gradient changes with each parameter, a column each.
    """

    factor: Array
    right: Array
    step: Array
    trial: Point
    candidate: Point
    start: Array
    gradient: Array
    columns: Array


class PathMemory(NamedTuple):
    """What following a branch along one segment needs.

    Attributes
    ----------
    here
        The last equilibrium accepted.
    there
        The one found next.
    far, goals
        Those found too far away for one step, one closer than the other, kept until they are near
        enough, and where on the segment they are.
    load
        The load at `there`, shape ``(5,)``.
    change
        The whole segment's change of load, shape ``(5,)``.
    """

    here: State
    there: State
    far: State
    goals: Array
    load: Array
    change: Array


class EvaluationMemory(NamedTuple):
    """What evaluating one pose needs; n is the number of points, and one more.

    Attributes
    ----------
    expansion
        Of each point that may touch: its place in tibial axes (3), that in the field where its
        distance was looked up (3), its stiffness, and there the distance [mm] with its gradient (3)
        and Hessian (xx yy zz xy xz yz), shape ``(17, n)``.
    listed
        Points near enough to touch soon (3), and their stiffness, shape ``(4, n)``.
    counts
        How many points are listed (-1: no list yet) and how many may touch, how many evaluations,
        listings and evaluations of the expansion were made, at the places `N_LISTED` to
        `N_EXPANDED`, shape ``(5,)``.
    listed_pose
        Rotation (9) and translation (3) for which the points were listed.
    cells, eighths
        First spline coefficient of each point's cell, and the eighth of the cell, shape ``(n,)``.
    pose, expanded
        The pose evaluated last, and that where the contact was expanded, shape ``(5,)``.
    rotation, translation
        Placement of the tibia, shapes ``(9,)`` and ``(3,)``.
    field_rotation, field_translation
        The same in the frame of the distance field.
    sums
        Sums over the elements, as `identknee.mechanics.elements.write_sums` writes them, shape
        ``(39,)``.
    axes
        How the coordinates move the tibia, as `identknee.mechanics.energy.motion_axes` writes it,
        shape ``(9, 3)``.
    touching
        Contact point of each contact element, shape ``(n,)``.
    pushes
        Of each contact element at one pose: its place relative to the tibial origin (3), the
        gradient of its energy by that (3) [N], and the depth that the law feels [mm], ``(7, n)``.
    which
        Contact point of each listed one, shape ``(n,)``.
    moved
        Place of listed points in their cells, from 0 to 1, shape ``(3, n)``.
    line
        Length, gradient (3) and Hessian (6) of a line, shape ``(10,)``.
    """

    expansion: Array
    listed: Array
    counts: IntArray
    listed_pose: Array
    cells: IndexArray
    eighths: IndexArray
    pose: Array
    expanded: Array
    rotation: Array
    translation: Array
    field_rotation: Array
    field_translation: Array
    sums: Array
    axes: Array
    touching: IndexArray
    pushes: Array
    which: IndexArray
    moved: Array
    line: Array


class Workspace(NamedTuple):
    """Memory of one thread for one simulation, of its three nested loops."""

    evaluation: EvaluationMemory
    solver: SolverMemory
    path: PathMemory


class Equilibria(NamedTuple):
    """What the kernel finds at every node of the load paths.

    Attributes
    ----------
    poses
        Last stable pose on the way to each node: varus, internal [rad], x, y, z [mm], ``(n, 5)``.
    hessians
        Second derivatives of the energy there, ``(n, 5, 5)``.
    sensitivities
        d pose / d (stiffness [N], reference strain), ``(n, 5, 2m)``; under a stated contact law
        also d pose / d (logarithm of the modulus, exponent), ``(n, 5, 2m + 2)``. Zero where not
        converged.
    gradient_by_flexion
        d gradient of the energy / d flexion, shape ``(n, 5)``.
    codes
        Outcome codes of the kernel, ``(n,)``.
    residuals
        Size of the gradient before the last, unmeasured step [N], ``(n,)``.
    reached
        Share of the step from the parent that was reached, ``(n,)``.
    contact_sums
        Sums over the contact elements, as `identknee.mechanics.elements.write_sums` writes them,
        ``(n, 39)``; zero without sensitivities to the contact law.
    centres
        Contact force [N], its centre in tibial and femoral axes [mm], ``(n, compartments, 7)``.
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
    solves: IntArray
