"""Lines around cylinders and spheres: lengths by other means, and derivatives by differences."""

import numpy as np
import pytest
from energy_evaluation import SCALE, Evaluator
from tolerances import DIFFERENCE

from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.ligament_tensions import ligament_tensions, line_wrenches, twists_by_pose
from identknee.mechanics.obstacles import LENGTH_ERROR, wrapped_shape
from identknee.mechanics.pose import place
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

CENTRE = np.array([1.0, -2.0, 0.5])
AXIS = np.array([0.6, 0.0, 0.8])
RADIUS = 8.0
NO_AXIS = np.zeros(3)


def shape_of(start: Array, end: Array, axis: Array, turn: float = 1.0) -> tuple[bool, Array]:
    shape = np.zeros(10)
    touches = wrapped_shape(start, end, CENTRE, axis, turn, RADIUS, shape)
    return bool(touches), shape


def around(angle: float, distance: float, along: float) -> Array:
    """A place at an angle about the axis, so far from it and along it."""
    across = np.array([0.0, 1.0, 0.0])
    other = np.cross(AXIS, across)
    out = np.cos(angle) * across + np.sin(angle) * other
    return np.asarray(CENTRE + distance * out + along * AXIS)


def pulled_tight(start: Array, end: Array, axis: Array, n: int = 40) -> float:
    """Length of a chain of points that is pulled tight and pushed out of the obstacle in turn."""

    def from_axis(points: Array) -> Array:
        apart = points - CENTRE
        return np.asarray(apart - (apart @ axis)[:, None] * axis)

    out = from_axis(0.5 * (start + end)[None])[0]
    share = np.linspace(0.0, 1.0, n + 2)[:, None]
    chain = (1.0 - share) * start + share * end
    chain += 2.0 * RADIUS * np.sin(np.pi * share) * out / np.linalg.norm(out)
    for _ in range(3000):
        chain[1:-1] = 0.25 * chain[:-2] + 0.5 * chain[1:-1] + 0.25 * chain[2:]
        apart = from_axis(chain)
        distance = np.linalg.norm(apart, axis=1)
        inside = distance < RADIUS
        chain[inside] += (RADIUS / distance[inside] - 1.0)[:, None] * apart[inside]
    return float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())


@pytest.mark.parametrize("axis", [AXIS, NO_AXIS], ids=["cylinder", "sphere"])
def test_the_way_is_the_shortest_one(axis: Array) -> None:
    start, end = around(0.0, 14.0, -6.0), around(2.4, 11.0, 5.0)
    touches, shape = shape_of(start, end, axis)
    assert touches
    assert shape[0] > np.linalg.norm(end - start) + 0.5
    assert shape[0] == pytest.approx(pulled_tight(start, end, axis), abs=0.02)


def test_a_way_of_known_length() -> None:
    """Tangents of 6 and 15, an arc of 1.2 rad, and a rise of 7 beside all of it."""
    angle = 1.2 + np.arctan2(6.0, RADIUS) + np.arctan2(15.0, RADIUS)
    _, shape = shape_of(around(0.3, 10.0, -3.0), around(0.3 + angle, 17.0, 4.0), AXIS)
    assert shape[0] == pytest.approx(np.hypot(6.0 + 15.0 + 1.2 * RADIUS, 7.0), rel=1e-12)
    # Against the axis the same way is the other side's.
    _, other = shape_of(around(0.3 + angle, 10.0, -3.0), around(0.3, 17.0, 4.0), AXIS, -1.0)
    assert other[0] == pytest.approx(shape[0], rel=1e-12)


@pytest.mark.parametrize("axis", [AXIS, NO_AXIS], ids=["cylinder", "sphere"])
def test_a_line_beside_the_obstacle_is_straight(axis: Array) -> None:
    start, end = around(0.0, 14.0, -6.0), around(0.9, 13.0, 5.0)
    touches, shape = shape_of(start, end, axis)
    assert not touches
    assert shape[0] == pytest.approx(np.linalg.norm(end - start), rel=1e-14)
    # On the free side of a cylinder it never touches.
    assert not shape_of(around(0.0, 14.0, 0.0), around(-1.5, 9.0, 0.0), AXIS)[0]


@pytest.mark.parametrize("axis", [AXIS, NO_AXIS], ids=["cylinder", "sphere"])
def test_touch_is_smooth_and_hardly_changes_the_length(axis: Array) -> None:
    """Slopes and bends by differences from before the touch to well after it."""
    start, errors = around(0.0, 14.0, 0.0), []
    touching = np.arccos(RADIUS / 14.0) + np.arccos(RADIUS / 12.0)
    size = 1e-5
    for angle in touching + np.r_[np.linspace(-0.01, 0.04, 25), 0.3]:
        end = around(angle, 12.0, 0.0)
        found = shape_of(start, end, axis)[1]
        ends = [
            (shape_of(start, end + size * x, axis)[1], shape_of(start, end - size * x, axis)[1])
            for x in np.eye(3)
        ]
        slope = [(more[0] - less[0]) / (2.0 * size) for more, less in ends]
        bend = [(more[1:4] - less[1:4]) / (2.0 * size) for more, less in ends]
        xx, yy, zz, xy, xz, yz = found[4:]
        np.testing.assert_allclose(found[1:4], slope, atol=1e-8)
        np.testing.assert_allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], bend, atol=3e-5)
        arc = max(angle - touching, 0.0)
        tangents = np.sqrt(14.0**2 - RADIUS**2) + np.sqrt(12.0**2 - RADIUS**2)
        exact = tangents + RADIUS * arc if arc > 0.0 else np.linalg.norm(end - start)
        errors.append(abs(found[0] - exact))
    assert 0.05 * LENGTH_ERROR < max(errors) < LENGTH_ERROR


def test_an_end_inside_counts_as_on_the_surface() -> None:
    start = around(0.0, 14.0, 0.0)
    before = np.sqrt(14.0**2 - RADIUS**2)
    _, shape = shape_of(start, around(2.5, 0.6 * RADIUS, 0.0), AXIS)
    arc = 2.5 - np.arccos(RADIUS / 14.0)
    assert shape[0] == pytest.approx(before + RADIUS * arc, abs=0.05)
    assert np.isfinite(shape).all()


LINES = LineLigaments(
    femoral=np.array([[0.0, 20.0, 25.0], [4.0, 22.0, -26.0], [0.0, 18.0, 8.0], [-3.0, 16.0, -9.0]]),
    tibial=np.array([[3.0, -42.0, 26.0], [2.0, -55.0, -24.0], [5.0, -12.0, 6.0], [-8.0, -13, 1]]),
    reference_length=np.array([60.0, 75.0, 31.0, 30.0]),
    obstacle_radius=np.array([9.0, 14.0, 9.0, 0.0]),
    obstacle_is_tibial=np.array([0.0, 1.0, 1.0, 0.0]),
    obstacle_centre=np.array([[1.0, 2.0, 20.0], [0.0, -8.0, -14.0], [3.0, 6.0, 5.0], NO_AXIS]),
    obstacle_axis=np.array([[-1.0, 0.0, 0.0], [0.96, 0.0, 0.28], NO_AXIS, NO_AXIS]),
)  # fmt: skip
IS_TIBIAL = np.asarray(LINES.obstacle_is_tibial)
LAWS = np.array([6e3, 9e3, 4e3, 5e3]), np.array([0.02, 0.05, 0.08, 0.03])
FLEXION = np.radians([12.0, 55.0])
POSES = np.array([[0.05, -0.1, 1.0, -2.0, 3.0], [-0.04, 0.2, -2.0, -3.0, 1.0]])


def test_these_lines_wrap() -> None:
    """Else the tests below would say nothing."""
    straight = LineLigaments(
        femoral=LINES.femoral, tibial=LINES.tibial, reference_length=LINES.reference_length
    )
    longer = [
        ligament_tensions(x, FLEXION, POSES, *LAWS).strains * LINES.reference_length
        for x in (LINES, straight)
    ]
    assert ((longer[0] - longer[1])[0, :3] > 0.1).all()
    np.testing.assert_allclose(longer[0][:, 3], longer[1][:, 3], atol=1e-12)


@pytest.mark.parametrize("case", [0, 1])
def test_energy_of_a_pose_has_the_derivatives_of_its_differences(
    case: int, reference_model: LaxityModel
) -> None:
    """Gradient, Hessian and slope by flexion, obstacles of both bones."""
    evaluate, ligaments = Evaluator(reference_model.joint), LINES.arrays(*LAWS)
    # Far apart, so that contact adds nothing.
    pose, flexion = POSES[case] - [0.0, 0.0, 0.0, 30.0, 0.0], float(FLEXION[case])
    found, size = evaluate(flexion, pose, ligaments), 1e-5
    assert not found.touching
    both = SCALE[:, None] * SCALE
    for k in range(5):
        move = size / SCALE[k] * np.eye(5)[k]
        more, less = (evaluate(flexion, pose + s * move, ligaments) for s in (1.0, -1.0))
        slope = (more.energy - less.energy) / (2.0 * size)
        assert found.gradient[k] / SCALE[k] == pytest.approx(slope, rel=1e-6, abs=1e-4)
        bend = (more.gradient - less.gradient) / (2.0 * size) / SCALE
        wanted = (found.hessian / both)[:, k]
        np.testing.assert_allclose(wanted, bend, atol=1e-6 * np.abs(found.hessian / both).max())
    more, less = (evaluate(flexion + s * size, pose, ligaments) for s in (1.0, -1.0))
    by_flexion = (more.gradient - less.gradient) / (2.0 * size)
    np.testing.assert_allclose(
        found.flexion_slope / SCALE, by_flexion / SCALE,
        atol=DIFFERENCE * np.abs(by_flexion / SCALE).max(),
    )  # fmt: skip
    own = ligament_tensions(LINES, FLEXION[case : case + 1], pose[None], *LAWS).gradient[0]
    np.testing.assert_allclose(own / SCALE, found.gradient / SCALE, rtol=1e-10, atol=1e-8)


def test_a_mirrored_pair_shows_that_the_obstacles_bone_is_a_matter_of_view() -> None:
    """An obstacle of the femur, held still beside the tibia, has the length of the tibia's own."""
    placed = place(float(FLEXION[0]), POSES[0])
    seen = LineLigaments(
        femoral=LINES.femoral,
        tibial=LINES.tibial,
        reference_length=LINES.reference_length,
        obstacle_radius=LINES.obstacle_radius,
        obstacle_is_tibial=1.0 - IS_TIBIAL,
        obstacle_centre=np.array(
            [
                (placed.to_femur if tibial else placed.to_tibia)(x[None])[0]
                for x, tibial in zip(np.asarray(LINES.obstacle_centre), IS_TIBIAL, strict=True)
            ]
        ),
        obstacle_axis=np.array(
            [
                (placed.rotation if tibial else placed.rotation.T) @ x
                for x, tibial in zip(np.asarray(LINES.obstacle_axis), IS_TIBIAL, strict=True)
            ]
        ),
    )
    found = [ligament_tensions(x, FLEXION[:1], POSES[:1], *LAWS) for x in (LINES, seen)]
    np.testing.assert_allclose(found[0].strains, found[1].strains, atol=1e-12)


def test_wrenches_do_the_work_and_have_the_slopes_of_their_differences() -> None:
    found = line_wrenches(LINES, FLEXION, POSES, *LAWS)
    pulled = ligament_tensions(LINES, FLEXION, POSES, *LAWS)
    work = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3]) * found.values
    by_pose = np.einsum("nmi,nij->nmj", work, twists_by_pose(POSES))
    expected = -pulled.tensions[..., None] * pulled.lengthening
    np.testing.assert_allclose(by_pose, expected, rtol=1e-9, atol=1e-7)
    by_pose = np.einsum("nmij,njk->nmik", found.by_twist, twists_by_pose(POSES))
    for k in range(5):
        move = 1e-6 * np.eye(5)[k]
        ends = [line_wrenches(LINES, FLEXION, POSES + s * move, *LAWS).values for s in (-1, 1)]
        slope = (ends[1] - ends[0]) / 2e-6
        np.testing.assert_allclose(by_pose[..., k], slope, atol=1e-6 * np.abs(slope).max())
