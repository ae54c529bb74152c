import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from identknee.report.figures import png
from identknee.report.scene import PIECES, scene, view_from
from identknee.runs.declare import Array
from identknee.subject.knee import Frame, Knee
from identknee.subject.ligament import Ligament
from identknee.subject.surface import Surface


def tiny_knee() -> Knee:
    def plate(y: float, side: float) -> Surface:
        corners = [[-10.0, y, side], [10.0, y, side], [0.0, y, side + 15.0]]
        return Surface(vertices=np.array(corners), faces=np.array([[0, 2, 1]]))

    frame = Frame(origin=np.zeros(3), axes=np.eye(3))
    line = Ligament(
        name="LCL",
        femur=np.array([0.0, 5.0, 30.0]),
        tibia=np.array([0.0, -40.0, 32.0]),
        stiffness_kN=6.0,
        reference_strain_pct=2.0,
    )
    return Knee(
        name="tiny",
        side="right",
        femur=plate(0.0, 10.0),
        tibia=(plate(-2.0, -25.0), plate(-2.0, 10.0)),
        ligaments=(line,),
        femur_frame=frame,
        tibia_frame=frame,
    )


def test_scene_draws_every_triangle_and_ligament() -> None:
    figure = scene(tiny_knee())
    polygons = next(x for x in figure.axes[0].collections if isinstance(x, PolyCollection))
    assert len(polygons.get_paths()) == 3 + PIECES
    assert {x.get_text() for x in figure.axes[0].texts} >= {"LCL", "anterior", "20 mm"}
    assert png(figure).startswith(b"\x89PNG")


def test_a_pose_moves_the_tibia_and_not_the_femur() -> None:
    still = scene(tiny_knee(), azimuth_deg=90.0, elevation_deg=0.0)
    moved = scene(tiny_knee(), [0.0, 0.0, 5.0, 0.0, 0.0], azimuth_deg=90.0, elevation_deg=0.0)
    boxes = [_triangles(figure) for figure in (still, moved)]
    # Seen from the lateral side anterior is to the right for a right knee.
    assert boxes[1] - boxes[0] == pytest.approx([0.0, 5.0, 5.0])


def _triangles(figure: Figure) -> Array:
    """Middle across the page of the femur's triangle and of the two tibial ones."""
    polygons = next(x for x in figure.axes[0].collections if isinstance(x, PolyCollection))
    corners = [np.asarray(p.vertices) for p in polygons.get_paths()]
    triangles = [x[:3] for x in corners if len(x) == 4]
    triangles.sort(key=lambda x: -x[:, 1].mean())
    return np.array([x[:, 0].mean() for x in triangles])


@pytest.mark.parametrize(
    ("azimuth", "right"),
    [(0.0, [0, 0, -1]), (90.0, [1, 0, 0]), (180.0, [0, 0, 1]), (270.0, [-1, 0, 0])],
)
def test_directions_of_the_page(azimuth: float, right: list[int]) -> None:
    view = view_from(azimuth, 0.0)
    np.testing.assert_allclose(view.right, right, atol=1e-15)
    np.testing.assert_allclose(view.up, [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(np.cross(view.right, view.up), view.toward, atol=1e-15)
