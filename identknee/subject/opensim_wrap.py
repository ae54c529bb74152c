"""Wrap objects of the paths of an OpenSim model, as cylinders and spheres.

Cylinders and spheres are taken as they are. An ellipsoid becomes the cylinder that fits it along
the path: its axis is across the plane of the shortest way around the ellipsoid, its circle that of
the arc where the way touches.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from identknee.runs.declare import Array, declared, entry
from identknee.runs.errors import ValueRefused
from identknee.subject.ligament import Obstacle, circle_through, way_over
from identknee.subject.opensim_model import MM_PER_M, Element, OsimModel, Transform

Bone = Literal["femur", "tibia"]
# Corners of a section of an ellipsoid, and the largest turn of its plane in the search for the
# shortest way.
N_CORNERS, FARTHEST_TURN = 720, np.radians(80.0)
# Flexion at which lengths are compared [deg].
COMPARED_AT = (0.0, 30.0, 60.0)
SEVERAL = "straight lines replace paths that bend at points or wrap around several objects"
OTHER_OBJECT = "straight lines replace paths around objects of other classes, or that end inside"


@declared
class WrapObject:
    """A wrap object of a bone of the knee."""

    element: Element = entry("Its XML")
    bone: Bone = entry("The bone that it is fixed to")
    frame: Transform = entry("Where its frame is in the common frame [m]")


@declared
class Wrapping:
    """What one path wraps around."""

    obstacle: Obstacle | None = entry("The obstacle; None where a straight line replaces the path")
    why_straight: str = entry("Why it does, as a clause", default="")
    error_mm: float = entry(
        "Largest error of a length by the fitted cylinder at flexion of 0 to 60 deg; NaN where the "
        "object is a cylinder or a sphere",
        default=float("nan"),
    )


def wrap_objects(
    model: OsimModel, bones: Mapping[Bone, Mapping[str, Transform]]
) -> dict[str, WrapObject]:
    """The active wrap objects of the bodies of both bones, by name.

    Parameters
    ----------
    model
        The model.
    bones
        Bodies of each bone, and where they are in the common frame [m].
    """
    found = {}
    for body in model.listed("BodySet"):
        for bone, bodies in bones.items():
            for element in body.iterfind("WrapObjectSet/objects/*"):
                is_off = (element.findtext("active") or "").strip().lower() in ("false", "0")
                if body.get("name") in bodies and not is_off:
                    own = model.transform(element, "xyz_body_rotation")
                    found[element.get("name", "")] = WrapObject(
                        element=element, bone=bone, frame=bodies[body.get("name", "")] @ own
                    )
    return found


def wrapping_of(
    model: OsimModel, path: Element, objects: Mapping[str, WrapObject], femur: Array, tibia: Array
) -> Wrapping:
    """What a ligament's path wraps around.

    Parameters
    ----------
    model
        The model.
    path
        The XML of the ligament.
    objects
        As `wrap_objects` gives them.
    femur, tibia
        Its ends in the common frame [mm].
    """
    names = [
        (x.findtext("wrap_object") or "").strip()
        for x in path.iterfind(".//PathWrapSet/objects/PathWrap")
    ]
    own = [objects[x] for x in names if x in objects]
    if len(path.findall(".//PathPointSet/objects/*")) > 2 or len(own) > 1:
        return Wrapping(obstacle=None, why_straight=SEVERAL)
    if not own:
        return Wrapping(obstacle=None)
    found = own[0]
    kind = found.element.tag
    if kind == "WrapEllipsoid":
        return _around_ellipsoid(model, found, femur, tibia)
    if kind not in ("WrapCylinder", "WrapSphere"):
        return Wrapping(obstacle=None, why_straight=OTHER_OBJECT)
    centre, is_sphere = found.frame.translation * MM_PER_M, kind == "WrapSphere"
    radius = model.number(found.element, "radius") * MM_PER_M
    try:
        obstacle = Obstacle(
            bone=found.bone,
            centre=centre,
            radius_mm=radius,
            axis=None if is_sphere else found.frame.rotation[:, 2],
            side=None if is_sphere else _side(found),
        )
        obstacle.turning_axis(femur, tibia)
    except ValueRefused:
        return Wrapping(obstacle=None, why_straight=OTHER_OBJECT)
    distances = np.linalg.norm(obstacle.from_axis(np.array([femur, tibia])), axis=1)
    if distances.min() <= radius:
        return Wrapping(obstacle=None, why_straight=OTHER_OBJECT)
    return Wrapping(obstacle=obstacle)


def _side(found: WrapObject) -> Array | None:
    """Where a path may pass, from the object's quadrant; None where it may pass anywhere."""
    quadrant = (found.element.findtext("quadrant") or "all").strip().lower().lstrip("+")
    axis = "xyz".find(quadrant.lstrip("-")[:1] or "?")
    if quadrant == "all" or axis not in (0, 1):
        return None
    return np.asarray((-1.0 if quadrant.startswith("-") else 1.0) * found.frame.rotation[:, axis])


def _around_ellipsoid(model: OsimModel, found: WrapObject, femur: Array, tibia: Array) -> Wrapping:
    radii = model.vector(found.element, "dimensions") * MM_PER_M
    into = found.frame.inverse

    def own(points: Array) -> Array:
        return np.asarray(into(points / MM_PER_M) * MM_PER_M)

    start, end = own(femur), own(tibia)
    if (radii <= 0.0).any() or min(np.sum((x / radii) ** 2) for x in (start, end)) <= 1.0:
        return Wrapping(obstacle=None, why_straight=OTHER_OBJECT)
    way = shortest_way(start, end, radii)
    turn = found.frame.rotation
    try:
        obstacle = Obstacle(
            bone=found.bone,
            centre=found.frame(way.centre / MM_PER_M) * MM_PER_M,
            radius_mm=way.radius,
            axis=turn @ way.axis,
            side=turn @ way.side,
        )
        obstacle.turning_axis(femur, tibia)
    except ValueRefused:
        return Wrapping(obstacle=None, why_straight=OTHER_OBJECT)
    errors = []
    for flexion in np.radians(COMPARED_AT):
        cos, sin = np.cos(flexion), np.sin(flexion)
        forth = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        # Seen from the bone that has the object, the other one turns about the femur's axis.
        ends = (forth @ femur, tibia) if found.bone == "tibia" else (femur, forth.T @ tibia)
        right = shortest_way(own(ends[0]), own(ends[1]), radii).length
        errors.append(abs(obstacle.length_of_way(*ends) - right))
    return Wrapping(obstacle=obstacle, error_mm=max(errors))


@declared
class EllipsoidWay:
    """The shortest way around an ellipsoid, and the circle of its arc, in the ellipsoid's axes."""

    length: float = entry("Its length", unit="mm")
    centre: Array = entry("Centre of the circle [mm], shape ``(3,)``")
    radius: float = entry("Its radius", unit="mm")
    axis: Array = entry("Unit vector across its plane, shape ``(3,)``")
    side: Array = entry("Unit vector from the centre to the way, shape ``(3,)``")


def shortest_way(start: Array, end: Array, radii: Array) -> EllipsoidWay:
    """The shortest way in one plane from `start` to `end` around an ellipsoid at the origin.

    A shortest way around an ellipsoid hardly leaves a plane where it touches over a small part of
    it, as ligaments do. Where it does not touch, the circle is that of the section's point next to
    the straight line.
    """
    along = (end - start) / np.linalg.norm(end - start)
    out = start - (start @ along) * along
    size = np.linalg.norm(out)
    out = out / size if size > 0.0 else np.linalg.svd(along[None])[2][1]
    across = np.cross(along, out)

    def length(turn: float) -> float:
        return _in_plane(start, end, radii, np.cos(turn) * out + np.sin(turn) * across)[0]

    best = minimize_scalar(
        length, bounds=(-FARTHEST_TURN, FARTHEST_TURN), method="bounded", options={"xatol": 1e-4}
    )
    turn = float(best.x) if best.fun < length(0.0) - 1e-9 else 0.0
    up = np.cos(turn) * out + np.sin(turn) * across
    found, corners = _in_plane(start, end, radii, up)
    middle, radius = circle_through(corners)
    return EllipsoidWay(
        length=found,
        centre=start + middle[0] * along + middle[1] * up,
        radius=radius,
        axis=np.cross(along, up),
        side=up,
    )


def _in_plane(start: Array, end: Array, radii: Array, up: Array) -> tuple[float, Array]:
    """Length of the way on the side `up` of a plane, and three corners of the section it touches.

    The corners, shape ``(3, 2)``, are along the straight line and up from it.
    """
    span = float(np.linalg.norm(end - start))
    along = (end - start) / span
    # start + a along + b up on the ellipsoid: a circle where lengths are divided by the radii.
    s, u, v = start / radii, along / radii, up / radii
    basis = np.column_stack([u, v])
    q = basis.T @ basis
    middle = -np.linalg.solve(q, basis.T @ s)
    rest = 1.0 - s @ s - (basis.T @ s) @ middle
    if rest <= 0.0:
        return span, np.array([[0.0, -1.0], [0.5 * span, -1.0], [span, -1.0]])
    angles = np.linspace(0.0, 2.0 * np.pi, N_CORNERS, endpoint=False)
    values, vectors = np.linalg.eigh(q)
    axes = vectors * np.sqrt(rest / values)
    section = middle + np.column_stack([np.cos(angles), np.sin(angles)]) @ axes.T
    crossings = np.roots([u @ u, 2.0 * (s @ u), s @ s - 1.0])
    if np.isrealobj(crossings) and crossings.min() > 0.0 and crossings.max() < span:
        length, touching = way_over(section[section[:, 1] > 0.0], span)
        if len(touching) > 4:
            return length, touching[[1, len(touching) // 2, -2]]
    # The corner next to the line, and its neighbours.
    off = section - np.column_stack([np.clip(section[:, 0], 0.0, span), np.zeros(N_CORNERS)])
    top = int(np.argmin((off**2).sum(axis=1)))
    near = [(top + x) % N_CORNERS for x in (-8, 0, 8)]
    return span, section[near]
