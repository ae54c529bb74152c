"""The points at which contact is evaluated: centroids of equal patches of the tibial surface."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from identknee.mechanics.distance_field import ContactLaw, DistanceField
from identknee.mechanics.equilibria import NO_MENISCI, UNIT_LAW, ContactPoints
from identknee.mechanics.pose import Placement, place, rotation_matrix
from identknee.runs.declare import Array, BoolArray, IntArray, array, declared, entry
from identknee.runs.progress import progress
from identknee.runs.triangles import blocks, doubled_areas, lengths, side_names

DEFAULT_NUMBER = 1500
MOST_PIECES = 20  # a sheet is cut into about this many pieces a patch, or more
ROUNDS = 40  # of Lloyd's iteration


def contact_points(
    sheets: Sequence[tuple[Array, IntArray]], number: int | None = DEFAULT_NUMBER
) -> ContactPoints:
    """Quadrature points of the tibial sheets with their tributary areas, about `number` in all.

    A surface with more vertices than that is clustered into patches of nearly equal size (Lloyd's
    iteration, as in [1]_), each represented by its centroid and its whole area, so that the depth
    of a patch is right to second order. Where there are no more vertices than asked for, or
    `number` is None, the points are the vertices, each with a third of the triangles around it.

    Parameters
    ----------
    sheets
        Vertices ``(n, 3)`` [mm] and faces ``(m, 3)`` of each tibial surface.
    number
        How many points are wanted; None for every vertex.

    References
    ----------
    .. [1] Valette and Chassery (2004), Comput. Graph. Forum 23(3), 381-389.
           https://doi.org/10.1111/j.1467-8659.2004.00769.x
    """
    total = sum(len(vertices) for vertices, _ in sheets)
    whole = sum(triangle_areas(vertices, faces).sum() for vertices, faces in sheets)
    points, areas, compartment = [], [], []
    for index, (vertices, faces) in enumerate(sheets):
        # A few more than asked for are kept as they are: clustering would gain nothing.
        if number is None or total <= 1.2 * number:
            found, area = vertices, np.zeros(len(vertices))
            for k in range(3):
                np.add.at(area, faces[:, k], triangle_areas(vertices, faces) / 3.0)
        else:
            share = triangle_areas(vertices, faces).sum() / whole
            found, area = _patches(vertices, faces, max(1, round(number * share)))
        points.append(found)
        areas.append(area)
        compartment.append(np.full(len(found), index))
    return ContactPoints(
        points=np.concatenate(points),
        areas=np.concatenate(areas),
        compartment=np.concatenate(compartment),
    )


def triangle_areas(vertices: Array, faces: IntArray) -> Array:
    """Area of each triangle [mm2], shape ``(m,)``."""
    return np.asarray(0.5 * lengths(doubled_areas(vertices, faces)))


def _patches(vertices: Array, faces: IntArray, number: int) -> tuple[Array, Array]:
    """Centroids and areas of `number` patches of nearly equal size."""
    # It loads most of scipy, which surfaces of few vertices do without.
    from scipy.spatial import cKDTree

    corner = vertices[faces]
    while len(corner) < MOST_PIECES * number:
        a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        corner = np.concatenate([np.stack(part, axis=1) for part in parts])
    pieces = corner.mean(axis=1)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    weight = 0.5 * np.linalg.norm(normal, axis=1)
    # Seeds evenly along the surface's area, in an order that keeps neighbours together.
    order = cKDTree(pieces).indices
    passed = np.cumsum(weight[order]) - 0.5 * weight[order]
    seeds = order[np.searchsorted(passed, (np.arange(number) + 0.5) * weight.sum() / number)]
    centroid = pieces[seeds]
    for _ in progress(range(ROUNDS), description="choosing contact points"):
        nearest = cKDTree(centroid).query(pieces, workers=-1)[1]
        total, *sums = (
            np.asarray(np.bincount(nearest, values, len(centroid)), np.float64)
            for values in (weight, *(weight * pieces.T))
        )
        moment = np.stack(sums, axis=1)[total > 0.0]
        area = total[total > 0.0]
        centroid = moment / area[:, None]
    return centroid, area


# Poses whose contact is evaluated at once; the places of their points take 100 MB.
AT_ONCE = 200


@declared
class ContactPlaces:
    """The k points of the tibia that touch the femur, in one pose or in several."""

    pose: IntArray = entry("In which pose they touch, shape ``(k,)``")
    index: IntArray = entry("Which contact points they are, shape ``(k,)``")
    femoral: Array = entry("Where they are, in the axes of the field [mm], shape ``(k, 3)``")
    outward: Array = entry("Gradient of the femur's distance there, shape ``(k, 3)``")
    depth: Array = entry("How deep they lie in the femur, negative in a gap [mm], shape ``(k,)``")
    jacobian: Array = entry("Derivatives of those places by the pose, shape ``(k, 5, 3)``")
    deepening: Array = entry("Derivatives of the depths by the pose [mm/rad, -], shape ``(k, 5)``")
    force: Array = entry("Force of each [N], shape ``(k,)``")
    stiffness: Array = entry("Derivative of the force by the depth [N/mm], shape ``(k,)``")

    def of_pose(self, number: int) -> "ContactPlaces":
        """Those of one of the poses."""
        own = self.pose == number
        return ContactPlaces(**{x: getattr(self, x)[own] for x in CONTACT_ARRAYS})

    def wrenches(self, n: int) -> Array:
        """Their force on the tibia along each freedom of n poses, without its sign, ``(n, 5)``."""
        each = self.force[:, None] * self.deepening
        return np.stack([np.bincount(self.pose, x, n) for x in each.T], axis=1)


CONTACT_ARRAYS = tuple(x.name for x in fields(ContactPlaces))


def contact_places(
    contact: ContactPoints, field: DistanceField, flexion: Array, poses: Array
) -> ContactPlaces:
    """The contact at flexion angles ``(n,)`` [rad] and poses ``(n, 5)``, by the kernel's law."""
    parts = [
        _contact_places(contact, field, flexion[i : i + AT_ONCE], poses[i : i + AT_ONCE])
        for i in range(0, max(len(poses), 1), AT_ONCE)
    ]
    if len(parts) == 1:
        return parts[0]
    whole = {x: np.concatenate([getattr(y, x) for y in parts]) for x in CONTACT_ARRAYS}
    first = np.repeat(AT_ONCE * np.arange(len(parts)), [len(x.pose) for x in parts])
    return ContactPlaces(**{**whole, "pose": whole["pose"] + first})


def _contact_places(
    contact: ContactPoints, field: DistanceField, flexion: Array, poses: Array
) -> ContactPlaces:
    placed, law = place(flexion, poses), contact.law or ContactLaw()
    places = field.to_field(placed.to_femur(contact.points))
    # Cells that may hold contact; those at the grid's faces do not.
    last = np.array(field.reach.shape) - 1
    cell = np.clip(np.floor((places - field.origin) / field.spacing), 0, last).astype(np.int64)
    pose, index = np.nonzero(field.reach[cell[..., 0], cell[..., 1], cell[..., 2]] > 0)
    femoral = places[pose, index]
    distance, outward = distances(field, femoral)
    inside = distance < law.rounding
    found = pose[inside], index[inside], femoral[inside], outward[inside], -distance[inside]
    return _pressing(placed, field, contact.points, contact.areas, law, found)


def meniscus_places(
    contact: ContactPoints, field: DistanceField, flexion: Array, poses: Array
) -> ContactPlaces:
    """The points of the menisci that press at flexion angles ``(n,)`` [rad] and poses ``(n, 5)``.

    Depths are those in a femur whose surface lies as much higher as each point is high. There are
    none where the contact has no menisci.
    """
    placed, menisci = place(flexion, poses), contact.menisci or NO_MENISCI
    places = field.to_field(placed.to_femur(menisci.points))
    wide, law = menisci.field or field, UNIT_LAW
    pose, index = np.nonzero(_is_in_field(wide, places))
    femoral = places[pose, index]
    distance, outward = distances(wide, femoral)
    depth = menisci.heights[index] - distance
    inside = depth > -law.rounding
    found = pose[inside], index[inside], femoral[inside], outward[inside], depth[inside]
    springs = menisci.areas * menisci.stiffness[menisci.side]
    return _pressing(placed, field, menisci.points, springs, law, found)


def _pressing(
    placed: Placement,
    field: DistanceField,
    points: Array,
    springs: Array,
    law: ContactLaw,
    found: tuple[IntArray, IntArray, Array, Array, Array],
) -> ContactPlaces:
    """Contact places of points that press, each with a force of its spring times the pressure.

    The arrays of `found` are the pose, the index and the place of each point, the gradient of the
    distance there, and the depth.
    """
    pose, index, femoral, outward, depth = found
    jacobian = placed.jacobian(points[index], pose)
    if field.turn is not None:
        jacobian = jacobian @ field.turn.T
    pressure, slope = law.pressure(depth)
    return ContactPlaces(
        pose=pose,
        index=index,
        femoral=femoral,
        outward=outward,
        depth=depth,
        jacobian=jacobian,
        deepening=-np.einsum("kai,ki->ka", jacobian, outward),
        force=springs[index] * pressure,
        stiffness=springs[index] * slope,
    )


def distances(field: DistanceField, places: Array) -> tuple[Array, Array]:
    """Signed distance [mm] of places (n, 3) inside the grid, ``(n,)``, and its gradient (n, 3)."""
    found = _expansions(field, places)
    return found[:, 0], found[:, 1:4]


def gaps_to(field: DistanceField, places: Array) -> Array:
    """Signed distance [mm] of places (n, 3) to the femur, ``(n,)``; infinite outside the field."""
    inside = _is_in_field(field, places)
    gaps = np.full(len(places), np.inf)
    gaps[inside] = distances(field, places[inside])[0]
    return gaps


def _is_in_field(field: DistanceField, places: Array) -> BoolArray:
    """Which of places (..., 3) have the spline's support around them, ``(...)``."""
    cell = np.floor((places - field.origin) / field.spacing)
    last = np.array(field.coefficients.shape) - 3.0
    return np.asarray(((cell >= 1.0) & (cell <= last)).all(axis=-1))


def distance_bending(field: DistanceField, places: Array) -> Array:
    """Second derivatives of the distance at places (n, 3) inside the grid [1/mm], ``(n, 3, 3)``."""
    # Those along x, y and z, then of x and y, x and z, y and z.
    return _expansions(field, places)[:, np.array([[4, 7, 8], [7, 5, 9], [8, 9, 6]])]


def _expansions(field: DistanceField, places: Array) -> Array:
    """Distance, gradient and second derivatives of the spline at places inside it, ``(n, 10)``."""
    # The compiler takes half a second to load.
    from identknee.mechanics.contact_elements import expand_at

    at = np.ascontiguousarray((places - field.origin) / field.spacing)
    found = np.empty((len(at), 10))
    expand_at(at, field.coefficients.reshape(-1), field.coefficients.shape, found)
    return found / field.spacing ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])


def contact_motion_columns(sums: Array, flexion: Array, poses: Array) -> Array:
    """Derivatives of the energy's gradient by small motions of the surfaces, ``(n, 5, 12)``.

    Parameters
    ----------
    sums
        Those over the contact elements at each pose, as
        `identknee.mechanics.elements.write_sums` writes them, shape ``(n, 39)``.
    flexion
        [rad], shape ``(n,)``.
    poses
        Shape ``(n, 5)``.

    Returns
    -------
    columns
        By a rotation [rad] about and a shift [mm] along the axes of the femoral frame, of places
        within the femur's surface; then about and along those of the tibial frame, of the tibia's
        surface.
    """
    moment, stiffness, turning, swinging = (
        sums[:, k : k + 9].reshape(-1, 3, 3) for k in (3, 12, 21, 30)
    )
    pushing = _crossing(sums[:, :3])
    trace = np.trace(moment, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    rotation = np.moveaxis(rotation_matrix(flexion, poses[:, 0], poses[:, 1]), 2, 0)
    flexed = np.moveaxis(rotation_matrix(flexion, 0.0 * flexion, 0.0 * flexion), 2, 0)
    # Axes of the two rotations and of the three shifts of the pose, one a row.
    about = np.stack([flexed[:, :, 0], rotation[:, :, 1]], axis=1)
    along = np.swapaxes(flexed, 1, 2)
    # A turn of the femur is one about the tibial origin and a shift of that.
    lever = _crossing((flexed @ poses[:, 2:, None])[:, :, 0])
    swapped = np.swapaxes(turning, 1, 2)
    carried = np.stack([swapped, stiffness], axis=1) @ lever[:, None]
    # The outer of two turns turns the axis of the other, and pushes that the other turns.
    moments_by_turn = swinging + moment - trace - carried[:, 0]
    forces_by_turn = turning + pushing - carried[:, 1]
    inner = np.stack(
        [swinging + np.swapaxes(moment, 1, 2) - trace, swapped - pushing, turning, stiffness],
        axis=1,
    )
    own = inner @ rotation[:, None]
    moments = np.concatenate([moments_by_turn, swapped, own[:, 0], own[:, 1]], axis=2)
    forces = np.concatenate([forces_by_turn, stiffness, own[:, 2], own[:, 3]], axis=2)
    return np.concatenate([about @ moments, along @ forces], axis=1)


def _crossing(vectors: Array) -> Array:
    """Matrices (n, 3, 3) that take the cross product of each of `vectors` (n, 3) with another."""
    x, y, z = vectors.T
    none = np.zeros(len(vectors))
    rows = np.array([[none, -z, y], [z, none, -x], [-y, x, none]])
    return np.asarray(np.moveaxis(rows, 2, 0))


RIM_MARGIN = 3.0  # mm
FEW = 100  # places; for fewer, a direct search is faster than loading scipy


@declared
class RimDistance:
    """Distance of the vertices of a sheet from its rim."""

    vertices: Array = array("Vertices of the sheet", "vertex", "axis", unit="mm")
    rim: Array = array(
        "Those on the rim; none where the surface is closed", "rim vertex", "axis", unit="mm"
    )

    @property
    def distances(self) -> Array:
        """Straight distance of each vertex to the nearest of the rim [mm]; infinite without one."""
        return self._from_rim(self.vertices)

    def at(self, places: Array) -> Array:
        """Distance from the rim [mm] of the vertex nearest each of `places` (n, 3) [mm]."""
        return self._from_rim(self.vertices[_nearest(self.vertices, places)])

    def _from_rim(self, places: Array) -> Array:
        if not len(self.rim):
            return np.full(len(places), np.inf)
        return np.asarray(np.linalg.norm(places - self.rim[_nearest(self.rim, places)], axis=1))


def _nearest(vertices: Array, places: Array) -> IntArray:
    """Which of the vertices is nearest each place, shape ``(n,)``."""
    if len(places) > FEW:
        # Loaded late, as it takes most of scipy.
        from scipy.spatial import cKDTree

        return np.asarray(cKDTree(vertices).query(places)[1])
    middle = vertices.mean(axis=0)
    least, nearest = np.full(len(places), np.inf), np.zeros(len(places), np.int64)
    for part in blocks(len(vertices)):
        around = vertices[part] - middle
        halves = 0.5 * np.sum(around**2, axis=1)
        found = halves - (places - middle) @ around.T
        here = np.argmin(found, axis=1)
        lower = found[np.arange(len(places)), here]
        is_nearer = lower < least
        least[is_nearer], nearest[is_nearer] = lower[is_nearer], part.start + here[is_nearer]
    return nearest


def rim_distance(vertices: Array, faces: IntArray) -> RimDistance:
    """Distance from the rim of a triangle mesh: vertices ``(n, 3)`` [mm], faces ``(m, 3)``."""
    named, count = np.unique(side_names(faces, len(vertices)), return_counts=True)
    once = named[count == 1]
    is_on_rim = np.zeros(len(vertices), bool)
    is_on_rim[once // len(vertices)] = is_on_rim[once % len(vertices)] = True
    return RimDistance(vertices=vertices, rim=vertices[is_on_rim])


def rim_force_fraction(
    centres: Array, femoral: RimDistance, tibial: tuple[RimDistance, ...]
) -> Array:
    """Share of each trial's contact force that acts within 3 mm of a rim, shape ``(n,)``.

    Parameters
    ----------
    centres
        For each trial and compartment: force [N], its centre in tibial and in femoral axes [mm],
        shape ``(n, compartments, 7)``.
    femoral, tibial
        The rims, one a tibial surface.
    """
    forces = centres[:, :, 0]
    near = np.zeros(len(centres))
    for c, rim in enumerate(tibial):
        margin = np.minimum(rim.at(centres[:, c, 1:4]), femoral.at(centres[:, c, 4:7]))
        near += forces[:, c] * (margin < RIM_MARGIN)
    total = forces.sum(axis=1)
    return np.asarray(np.divide(near, total, out=np.zeros(len(centres)), where=total > 0.0))
