"""Tensions and wrenches of line ligaments at many poses at once, with their exact slopes."""

import numpy as np

from identknee.mechanics.equilibria import TRANSITION_STRAIN, LineLigaments
from identknee.mechanics.memory import COURSE, record
from identknee.mechanics.pose import Placement, rotation_matrix
from identknee.runs.declare import Array, IntArray, array, declared


@declared
class LigamentWrench:
    """Generalised force, stiffness and tensions of the ligaments at one pose."""

    force: Array = array(
        "Generalised force on varus, internal rotation, x, y and z", "freedom", unit="N mm or N"
    )
    stiffness: Array = array(
        "Minus its derivative by the pose, the Hessian of the ligaments' energy",
        *("freedom", "freedom"),
        unit="N mm, N or N/mm",
    )
    tensions: Array = array("Tensions", "ligament", unit="N")


def line_tensions(
    strain: Array, stiffness: Array, transition: Array | float = TRANSITION_STRAIN
) -> tuple[Array, Array]:
    """Tension [N] at `strain` of lines of `stiffness` [N], and its derivative by strain [N].

    Where `transition` is negative the line is a spring, which pushes as well as it pulls.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883

    Examples
    --------
    >>> tension, slope = line_tensions(np.array([-0.1, 0.03, 0.06, 0.1]), np.full(4, 1000.0))
    >>> tension
    array([ 0. ,  7.5, 30. , 70. ])
    """
    width = np.abs(transition)
    stretched = np.maximum(strain, 0.0)
    toe = stretched < 2.0 * width
    tension = np.where(toe, stretched**2 / (4.0 * width), stretched - width)
    slope = np.where(toe, stretched / (2.0 * width), 1.0)
    is_spring = np.asarray(transition) < 0.0
    tension, slope = np.where(is_spring, strain, tension), np.where(is_spring, 1.0, slope)
    return stiffness * tension, stiffness * slope


def ligament_wrench(
    placement: Placement, lines: LineLigaments, stiffness: Array, reference_strain: Array
) -> LigamentWrench:
    """Tensions, generalised force and stiffness of the ligaments at a placement of the tibia.

    Parameters
    ----------
    placement
        Where the tibia stands.
    lines
        Insertions and reference lengths of the m ligaments.
    stiffness
        [N per unit strain], shape ``(m,)``.
    reference_strain
        Strain at the reference length [-], shape ``(m,)``.
    """
    offset = placement.to_femur(lines.tibial) - lines.femoral
    length = np.linalg.norm(offset, axis=1)
    direction = offset / length[:, None]
    slack_length = lines.reference_length / (1.0 + reference_strain)
    tension, slope = line_tensions(length / slack_length - 1.0, stiffness)
    jacobian = placement.jacobian(lines.tibial)
    lengthening = np.einsum("nai,ni->na", jacobian, direction)
    turning = tension / length
    hessian = (
        np.einsum("n,na,nb->ab", slope / slack_length - turning, lengthening, lengthening)
        + np.einsum("n,nai,nbi->ab", turning, jacobian, jacobian)
        + placement.bending(lines.tibial, tension[:, None] * direction)
    )
    return LigamentWrench(force=-tension @ lengthening, stiffness=hessian, tensions=tension)


@declared
class LigamentTensions:
    """Tensions and strains of ligaments at poses, with their derivatives.

    The five coordinates are varus, internal rotation, x, y and z.
    """

    tensions: Array = array("Tensions", "pose", "ligament", unit="N")
    lengthening: Array = array(
        "Derivatives of the lengths by the coordinates",
        *("pose", "ligament", "freedom"),
        unit="mm/rad or mm/mm",
    )
    by_pose: Array = array(
        "Derivatives of the tensions by the coordinates",
        *("pose", "ligament", "freedom"),
        unit="N/rad or N/mm",
    )
    by_stiffness: Array = array(
        "Derivative of each tension by the ligament's own stiffness", "pose", "ligament"
    )
    by_strain: Array = array(
        "Derivative of each tension by the ligament's own reference strain",
        *("pose", "ligament"),
        unit="N",
    )
    strains: Array = array("Strains, negative where a ligament is slack", "pose", "ligament")
    strains_by_pose: Array = array(
        "Derivatives of the strains by the coordinates",
        *("pose", "ligament", "freedom"),
        unit="1/rad or 1/mm",
    )
    strains_by_strain: Array = array(
        "Derivative of each strain by the ligament's own reference strain",
        *("pose", "ligament"),
    )

    @property
    def gradient(self) -> Array:
        """Gradient of the ligaments' energy by the pose [N mm, N], shape ``(n, 5)``."""
        return np.asarray(np.einsum("nm,nma->na", self.tensions, self.lengthening))


def ligament_tensions(
    lines: LineLigaments, flexion: Array, poses: Array, stiffness: Array, reference_strain: Array
) -> LigamentTensions:
    """Tensions and strains of the ligaments at poses of the tibia.

    Parameters
    ----------
    lines
        Insertions and reference lengths of the m ligaments.
    flexion
        Flexion of each pose [rad], shape ``(n,)``.
    poses
        Varus, internal [rad], x, y, z [mm] of each, shape ``(n, 5)``.
    stiffness
        [N per unit strain], shape ``(m,)``.
    reference_strain
        Strain at the reference length [-], shape ``(m,)``.
    """
    length, lengthening = _lengths(lines, flexion, poses)
    slack_length = lines.reference_length / (1.0 + reference_strain)
    # Evaluated at unit stiffness, because the derivative by a stiffness of zero is needed as well.
    strain = length / slack_length - 1.0
    per_stiffness, slope = line_tensions(strain, np.ones(len(stiffness)), lines.transition)
    return LigamentTensions(
        tensions=stiffness * per_stiffness,
        lengthening=lengthening,
        by_pose=(stiffness * slope / slack_length)[:, :, None] * lengthening,
        by_stiffness=per_stiffness,
        by_strain=stiffness * slope * length / lines.reference_length,
        strains=strain,
        strains_by_pose=lengthening / slack_length[:, None],
        strains_by_strain=length / lines.reference_length,
    )


def line_gradients(
    lines: LineLigaments, flexion: Array, poses: Array, stiffness: Array, reference_strain: Array
) -> Array:
    """Gradient of each line's energy by the pose [N mm, N], shape ``(n, m, 5)``.

    Parameters are those of `ligament_tensions`.
    """
    length, lengthening = _lengths(lines, flexion, poses)
    slack_length = lines.reference_length / (1.0 + reference_strain)
    tensions, _ = line_tensions(length / slack_length - 1.0, stiffness, lines.transition)
    return np.asarray(tensions[:, :, None] * lengthening)


def line_lengths(lines: LineLigaments, flexion: float, pose: Array) -> Array:
    """Lengths of the lines [mm], shape ``(m,)``, at `flexion` [rad] and a `pose` (5,)."""
    return _lengths(lines, np.array([flexion]), pose[None])[0].reshape(-1)


# Angle between the corners of a drawn arc [rad].
ARC_STEP = 0.1


def line_courses(lines: LineLigaments, placement: Placement) -> tuple[Array, ...]:
    """The way of each line from femur to tibia as corners in femoral axes [mm], ``(k, 3)`` each."""
    ends = zip(lines.femoral, placement.to_femur(lines.tibial), strict=True)
    offset, share = np.asarray(lines.wrap_offset), np.asarray(lines.wrap_place)
    centres, axes = np.array(lines.obstacle_centre), np.array(lines.obstacle_axis)
    tibial = lines.with_obstacles_of(1)
    centres[tibial] = placement.to_femur(centres[tibial])
    axes[tibial] = axes[tibial] @ placement.rotation.T
    courses = []
    for i, (start, end) in enumerate(ends):
        between = np.zeros((0, 3))
        radius = float(np.asarray(lines.obstacle_radius)[i])
        if radius > 0.0:
            between = arc_of_way(start, end, centres[i], axes[i], radius)
        elif offset[i] != 0.0:
            between = (end + share[i] * (start - end) + [0.0, 0.0, offset[i]])[None]
        courses.append(np.vstack([start, between, end]))
    return tuple(courses)


def arc_of_way(start: Array, end: Array, centre: Array, axis: Array, radius: float) -> Array:
    """Corners of the way where it touches a cylinder or sphere, shape ``(k, 3)``; none elsewhere.

    Parameters
    ----------
    start, end
        Where the way begins and ends [mm].
    centre, axis, radius
        As in `LineLigaments`.
    """
    along = np.array([(x - centre) @ axis for x in (start, end)])
    off = np.array([start, end]) - centre - along[:, None] * axis
    far = np.linalg.norm(off, axis=1)
    across = axis if axis.any() else np.cross(*off)
    across = across / max(float(np.linalg.norm(across)), 1e-12)
    angle = float(np.arctan2(np.cross(*off) @ across, off[0] @ off[1]))
    angle += 2.0 * np.pi if angle < -0.5 * np.pi else 0.0
    tangents = np.sqrt(np.maximum(far**2 - radius**2, 0.0))
    first, last = np.arctan2(tangents, radius)
    arc = angle - first - last
    if arc <= 0.0 or far[0] == 0.0:
        return np.zeros((0, 3))
    turned = np.linspace(first, first + arc, 2 + int(arc / ARC_STEP))
    out = off[0] / far[0]
    circle = np.outer(np.cos(turned), out) + np.outer(np.sin(turned), np.cross(across, out))
    # On the unrolled cylinder the way is a straight line.
    walked = tangents[0] + radius * (turned - first)
    rise = along[0] + (along[1] - along[0]) * walked / (tangents.sum() + radius * arc)
    return np.asarray(centre + radius * circle + rise[:, None] * axis)


def _lengths(lines: LineLigaments, flexion: Array, poses: Array) -> tuple[Array, Array]:
    """Lengths [mm], (n, m), and their derivatives by the poses [mm/rad, mm/mm], (n, m, 5)."""
    offset, tibial, turned_z = _offsets(lines, flexion, poses)
    length, (x, y, z) = _course(lines, offset)
    sin, cos = np.sin(poses[:, :1]), np.cos(poses[:, :1])
    by_varus = tibial[1] * z - tibial[2] * y
    by_internal = turned_z * x + tibial[0] * (sin * y - cos * z)
    lengthening = np.stack([by_varus, by_internal, x, y, z], axis=2)
    which = wrapped_lines(lines)
    if which.size:
        around = _courses_around(lines.take(which), flexion, poses)
        pulls = np.concatenate([around.forces, np.cross(around.points, around.forces)], axis=2)
        length[:, which] = around.lengths
        lengthening[:, which] = -pulls @ twists_by_pose(poses)
    return length, lengthening


def wrapped_lines(lines: LineLigaments) -> IntArray:
    """Which lines have an obstacle that they may wrap around."""
    return np.flatnonzero(np.asarray(lines.obstacle_radius) > 0.0)


@declared
class _Courses:
    """Lines around obstacles at poses, in tibial axes, each under a tension of 1 N."""

    lengths: Array = array("Lengths", "pose", "line", unit="mm")
    points: Array = array("Points of the tibia at which they pull", "pose", "line", "3", unit="mm")
    forces: Array = array("Their forces on the tibia", "pose", "line", "3")
    by_twist: Array = array(
        "Derivatives of the forces by a twist of the tibia", "pose", "line", "3", "6"
    )
    points_by_twist: Array = array("Those of the points", "pose", "line", "3", "6")


def _courses_around(lines: LineLigaments, flexion: Array, poses: Array) -> _Courses:
    # The compiler takes half a second to load.
    from identknee.mechanics.obstacles import write_shapes

    none = np.zeros(len(lines.femoral))
    rotations = np.moveaxis(rotation_matrix(flexion, poses[:, 0], poses[:, 1]), 2, 0)
    turned = np.moveaxis(rotation_matrix(flexion, 0.0 * flexion, 0.0 * flexion), 2, 0)
    origins = (turned @ poses[:, 2:, None])[..., 0]
    shapes = np.zeros((len(poses), len(none), 13))
    rows = np.ascontiguousarray(rotations.reshape(-1, 9))
    write_shapes(lines.arrays(none, none), rows, origins, record(COURSE), shapes)
    femoral, gradient = shapes[:, :, :3], shapes[:, :, 4:7]
    hessian = shapes[:, :, [7, 10, 11, 10, 8, 12, 11, 12, 9]].reshape(*shapes.shape[:2], 3, 3)
    is_tibial = np.asarray(lines.obstacle_is_tibial)[:, None] != 0.0
    points = np.where(is_tibial, femoral, lines.tibial)
    forces = np.where(is_tibial, gradient, -gradient)
    # A twist moves the tibia along its axes and about them; the femoral end is left behind.
    moved = np.concatenate([np.broadcast_to(np.eye(3), hessian.shape), -_crosses(points)], axis=3)
    by_twist = -hessian @ moved
    by_twist[..., 3:] += np.where(is_tibial[..., None], 0.0, _crosses(forces))
    return _Courses(
        lengths=shapes[:, :, 3],
        points=points,
        forces=forces,
        by_twist=by_twist,
        points_by_twist=np.where(is_tibial[..., None], -moved, 0.0),
    )


def _course(lines: LineLigaments, offset: Array) -> tuple[Array, Array]:
    """Length of each line and its gradient by `offset` (3, n, m), with its push aside."""
    place, offset_z = np.asarray(lines.wrap_place), np.asarray(lines.wrap_offset)
    if not offset_z.any():
        length = np.sqrt((offset**2).sum(axis=0))
        return length, offset / length
    length, direction = np.zeros(offset.shape[1:]), np.zeros(offset.shape)
    for share, aside in ((place, -offset_z), (1.0 - place, offset_z)):
        part = share * offset
        part[2] += aside
        size = np.sqrt((part**2).sum(axis=0))
        length += size
        direction += share * part / size
    return length, direction


def _offsets(lines: LineLigaments, flexion: Array, poses: Array) -> tuple[Array, Array, Array]:
    """From femoral to tibial insertions [mm], (3, n, m), the latter, and their z before varus.

    In femoral axes turned with flexion, where the translation of a pose stands as it is; tibial
    insertions are turned and not shifted.
    """
    ca, sa = np.cos(flexion)[:, None], np.sin(flexion)[:, None]
    cv, sv = np.cos(poses[:, :1]), np.sin(poses[:, :1])
    ci, si = np.cos(poses[:, 1:2]), np.sin(poses[:, 1:2])
    x, y, z = lines.tibial.T
    turned_z = ci * z - si * x
    tibial = np.stack([ci * x + si * z, cv * y - sv * turned_z, sv * y + cv * turned_z])
    x, y, z = lines.femoral.T
    offset = tibial + poses[:, 2:].T[:, :, None]
    offset[0] -= ca * x - sa * y
    offset[1] -= sa * x + ca * y
    offset[2] -= z
    return offset, tibial, turned_z


NM_PER_NMM = 1e-3
# A wrench with moments in N m, divided by these, has them in N mm: it is then work per mm or rad.
WORK = np.array([1.0, 1.0, 1.0, NM_PER_NMM, NM_PER_NMM, NM_PER_NMM])


@declared
class LineWrenches:
    """Force of lines on the tibia in tibial axes, and its moment about the tibial origin.

    A twist is a small motion of the tibia: shifts along its axes [mm], then turns about them
    through its origin [rad].
    """

    values: Array = array("Force and moment", "pose", "line", "6", unit="N and N m")
    by_twist: Array = array(
        "Their derivatives by a twist of the tibia",
        *("pose", "line", "6", "6"),
        unit="N and N m per mm or rad",
    )
    by_stiffness: Array = array(
        "Their derivatives by the stiffness of the line", "pose", "line", "6"
    )
    by_strain: Array = array(
        "Their derivatives by the reference strain of the line",
        *("pose", "line", "6"),
        unit="N and N m",
    )


def line_wrenches(
    lines: LineLigaments, flexion: Array, poses: Array, stiffness: Array, reference_strain: Array
) -> LineWrenches:
    """Wrenches of the lines at poses of the tibia.

    Parameters
    ----------
    lines
        Insertions and reference lengths of the m lines.
    flexion
        Flexion of each pose [rad], shape ``(n,)``.
    poses
        Varus, internal [rad], x, y, z [mm] of each, shape ``(n, 5)``.
    stiffness
        [N per unit strain], shape ``(m,)``.
    reference_strain
        Strain at the reference length [-], shape ``(m,)``.
    """
    length, pull, pull_by_twist = _pulls(lines, flexion, poses)
    which = wrapped_lines(lines)
    if which.size:
        around = _courses_around(lines.take(which), flexion, poses)
        length[:, which] = around.lengths
        pull[:, which] = _with_moments(around.points, around.forces)
        pull_by_twist[:, which] = np.concatenate(
            [
                around.by_twist,
                NM_PER_NMM * _crosses(around.points) @ around.by_twist
                - NM_PER_NMM * _crosses(around.forces) @ around.points_by_twist,
            ],
            axis=2,
        )
    slack_length = lines.reference_length / (1.0 + reference_strain)
    per_stiffness, slope = line_tensions(
        length / slack_length - 1.0, np.ones(len(stiffness)), lines.transition
    )
    tension, slope = stiffness * per_stiffness, stiffness * slope
    # By virtual work the derivative of the length by a twist is minus the wrench of 1 N.
    pulled = -(slope / slack_length)[:, :, None] * pull / WORK
    by_strain = slope * length / lines.reference_length
    return LineWrenches(
        values=tension[..., None] * pull,
        by_twist=pull[..., None] * pulled[:, :, None] + tension[..., None, None] * pull_by_twist,
        by_stiffness=per_stiffness[..., None] * pull,
        by_strain=by_strain[..., None] * pull,
    )


def _pulls(lines: LineLigaments, flexion: Array, poses: Array) -> tuple[Array, Array, Array]:
    """Lengths of lines without obstacles (n, m), wrenches of 1 N, and these by a twist.

    The wrenches have the shape ``(n, m, 6)``, their derivatives ``(n, m, 6, 6)``.
    """
    offset, aside = _in_tibial_axes(lines, flexion, poses, _rotations(poses))
    share = np.asarray(lines.wrap_place)[:, None]
    length, force = np.zeros(offset.shape[:2]), np.zeros(offset.shape)
    offset_by_twist = np.concatenate(
        [np.broadcast_to(np.eye(3), (*offset.shape, 3)), -_crosses(lines.tibial - offset)], axis=3
    )
    aside_by_twist = np.concatenate([np.zeros((*offset.shape, 3)), _crosses(aside)], axis=3)
    by_twist = np.zeros(offset_by_twist.shape)
    for part, sign in ((share, -1.0), (1.0 - share, 1.0)):
        course = part * offset + sign * aside
        size = np.linalg.norm(course, axis=2, keepdims=True)
        direction = course / size
        length, force = length + size[:, :, 0], force - part * direction
        across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
        course_by_twist = part[..., None] * offset_by_twist + sign * aside_by_twist
        by_twist -= part[..., None] * (across / size[..., None] @ course_by_twist)
    turned = np.swapaxes(_with_moments(lines.tibial, np.swapaxes(by_twist, 2, 3)), 2, 3)
    return length, _with_moments(lines.tibial, force), turned


def twists_by_pose(poses: Array) -> Array:
    """The twist of the tibia [mm, rad] for each coordinate of poses (n, 5), ``(n, 6, 5)``."""
    rotation = _rotations(poses)
    twists = np.zeros((len(poses), 6, 5))
    # A shift along an axis of the femur, and a turn about it, are seen along the tibia's.
    twists[:, :3, 2:] = np.swapaxes(rotation, 1, 2)
    twists[:, 3:, 0] = rotation[:, 0]
    twists[:, 4, 1] = 1.0
    return twists


def _rotations(poses: Array) -> Array:
    return np.moveaxis(rotation_matrix(0.0 * poses[:, 0], poses[:, 0], poses[:, 1]), 2, 0)


def _in_tibial_axes(
    lines: LineLigaments, flexion: Array, poses: Array, rotation: Array
) -> tuple[Array, Array]:
    """From femoral to tibial insertions, and how far lines are pushed aside, ``(n, m, 3)`` each."""
    cos, sin = np.cos(flexion)[:, None], np.sin(flexion)[:, None]
    x, y, z = lines.femoral.T
    femoral = np.stack([cos * x - sin * y, sin * x + cos * y, z + 0.0 * cos], axis=2)
    offset = lines.tibial + (poses[:, None, 2:] - femoral) @ rotation
    return offset, np.asarray(lines.wrap_offset)[:, None] * rotation[:, None, 2]


def _crosses(vectors: Array) -> Array:
    """The matrices (..., 3, 3) that take the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros(x.shape)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _with_moments(points: Array, forces: Array) -> Array:
    """Forces (n, m, ..., 3) at points (..., m, 3) of the tibia, and moments about its origin."""
    arms = points if points.ndim > 2 else points[None]
    arms = arms.reshape(*arms.shape[:2], *(1,) * (forces.ndim - 3), 3)
    return np.concatenate([forces, NM_PER_NMM * np.cross(arms, forces)], axis=-1)
