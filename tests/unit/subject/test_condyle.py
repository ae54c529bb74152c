import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from identknee.runs.declare import Array
from identknee.subject.reference import Condyle

SURFACE = 1e-9  # mm; how exact the distance is to be near the surface
CONDYLE = Condyle(
    distal_radius=38.0,
    posterior_radius=20.0,
    transition_centre=30.0,
    transition_half_width=20.0,
    tube_radius=16.0,
    spine_x=-5.0,
    spine_y=1.0,
    spine_z=-20.0,
    divergence=-1.5,
    first_angle=-55.0,
    last_angle=125.0,
    half_aperture=70.0,
)


def test_spine_derivatives_equal_differences() -> None:
    psi = np.linspace(-0.9, 2.1, 41)
    step = 1e-5
    before, _, _ = CONDYLE.spine(psi - step)
    after, _, _ = CONDYLE.spine(psi + step)
    _, first, _ = CONDYLE.spine(psi)
    # Differences of step 1e-5 are right to about 1e-9 times the third derivative.
    np.testing.assert_allclose((after - before) / (2 * step), first, atol=1e-7)
    _, before, _ = CONDYLE.spine(psi - step)
    _, after, _ = CONDYLE.spine(psi + step)
    np.testing.assert_allclose((after - before) / (2 * step), CONDYLE.spine(psi)[2], atol=1e-5)


def test_spine_passes_its_rear_point() -> None:
    place = CONDYLE.spine(np.array([np.pi / 2]))[0][:, 0]
    np.testing.assert_allclose(place, [-5.0, 1.0, -21.5], atol=1e-12)


@pytest.mark.parametrize(("degrees", "radius"), [(-30.0, 38.0), (100.0, 20.0), (30.0, 29.0)])
def test_sagittal_radius_of_curvature(degrees: float, radius: float) -> None:
    psi = np.radians(degrees) + np.array([-1e-4, 0.0, 1e-4])
    x, y, _ = CONDYLE.surface_points(psi, np.zeros(3)).T
    turned = np.radians(np.degrees(2e-4))
    arc = np.hypot(x[2] - x[0], y[2] - y[0])
    # The spine's small divergence tilts the ridge out of the sagittal plane.
    assert arc / turned == pytest.approx(radius, rel=5e-3)


def test_mesh_lies_on_the_surface_and_looks_out() -> None:
    mesh = CONDYLE.mesh(2.0)
    assert np.abs(CONDYLE.distance(mesh.vertices)).max() < SURFACE
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    assert (CONDYLE.distance(centres + 0.5 * mesh.normals) > 0.0).all()
    edges = np.linalg.norm(np.diff(mesh.vertices[mesh.edges], axis=1)[:, 0], axis=1)
    assert 1.0 < np.median(edges) < 2.5


def test_distance_is_the_least_over_the_spine() -> None:
    generator = np.random.default_rng(5)
    points = generator.uniform(-45.0, 45.0, size=(40, 3))
    psi = np.linspace(*CONDYLE.limits, 4001)
    for point, found in zip(points, CONDYLE.distance(points), strict=True):

        def to_spine(angle: float, point: Array = point) -> float:
            return float(np.linalg.norm(CONDYLE.spine(np.array([angle]))[0][:, 0] - point))

        i = int(np.argmin(np.linalg.norm(CONDYLE.spine(psi)[0].T - point, axis=1)))
        low, high = psi[max(i - 1, 0)], psi[min(i + 1, len(psi) - 1)]
        best = minimize_scalar(to_spine, bounds=(low, high), method="bounded").fun
        best = min(best, to_spine(low), to_spine(high)) - CONDYLE.tube_radius
        # The scalar minimiser finds the place to about 1e-5 rad, the distance to its square.
        assert found == pytest.approx(best, abs=1e-6)


def test_gradient_of_the_distance_is_one() -> None:
    generator = np.random.default_rng(6)
    mesh = CONDYLE.mesh(3.0)
    points = mesh.vertices + generator.normal(scale=1.0, size=mesh.vertices.shape)
    step = 1e-4
    gradient = np.stack(
        [
            (CONDYLE.distance(points + move) - CONDYLE.distance(points - move)) / (2 * step)
            for move in step * np.eye(3)
        ]
    )
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=0), 1.0, atol=1e-7)


def test_spheres_close_the_ends() -> None:
    """Beyond its ends the surface is the last sphere."""
    for psi, sign in zip(CONDYLE.limits, (-1.0, 1.0), strict=True):
        centre, tangent, _ = CONDYLE.spine(np.array([psi]))
        beyond = centre[:, 0] + sign * 3.0 * tangent[:, 0] / np.linalg.norm(tangent)
        found = CONDYLE.distance(beyond[None])[0]
        assert found == pytest.approx(3.0 - CONDYLE.tube_radius, abs=SURFACE)
