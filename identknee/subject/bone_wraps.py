"""Ligaments that run over the surface of a bone, such as the MCL over the rim of the plateau."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.mechanics.closest_point import mesh_distance
from identknee.runs.declare import Array
from identknee.runs.errors import ValueRefused, suggestion
from identknee.subject.knee import Knee
from identknee.subject.ligament import Ligament, Obstacle, circle_through, way_over
from identknee.subject.surface import Surface

# Length at each insertion over which a ligament lies on the bone and its depth does not count [mm].
NEAR_INSERTION = 5.0
# A line that cuts less deep into a bone counts as straight [mm].
LEAST_DEPTH = 0.5
# Smallest and largest radius of an obstacle [mm]; the smallest stands for a sharp edge of bone.
EDGE, LARGEST = 4.0, 60.0
# Points between the insertions at which the depth is evaluated.
N_POINTS = 200
STEP = 0.1  # mm, of the finite difference that gives the normal of the bone


def with_wraps(knee: Knee, ligaments: Sequence[str]) -> Knee:
    """The knee with ligaments that wrap around the bone that their straight lines cut.

    The obstacle is the cylinder across the shortest way over the bone in the scanned pose, in the
    plane of the line and the bone's normal where the line is deepest. Its circle goes through the
    bone where that way touches it. A line that cuts less than 0.5 mm deep stays straight.

    Parameters
    ----------
    knee
        A knee with the surfaces of its bones.
    ligaments
        Their names, or the beginning of several names, such as ``"MCL"`` for MCLa and MCLp.

    Raises
    ------
    ValueError
        If the knee has no surfaces of bones, or no ligament's name begins with one of these.
    """
    if knee.bones is None:
        raise ValueRefused(
            f"{knee.name} has no surfaces of its bones",
            "give femur_bone and tibia_bone under [surfaces], or state [ligaments.wrap]",
        )
    names = [x.name for x in knee.ligaments]
    for wanted in ligaments:
        if not any(x.startswith(wanted) for x in names):
            raise ValueRefused(
                f"no ligament of {knee.name} is called {wanted}",
                suggestion(wanted, names).rstrip("."),
            )
    made = [
        replace(x, wrap=_around(x, knee.bones)) if x.name.startswith(tuple(ligaments)) else x
        for x in knee.ligaments
    ]
    return knee.with_ligaments(made)


def _around(ligament: Ligament, bones: Sequence[Surface]) -> Obstacle | None:
    """The obstacle of a ligament; None where its straight line passes both bones."""
    start, end = ligament.femur, ligament.tibia
    span = float(np.linalg.norm(end - start))
    along = (end - start) / span
    places = np.linspace(NEAR_INSERTION, span - NEAR_INSERTION, N_POINTS)
    depths = []
    for bone in bones:
        distance = mesh_distance(bone.vertices, bone.faces)
        found = distance(start + places[:, None] * along)
        deepest = start + places[np.argmin(found)] * along
        moved = deepest + STEP * np.vstack([np.eye(3), -np.eye(3)])
        outwards = np.subtract(*np.split(distance(moved), 2))
        depths.append((float(found.min()), outwards))
    which = int(np.argmin([x for x, _ in depths]))
    depth, outwards = depths[which]
    up = outwards - (outwards @ along) * along
    size = float(np.linalg.norm(up))
    if depth > -LEAST_DEPTH or size == 0.0:
        return None
    up /= size
    section = _section(bones[which], start, along, up)
    is_between = (section[:, 0] > NEAR_INSERTION) & (section[:, 0] < span - NEAR_INSERTION)
    # The bone's other side is above the line as well where it is hollow; the way is the near one.
    is_near = (section[:, 1] > 0.0) & (section[:, 1] < -2.0 * depth + EDGE)
    _, touching = way_over(section[is_between & is_near], span)
    if not len(touching):
        return None
    middle, radius = _circle(touching, span)
    return Obstacle(
        bone="tibia" if which else "femur",
        centre=start + middle[0] * along + middle[1] * up,
        radius_mm=radius,
        axis=np.cross(along, up),
        side=up,
    )


def _circle(touching: Array, span: float) -> tuple[Array, float]:
    """Centre and radius of the circle that stands for the bone where the way touches it."""
    top = touching[np.argmax(touching[:, 1])]
    middle, radius = top - [0.0, EDGE], EDGE
    if len(touching) > 2:
        first, last = touching[0], touching[-1]
        between = touching[len(touching) // 2]
        turned = np.cross([*(between - first), 0.0], [*(last - first), 0.0])[2]
        if turned != 0.0:
            middle, radius = circle_through(np.array([first, between, last]))
    if not EDGE <= radius <= LARGEST:
        radius = min(max(radius, EDGE), LARGEST)
        middle = top - [0.0, radius]
    # Insertions lie outside.
    while radius > 1.0 and min(np.hypot(*middle), np.hypot(*(middle - [span, 0.0]))) <= radius:
        radius *= 0.9
        middle = top - [0.0, radius]
    return middle, float(radius)


def _section(surface: Surface, origin: Array, along: Array, up: Array) -> Array:
    """Points where a plane cuts the edges of a surface: along and up from `origin`, ``(n, 2)``."""
    normal = np.cross(along, up)
    edges = np.concatenate([surface.faces[:, x] for x in ([0, 1], [1, 2], [2, 0])])
    off = (surface.vertices - origin) @ normal
    first, second = off[edges].T
    cut = first * second < 0.0
    share = (first[cut] / (first[cut] - second[cut]))[:, None]
    a, b = (surface.vertices[x] for x in edges[cut].T)
    points = a + share * (b - a) - origin
    return np.column_stack([points @ along, points @ up])
