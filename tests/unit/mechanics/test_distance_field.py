"""The distance spline: what it holds, and that its masks hide nothing."""

import numpy as np
import pytest
from energy_evaluation import field_values

from identknee.mechanics.distance_field import MOST_ROUNDING, PADDING, DistanceField, build_field
from identknee.mechanics.memory import FIRST_ROUNDED
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array, BoolArray, IntArray

RADIUS = 10.0
# A cubic spline through a sphere's distance on a 0.75 mm grid, from 3 mm inside to 1 mm outside.
SPHERE_MM = 2e-5


def _sphere(points: Array) -> Array:
    return np.asarray(np.linalg.norm(points, axis=1)) - RADIUS


@pytest.fixture(scope="module")
def ball() -> DistanceField:
    return build_field(_sphere, np.full(3, -RADIUS), np.full(3, RADIUS))


def _shell(n: int, seed: int) -> Array:
    """Points from 3 mm inside the sphere to 1 mm outside."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return direction * rng.uniform(RADIUS - 3.0, RADIUS + 1.0, (n, 1))


def test_the_grid_has_room_around_the_surface(ball: DistanceField) -> None:
    room = PADDING * ball.spacing
    last = ball.origin + ball.spacing * (np.array(ball.coefficients.shape) - 1)
    assert (ball.origin <= -RADIUS - room + 1e-9).all()
    assert (last >= RADIUS + room - 1e-9).all()
    assert not ball.coefficients.flags.writeable
    assert not ball.reach.flags.writeable


def test_it_is_the_distance_to_a_sphere(ball: DistanceField) -> None:
    points = _shell(2000, seed=0)
    error = np.abs(field_values(ball, points) - _sphere(points))
    assert error.max() < SPHERE_MM


def test_it_reproduces_a_plane_up_to_the_faces() -> None:
    normal = np.array([0.6, 0.0, 0.8])
    field = build_field(lambda p: p @ normal - 0.3, np.full(3, -4.0), np.full(3, 4.0))
    points = np.random.default_rng(1).uniform(-4.0, 4.0, (200, 3))
    # What is left of the mirror beyond the straight part decays by 0.27 a node; 13 are between.
    assert field_values(field, points) == pytest.approx(points @ normal - 0.3, abs=1e-6)


def test_its_gradient_is_a_unit_vector(ball: DistanceField) -> None:
    points = _shell(500, seed=2)
    step = 1e-4
    slopes = [
        (field_values(ball, points + move) - field_values(ball, points - move)) / (2 * step)
        for move in step * np.eye(3)
    ]
    assert np.linalg.norm(slopes, axis=0) == pytest.approx(np.ones(500), abs=1e-3)


def _cells(field: DistanceField, n: int, seed: int, near: float) -> tuple[IntArray, Array]:
    """Random places in cells close to contact: cell numbers and places in grid units."""
    rng = np.random.default_rng(seed)
    inner = field.coefficients[1:-2, 1:-2, 1:-2]
    chosen = np.argwhere(np.abs(inner) < near) + 1
    cells = chosen[rng.integers(0, len(chosen), n)]
    return cells, cells + rng.random((n, 3))


# Gap below which contact begins, and the first of the bits that say where it may.
GAPS = {0.0: 0, MOST_ROUNDING: FIRST_ROUNDED}


def _bits(field: DistanceField, cells: IntArray, places: Array, gap: float) -> IntArray:
    half = np.floor(2.0 * (places - cells)).astype(int)
    eighth = GAPS[gap] + 4 * half[:, 0] + 2 * half[:, 1] + half[:, 2]
    return np.asarray(field.reach[tuple(cells.T)].astype(int) >> eighth & 1)


def _near(field: DistanceField) -> BoolArray:
    bits = np.unpackbits(field.near, axis=2, bitorder="little", count=field.reach.shape[2])
    return np.asarray(bits == 1)


@pytest.mark.parametrize("gap", GAPS)
def test_no_place_that_may_bear_hides(
    reference_model: LaxityModel, ball: DistanceField, gap: float
) -> None:
    for field in (reference_model.joint.field, ball):
        cells, places = _cells(field, 40000, seed=3, near=2.0)
        values = field_values(field, field.origin + field.spacing * places)
        shown = _bits(field, cells, places, gap)
        assert (values < gap).sum() > 5000
        assert (shown[values < gap] == 1).all()


@pytest.mark.parametrize("gap", GAPS)
def test_far_places_are_hidden(reference_model: LaxityModel, gap: float) -> None:
    """Hiding is what makes it fast: little more than half a cell around the surface is shown."""
    field = reference_model.joint.field
    cells, places = _cells(field, 40000, seed=4, near=3.0)
    values = field_values(field, field.origin + field.spacing * places)
    outside = values > 0.6 + gap
    assert outside.sum() > 5000
    assert _bits(field, cells, places, gap)[outside].mean() < 0.01


@pytest.mark.parametrize("gap", GAPS)
def test_rough_fields_hide_nothing_either(gap: float) -> None:
    """Coefficients at random, where the hull is all that can be trusted."""
    rng = np.random.default_rng(5)
    field = build_field(
        lambda p: rng.normal(0.6, 1.0, len(p)), np.full(3, -4.0), np.full(3, 4.0), spacing=0.8
    )
    cells, places = _cells(field, 40000, seed=6, near=np.inf)
    values = field_values(field, field.origin + field.spacing * places)
    assert (values < gap).sum() > 5000
    assert (_bits(field, cells, places, gap)[values < gap] == 1).all()


def test_neighbours_of_contact_are_near(ball: DistanceField) -> None:
    holds, near = ball.reach > 0, _near(ball)
    assert near.mean() < 0.5
    for move in np.ndindex(3, 3, 3):
        shifted = np.roll(holds, np.array(move) - 1, axis=(0, 1, 2))
        inner = (slice(2, -3),) * 3
        assert near[inner][shifted[inner]].all()


def test_the_outermost_cells_hold_nothing() -> None:
    """There the spline lacks support, even inside a surface that fills the grid."""
    field = build_field(lambda p: np.full(len(p), -1.0), np.zeros(3), np.full(3, 5.0))
    inner = (slice(1, -2),) * 3
    for values, full in ((field.reach.copy(), 2**16 - 1), (_near(field), True)):
        assert (values[inner] == full).all()
        values[inner] = 0
        assert not values.any()
