"""The paper's contact law: vertices of one mesh pressed against the triangles of another.

Each vertex inside the opposing sheet bears ``F = P A d`` along the normal of its closest triangle,
of area ``A``, at depth ``d``. With the vertices of one sheet only, the sum is about half the
integral of ``P d`` over the contact, since a sheet has half as many vertices as triangles. It is
more or less where the two meshes differ in density.

The law has no energy, and its force jumps where a vertex changes its closest triangle. So a pose in
equilibrium need not exist; the search then ends at the smallest residual that it met.

References
----------
.. [1] Influence of the Initial Guess on the Estimation of Knee Ligament Parameters via Optimization
       Procedures (the paper), equations 1 and 2.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, get_args

import fcl
import numpy as np
from scipy.spatial import cKDTree

from identknee.mechanics.distance_field import PRESSURE_MODULUS
from identknee.mechanics.equilibria import LineLigaments, LoadPaths
from identknee.mechanics.ligament_tensions import ligament_wrench
from identknee.mechanics.memory import ROTATION_SCALE
from identknee.mechanics.pose import Placement, place
from identknee.runs.declare import (
    Array,
    BoolArray,
    IntArray,
    array,
    declared,
    entry,
    frozen,
    frozen_integers,
)
from identknee.runs.record import Outcome

Convention = Literal["tibia", "femur", "both"]

DEEPEST = 5.0  # mm; a deeper vertex belongs to the far side of the bone, not to the contact
PATCH_SIZE = 5.0  # mm; vertices in one such cube are tested for contact together
SLACK = 1e-6  # mm, what rounding may do to a length of some 100 mm, with room
BOX_SLACK = 0.05  # mm, far more than the tolerance of the box test


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """An open triangle mesh, with the quantities that contact needs.

    Attributes
    ----------
    vertices
        [mm], shape ``(n, 3)``.
    faces
        Corner indices, outward normals by the right-hand rule, shape ``(m, 3)``.
    normals
        Outward unit normals of the triangles, shape ``(m, 3)``.
    areas
        [mm2], shape ``(m,)``.
    corners
        [mm], shape ``(m, 3, 3)``.
    centres
        Centroids of the triangles [mm], shape ``(m, 3)``.
    radii
        Distance of each centroid to its farthest corner [mm], shape ``(m,)``.
    rim_edges
        Whether the edge opposite to each corner is on the rim, shape ``(m, 3)``.
    rim_corners
        Whether each corner is on the rim, shape ``(m, 3)``.
    tree
        Tree of the centroids.
    hierarchy
        Bounding volumes of the triangles, for python-fcl.
    patches
        Neighbouring vertices: indices, centre and sides [mm] of their bounding box.

    Raises
    ------
    ValueError
        If a triangle has no area, since it has no normal either.
    """

    vertices: Array
    faces: IntArray
    normals: Array = field(init=False)
    areas: Array = field(init=False)
    corners: Array = field(init=False, repr=False)
    centres: Array = field(init=False, repr=False)
    radii: Array = field(init=False, repr=False)
    rim_edges: BoolArray = field(init=False, repr=False)
    rim_corners: BoolArray = field(init=False, repr=False)
    tree: cKDTree = field(init=False, repr=False)
    hierarchy: Any = field(init=False, repr=False)
    patches: tuple[tuple[IntArray, Array, Array], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices = frozen(self.vertices, None, 3, name="vertices")
        faces = frozen_integers(self.faces)
        corners = vertices[faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double = np.linalg.norm(cross, axis=1)
        # The sheet rejects triangles without area; until then their normals are zero.
        normals, areas = cross / np.where(double > 0.0, double, 1.0)[:, None], 0.5 * double
        if not np.all(areas > 0.0):
            raise ValueError(
                f"triangle {int(np.argmin(areas))} of {len(areas)} has no area; "
                "remove such triangles from the surface"
            )
        centres = corners.mean(axis=1)
        edges = np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
        _, which, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        rim_edges: BoolArray = (count[which.reshape(-1)] == 1).reshape(-1, 3)
        derived = {
            "vertices": vertices,
            "faces": faces,
            "normals": frozen(normals, None, 3, name="normals"),
            "areas": frozen(areas, None, name="areas"),
            "corners": corners,
            "centres": centres,
            "radii": np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1),
            "rim_edges": rim_edges,
            "rim_corners": np.isin(faces, faces[:, [[1, 2], [2, 0], [0, 1]]][rim_edges]),
            "tree": cKDTree(centres),
            "hierarchy": collision_hierarchy(vertices, faces),
            "patches": _patches_of(vertices),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def near(self, other: "Sheet", rotation: Array, translation: Array) -> IntArray:
        """Vertices of this sheet that may lie within 5 mm of `other`: all that do and some more.

        ``rotation x + translation`` takes a point from this sheet's axes to the other's.
        """
        opposing = fcl.CollisionObject(other.hierarchy, fcl.Transform())
        found = [np.empty(0, np.int64)]
        for members, centre, sides in self.patches:
            box = fcl.CollisionObject(
                fcl.Box(*(sides + 2.0 * (DEEPEST + BOX_SLACK))),
                fcl.Transform(rotation, rotation @ centre + translation),
            )
            if fcl.collide(opposing, box, fcl.CollisionRequest(), fcl.CollisionResult()):
                found.append(members)
        return np.concatenate(found)


@declared
class Penetration:
    """Points inside a sheet."""

    point: IntArray = entry("Index of each point inside, shape ``(k,)``")
    triangle: IntArray = entry("Index of its closest triangle, shape ``(k,)``")
    depth: Array = entry("Its distance from that triangle's plane [mm], positive, shape ``(k,)``")


@declared
class ContactWrench:
    """Generalised force and stiffness of mesh contact on the tibia at one pose."""

    force: Array = array(
        "Generalised force on varus, internal rotation, x, y and z", "freedom", unit="N mm or N"
    )
    stiffness: Array = array(
        "Minus its derivative by the pose, with the triangle and the direction of each vertex's "
        "force held fixed: ``sum P A n n^T`` in the coordinates",
        *("freedom", "freedom"),
        unit="N mm, N or N/mm",
    )
    compartments: Array = array(
        "Sum of the magnitudes of the forces on each tibial sheet", "sheet", unit="N"
    )
    n_touching: int = entry("Number of vertices in contact", unit="1")


@declared
class MeshContact:
    """A femur and the tibial sheets that touch it, each with its own contact.

    Raises
    ------
    ValueError
        If the convention is not one of the three or the modulus is not positive.
    """

    femur: Sheet = entry("The femur, in femoral axes")
    tibia: tuple[Sheet, ...] = entry("The tibia in tibial axes, one sheet a compartment")
    convention: Convention = entry(
        'Whose vertices bear the forces: ``"tibia"`` (against the femoral triangles), '
        '``"femur"`` (against the tibial triangles) or ``"both"`` (the sum of the two)',
        default="both",
    )
    pressure_modulus: float = entry("P of equation 1 [N/mm3], > 0", default=PRESSURE_MODULUS)

    def __post_init__(self) -> None:
        if self.convention not in get_args(Convention):
            raise ValueError(
                f"convention must be one of {', '.join(get_args(Convention))}, "
                f"got {self.convention!r}"
            )
        if not self.pressure_modulus > 0.0:
            raise ValueError(
                f"pressure_modulus must be positive [N/mm3], got {self.pressure_modulus:g}"
            )

    def wrench(self, placement: Placement) -> ContactWrench:
        """The contact forces with the tibia at `placement`."""
        force, stiffness = np.zeros(5), np.zeros((5, 5))
        compartments, n_touching = np.zeros(len(self.tibia)), 0
        for index, sheet in enumerate(self.tibia):
            for points, normals, areas, depths in self._touching(sheet, placement):
                sizes = self.pressure_modulus * areas * depths
                lifting = np.einsum("nai,ni->na", placement.jacobian(points), normals)
                force += sizes @ lifting
                stiffness += self.pressure_modulus * (areas * lifting.T) @ lifting
                compartments[index] += sizes.sum()
                n_touching += len(points)
        return ContactWrench(
            force=force, stiffness=stiffness, compartments=compartments, n_touching=n_touching
        )

    def _touching(
        self, sheet: Sheet, placement: Placement
    ) -> list[tuple[Array, Array, Array, Array]]:
        """Vertices in contact: place in tibial axes, push on the tibia, triangle's area, depth."""
        found = []
        back = placement.rotation.T
        if self.convention != "femur":
            near = sheet.near(self.femur, placement.rotation, placement.translation)
            points = sheet.vertices[near]
            inside = penetrations(placement.to_femur(points), self.femur)
            normals = self.femur.normals[inside.triangle]
            areas = self.femur.areas[inside.triangle]
            found.append((points[inside.point], normals, areas, inside.depth))
        if self.convention != "tibia":
            near = self.femur.near(sheet, back, -back @ placement.translation)
            points = placement.to_tibia(self.femur.vertices[near])
            inside = penetrations(points, sheet)
            # The triangle pushes the femoral vertex outward; the tibia is pushed the other way.
            normals = -sheet.normals[inside.triangle] @ back
            found.append(
                (points[inside.point], normals, sheet.areas[inside.triangle], inside.depth)
            )
        return found


def mesh_contact(
    femur: tuple[Array, IntArray],
    tibia: Sequence[tuple[Array, IntArray]],
    convention: Convention = "both",
) -> MeshContact:
    """The paper's contact between a femoral mesh and the tibial meshes, each (vertices, faces)."""
    return MeshContact(
        femur=Sheet(vertices=femur[0], faces=femur[1]),
        tibia=tuple(Sheet(vertices=vertices, faces=faces) for vertices, faces in tibia),
        convention=convention,
    )


def penetrations(points: Array, sheet: Sheet) -> Penetration:
    """The `points` (n, 3) [mm] that lie less than 5 mm inside `sheet`, in the sheet's axes.

    A point is inside if it lies behind its closest triangle, and outside if the closest place is on
    the sheet's rim. If the closest place is on an edge or a corner, several triangles are equally
    close. Then the triangle decides whose plane is farthest from the point, which gives the right
    side.
    """
    owner, triangle = _candidates(points, sheet)
    height = np.einsum("ij,ij->i", points[owner] - sheet.centres[triangle], sheet.normals[triangle])
    # In front of every triangle that may be the closest: outside, whichever that is.
    behind = np.zeros(len(points), bool)
    behind[owner[height < 0.0]] = True
    kept = behind[owner]
    owner, triangle, height = owner[kept], triangle[kept], height[kept]
    closest = _closest_places(sheet.corners[triangle], points[owner])
    distance = np.linalg.norm(points[owner] - closest, axis=1)
    first = _closest_pairs(owner, distance, np.abs(height))
    inside = (height[first] < 0.0) & (distance[first] < DEEPEST)
    inside[inside] = ~_is_on_rim(closest[first][inside], triangle[first][inside], sheet)
    chosen = first[inside]
    return Penetration(
        point=frozen_integers(owner[chosen]),
        triangle=frozen_integers(triangle[chosen]),
        depth=frozen(-height[chosen], None, name="depth"),
    )


def _candidates(points: Array, sheet: Sheet) -> tuple[IntArray, IntArray]:
    """Pairs (point, triangle), sorted by point, among them every point's closest triangle.

    Points farther than 5 mm from the sheet have none.
    """
    none = np.empty(0, np.int64)
    if len(points) == 0:
        return none, none
    nearest = sheet.tree.query(points)[1]
    on_nearest = _closest_places(sheet.corners[nearest], points)
    # No closest place is farther than the one on the triangle whose centre is nearest.
    bound = np.linalg.norm(points - on_nearest, axis=1)
    bound = np.minimum(bound, DEEPEST) + SLACK
    found = sheet.tree.query_ball_point(points, bound + sheet.radii.max())
    owner = np.repeat(np.arange(len(points)), [len(some) for some in found])
    triangle = np.concatenate([none, *(np.array(some, np.int64) for some in found)])
    away = np.linalg.norm(points[owner] - sheet.centres[triangle], axis=1)
    kept = away <= bound[owner] + sheet.radii[triangle]
    return owner[kept], triangle[kept]


def _closest_places(corners: Array, points: Array) -> Array:
    """The place on each triangle (n, 3, 3) closest to the point (n, 3) of the same row."""
    # Only the paper's contact asks for these, so only its simulations wait until they are loaded.
    from trimesh import triangles as trimesh_triangles

    places: Array = trimesh_triangles.closest_point(corners, points)  # type: ignore[no-untyped-call]
    return places


def _closest_pairs(owner: IntArray, distance: Array, height: Array) -> IntArray:
    """The pair that decides for each point: the closest, then that with the farthest plane."""
    if len(owner) == 0:
        return np.empty(0, np.int64)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    least = np.repeat(np.minimum.reduceat(distance, starts), np.diff(starts, append=len(owner)))
    squareness = np.where(distance <= least + SLACK, height, -1.0)
    order = np.lexsort((-squareness, owner))
    return order[starts]


def _is_on_rim(places: Array, triangle: IntArray, sheet: Sheet) -> BoolArray:
    """Whether each of `places`, on its triangle, lies on the sheet's rim."""
    from trimesh import triangles as trimesh_triangles

    weights = trimesh_triangles.points_to_barycentric(  # type: ignore[no-untyped-call]
        sheet.corners[triangle], places
    )
    on_edge = sheet.rim_edges[triangle] & (weights < SLACK)
    on_corner = sheet.rim_corners[triangle] & (weights > 1.0 - SLACK)
    return np.asarray((on_edge | on_corner).any(axis=1))


def collision_hierarchy(vertices: Array, faces: IntArray) -> Any:  # fcl has no types
    """Bounding volume hierarchy of the triangles of a mesh, for collision tests by fcl."""
    hierarchy = fcl.BVHModel()
    hierarchy.beginModel(len(vertices), len(faces))
    hierarchy.addSubModel(vertices, faces)
    hierarchy.endModel()
    return hierarchy


def _patches_of(vertices: Array) -> tuple[tuple[IntArray, Array, Array], ...]:
    """Vertices by the cube they lie in: indices, centre and sides [mm] of their bounding box."""
    cubes = np.floor(vertices / PATCH_SIZE)
    _, which = np.unique(cubes, axis=0, return_inverse=True)
    patches = []
    order = np.argsort(which.reshape(-1), kind="stable")
    ends = np.flatnonzero(np.diff(which.reshape(-1)[order])) + 1
    for members in np.split(order, ends):
        lower, upper = vertices[members].min(axis=0), vertices[members].max(axis=0)
        patches.append((members, (lower + upper) / 2.0, upper - lower))
    return tuple(patches)


RESIDUAL_TOLERANCE = 1e-3  # N, the paper's; moments divided by the rotation scale
MOST_ITERATIONS = 40
MOST_HALVINGS = 6
LONGEST_STEP = 3.0  # mm, rotations multiplied by the rotation scale
LEAST_STIFFNESS = 0.5  # N/mm; below it the step would be decided by noise
_SCALE = np.array([ROTATION_SCALE, ROTATION_SCALE, 1.0, 1.0, 1.0])

# Residual (5,) and stiffness (5, 5) at a pose (5,).
_Balance = Callable[[Array], tuple[Array, Array]]


@declared
class MeshEquilibria:
    """What the search found for each trial."""

    poses: Array = array(
        "The pose of the smallest residual: varus, internal [rad], x, y, z [mm]", "trial", "5"
    )
    residuals: Array = array("Residuals, moments divided by 40 mm", "trial", unit="N")
    outcomes: tuple[Outcome, ...] = entry(
        "``CONVERGED`` where the residual is at most 0.001 N, else ``NO_EQUILIBRIUM``: usually the "
        "law jumps across zero there"
    )
    evaluations: IntArray = array(
        "Contact evaluations on the last step of the way to each trial", "trial", dtype=int
    )


def mesh_equilibria(
    paths: LoadPaths,
    start: Array,
    contact: MeshContact,
    lines: LineLigaments,
    stiffness: Array,
    reference_strain: Array,
) -> MeshEquilibria:
    """The equilibria of the trials of `paths`, each reached from its parent on the path.

    Parameters
    ----------
    paths
        Flexion and generalised loads of (varus, internal [N mm], x, y, z [N]) in small steps, as
        `identknee.mechanics.equilibria.load_paths` makes them.
    start
        Pose where the paths begin: varus, internal [rad], x, y, z [mm], shape ``(5,)``, or one for
        each node, ``(n_nodes, 5)``.
    contact
        The meshes and whose vertices count.
    lines
        Insertions and reference lengths of the m ligaments.
    stiffness
        [N per unit strain], shape ``(m,)``.
    reference_strain
        Strain at the reference length [-], shape ``(m,)``.
    """
    n_nodes = len(paths.flexion)
    poses, residuals = np.empty((n_nodes, 5)), np.empty(n_nodes)
    evaluations = np.empty(n_nodes, np.int64)
    starts = np.broadcast_to(start, (n_nodes, 5))
    for node in range(n_nodes):
        parent = int(paths.parent[node])
        balance = partial(
            _balance,
            flexion=float(paths.flexion[node]),
            load=paths.loads[node],
            contact=contact,
            ligaments=(lines, stiffness, reference_strain),
        )
        first = starts[node] if parent < 0 else poses[parent]
        poses[node], residuals[node], evaluations[node] = _search(balance, first)
    chosen = paths.trial_node
    return MeshEquilibria(
        poses=poses[chosen],
        residuals=residuals[chosen],
        outcomes=tuple(
            Outcome.CONVERGED if residuals[node] <= RESIDUAL_TOLERANCE else Outcome.NO_EQUILIBRIUM
            for node in chosen
        ),
        evaluations=evaluations[chosen],
    )


def _balance(
    pose: Array,
    *,
    flexion: float,
    load: Array,
    contact: MeshContact,
    ligaments: tuple[LineLigaments, Array, Array],
) -> tuple[Array, Array]:
    placement = place(flexion, pose)
    pressed = contact.wrench(placement)
    pulled = ligament_wrench(placement, *ligaments)
    return pressed.force + pulled.force + load, pressed.stiffness + pulled.stiffness


def _search(balance: _Balance, start: Array) -> tuple[Array, float, int]:
    """The pose of the smallest residual met, that residual [N], and the evaluations made."""
    pose = np.array(start, float)
    residual, stiffness = balance(pose)
    size = _size(residual)
    evaluations = 1
    for _ in range(MOST_ITERATIONS):
        if size <= RESIDUAL_TOLERANCE:
            break
        scaled = stiffness / _SCALE / _SCALE[:, None]
        values, vectors = np.linalg.eigh(scaled)
        values = np.maximum(np.abs(values), LEAST_STIFFNESS)
        step = vectors @ ((vectors.T @ (residual / _SCALE)) / values)
        step *= min(1.0, LONGEST_STEP / max(float(np.linalg.norm(step)), 1e-300))
        step = step / _SCALE
        for halving in range(MOST_HALVINGS + 1):
            trial = pose + step * 0.5**halving
            trial_residual, trial_stiffness = balance(trial)
            evaluations += 1
            if _size(trial_residual) < size:
                break
        else:
            # No shorter step helps: the force jumps here.
            break
        pose, residual, stiffness = trial, trial_residual, trial_stiffness
        size = _size(residual)
    return pose, size, evaluations


def _size(residual: Array) -> float:
    return float(np.linalg.norm(residual / _SCALE))
