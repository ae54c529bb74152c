import numpy as np
import pytest

from identknee.subject.reference import Plateau

PLATEAU = Plateau(
    centre_x=1.0,
    centre_z=-15.0,
    height=-24.0,
    slope=6.0,
    tilt=-3.0,
    curvature_x=0.01,
    curvature_z=0.004,
    eminence_height=5.0,
    eminence_x=3.0,
    eminence_z=-4.0,
    eminence_width_x=6.0,
    eminence_width_z=5.0,
    half_length=18.0,
    half_width=14.0,
    exponent=2.5,
)


def test_vertices_lie_on_the_height_field_within_the_outline() -> None:
    x, y, z = PLATEAU.mesh(1.5).vertices.T
    np.testing.assert_allclose(y, PLATEAU.heights(x, z), atol=1e-12)
    reach = np.abs((x - 1.0) / 18.0) ** 2.5 + np.abs((z + 15.0) / 14.0) ** 2.5
    assert reach.max() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("edge", [20.0, 10.0, 3.0])
def test_rings_make_one_sheet_that_looks_up(edge: float) -> None:
    mesh = PLATEAU.mesh(edge)
    rings = int(np.ceil(18.0 / edge))
    assert len(mesh.vertices) == 1 + 3 * rings * (rings + 1)
    assert len(mesh.faces) == 6 * rings**2
    assert len(mesh.boundary_edges) == 6 * rings
    assert (mesh.normals[:, 1] > 0.0).all()
    # One sheet without holes: vertices - edges + triangles = 1.
    n_edges = len(np.unique(np.sort(mesh.edges, axis=1), axis=0))
    assert len(mesh.vertices) - n_edges + len(mesh.faces) == 1


def test_posterior_slope_lowers_the_rear() -> None:
    flat = PLATEAU.heights(np.array([-10.0, 12.0]), np.array([-40.0, -40.0]))
    assert flat[0] < flat[1]


def test_area_converges_with_the_square_of_the_edge() -> None:
    area = [PLATEAU.mesh(edge).areas.sum() for edge in (4.5, 2.25, 1.125)]
    order = np.log2((area[1] - area[0]) / (area[2] - area[1]))
    assert order == pytest.approx(2.0, abs=0.3)
