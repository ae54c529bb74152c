"""A picture of a knee: its surfaces, ligaments and axes, as Figure 1 of the paper shows them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from identknee.mechanics.contact_points import distances
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.ligament_tensions import line_courses
from identknee.mechanics.pose import Placement, place, start_pose
from identknee.model.laxity_model import lines_in_bones
from identknee.report.figures import Figure, show_figures
from identknee.runs.declare import Array, IntArray, declared, entry, frozen
from identknee.subject.knee import Knee

FEMUR, TIBIA, LIGAMENT = "#8ec7e8", "#5b9bc8", "#c8102e"
FEMUR_AXES, TIBIA_AXES = "#e6a700", "#00895f"
OPACITY = 0.62  # of the femur, so that the cruciates show through it
LIGAMENT_WIDTH, SCALE_BAR = 1.6, 20.0  # mm
# Where both frames coincide the longer arrows of the femur still show.
FEMUR_AXIS_LENGTH, TIBIA_AXIS_LENGTH = 60.0, 42.0  # mm
PIECES = 40
AXIS_NAMES = ("anterior", "superior", "lateral")
LIGHT = np.array([0.35, 0.45, 0.82])  # right, up, toward the reader
AMBIENT = 0.55
# About, of a knee in a figure of the usual size, of its bold names [points].
POINTS_PER_MM, LETTER_WIDTH, LINE_HEIGHT = 2.2, 7.0, 12.0


@declared
class View:
    """Directions of a parallel projection in femoral axes."""

    right: Array = entry("Unit vector to the right of the page, shape ``(3,)``")
    up: Array = entry("Unit vector to its top")
    toward: Array = entry("Unit vector toward the reader")

    def project(self, points: Array) -> Array:
        """Right, up and toward the reader [mm] of points ``(..., 3)``, in the same shape."""
        return np.asarray(points @ np.stack([self.right, self.up, self.toward], axis=1))


def view_from(azimuth_deg: float, elevation_deg: float) -> View:
    """View of a right knee: azimuth 0 from in front, 90 from the lateral side, 180 from behind.

    Examples
    --------
    >>> view_from(90, 0).toward.round(9) + 0.0
    array([0., 0., 1.])
    """
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    toward = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.sin(elevation),
            np.cos(elevation) * np.sin(azimuth),
        ]
    )
    right = np.array([np.sin(azimuth), 0.0, -np.cos(azimuth)])
    return View(right=right, up=np.cross(toward, right), toward=toward)


def scene(
    knee: Knee,
    pose: ArrayLike | None = None,
    *,
    flexion_deg: float = 0.0,
    azimuth_deg: float = 215.0,
    elevation_deg: float = 12.0,
    figure: Figure | None = None,
) -> Figure:
    """Figure of the cartilage surfaces, the ligaments and the axes of both bones.

    Parameters
    ----------
    knee
        The subject, drawn as a right knee.
    pose
        Varus, internal [rad], x, y, z [mm] of the tibia at `flexion_deg`, shape ``(5,)``, as in
        `Prediction.poses`; the scanned pose if None.
    flexion_deg
        Flexion angle of `pose` [deg]; not used without it.
    azimuth_deg, elevation_deg
        From where it is seen [deg]: 0 from in front, 90 from the lateral side, 180 from behind, and
        how far from above.
    figure
        An empty figure to draw into; a new one if None.
    """
    view = view_from(azimuth_deg, elevation_deg)
    if figure is None:
        figure = Figure(figsize=(6.0, 6.4), layout="constrained")
    draw_scene(figure.add_subplot(), knee, view, pose=pose, flexion_deg=flexion_deg)
    show_figures()
    return figure


def draw_scene(
    axes: Axes, knee: Knee, view: View, *, pose: ArrayLike | None = None, flexion_deg: float = 0.0
) -> None:
    """Draw what `scene` shows into `axes`."""
    placement = _placement(knee, pose, flexion_deg)
    femur = knee.femur_frame.to_local(knee.femur.vertices)
    tibia = [placement.to_femur(knee.tibia_frame.to_local(x.vertices)) for x in knee.tibia]
    tibial = placement.to_femur(knee.tibia_frame.to_local([x.tibia for x in knee.ligaments]))
    parts = [_triangles(view, femur, knee.femur.faces, FEMUR, OPACITY)]
    parts += [
        _triangles(view, vertices, surface.faces, TIBIA, 1.0)
        for vertices, surface in zip(tibia, knee.tibia, strict=True)
    ]
    parts += [
        _ribbon(view, a, b, max(2, PIECES // (len(course) - 1)))
        for course in line_courses(lines_in_bones(knee), placement)
        for a, b in pairwise(course)
    ]
    corners = [polygon for part in parts for polygon in part.corners]
    colours = np.concatenate([part.colours for part in parts])
    smooth = np.concatenate([np.full(len(part.depths), part.smooth) for part in parts])
    edges = np.where(smooth[:, None], colours, 0.0)
    order = np.argsort(np.concatenate([part.depths for part in parts]), kind="stable")
    axes.add_collection(
        PolyCollection(
            [corners[i] for i in order],
            facecolors=colours[order],
            edgecolors=edges[order],
            linewidths=0.3,
            antialiaseds=smooth[order].tolist(),
        )
    )
    axes.autoscale_view()
    femoral_axes = FEMUR_AXIS_LENGTH * np.eye(3)
    tibial_axes = TIBIA_AXIS_LENGTH * placement.rotation.T
    _draw_axes(axes, view, np.zeros(3), femoral_axes, FEMUR_AXES)
    _draw_axes(axes, view, placement.translation, tibial_axes, TIBIA_AXES)
    for tip, name in zip(view.project(femoral_axes)[:, :2], AXIS_NAMES, strict=True):
        right, up = 7.0 * tip / max(float(np.hypot(*tip)), 1e-9)
        axes.annotate(
            name,
            tip,
            (right, up),
            textcoords="offset points",
            fontsize=9,
            ha="left" if right > 3 else "right" if right < -3 else "center",
            va="center" if abs(up) < 4 else "bottom" if up > 0 else "top",
        )
    owners = knee.owners
    names = list(dict.fromkeys(owners))
    ends = view.project(tibial)[:, :2]
    places = np.array([ends[[x == name for x in owners]].mean(axis=0) for name in names])
    middle = places[:, 0].mean()
    taken: list[tuple[float, float, float]] = []
    for name, (x, y) in zip(names, places, strict=True):
        right, below = x >= middle, -4.0
        width = LETTER_WIDTH * len(name)
        left = POINTS_PER_MM * x + (6.0 if right else -6.0 - width)
        # Bundles insert side by side: names that would overlap are moved below.
        while any(
            left < end
            and start < left + width
            and abs(POINTS_PER_MM * y + below - up) < LINE_HEIGHT
            for start, end, up in taken
        ):
            below -= LINE_HEIGHT
        taken.append((left, left + width, POINTS_PER_MM * y + below))
        axes.annotate(
            name,
            (x, y),
            (6 if right else -6, below),
            textcoords="offset points",
            color=LIGAMENT,
            fontsize=9,
            fontweight="bold",
            ha="left" if right else "right",
            va="top",
        )
    axes.set_aspect("equal")
    axes.margins(0.12)
    axes.autoscale_view()
    left, bottom = axes.get_xlim()[0], axes.get_ylim()[0]
    axes.plot([left, left + SCALE_BAR], [bottom, bottom], color="black", linewidth=2)
    axes.annotate(
        f"{SCALE_BAR:g} mm", (left, bottom), (0, 4), textcoords="offset points", fontsize=8
    )
    keys = {"femoral axes": FEMUR_AXES, "tibial axes": TIBIA_AXES, "ligaments": LIGAMENT}
    axes.legend(
        handles=[Line2D([], [], color=x, linewidth=2, label=name) for name, x in keys.items()],
        loc="lower right",
        frameon=False,
        fontsize=8,
    )
    axes.set_axis_off()


def distance_from_femur(field: DistanceField, places: Array) -> Array:
    """Distance of places from the femur [mm]; NaN beyond the grid of the field."""
    places = field.to_field(places)
    cell = np.floor((places - field.origin) / field.spacing)
    # The outermost cells of the grid lack the support of the spline.
    inner = ((cell >= 1) & (cell <= np.array(field.coefficients.shape) - 3)).all(axis=1)
    found = np.full(len(places), np.nan)
    found[inner] = distances(field, places[inner])[0]
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class _Polygons:
    """Polygons on the page: corners ``(n, corners, 2)``, depths ``(n,)``, colours ``(n, 4)``.

    Without `smooth` edges the seams of neighbouring triangles do not show.
    """

    corners: Array
    depths: Array
    colours: Array
    smooth: bool = False


def _placement(knee: Knee, pose: ArrayLike | None, flexion_deg: float) -> Placement:
    if pose is None:
        flexion, start = start_pose(
            knee.femur_frame.axes @ knee.tibia_frame.axes.T,
            knee.femur_frame.to_local(knee.tibia_frame.origin[None])[0],
        )
        return place(flexion, start)
    return place(float(np.radians(flexion_deg)), frozen(pose, 5, name="the pose"))


def shaded(view: View, triangles: Array, ambient: float) -> tuple[Array, Array]:
    """Triangles on the page with their depths, and how bright each is; both sides are seen."""
    corners = view.project(triangles)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    facing = np.abs(normals @ (LIGHT / np.linalg.norm(LIGHT))) / np.where(lengths > 0, lengths, 1)
    return corners, ambient + (1.0 - ambient) * facing


def _triangles(
    view: View, vertices: Array, faces: IntArray, colour: str, opacity: float
) -> _Polygons:
    """A surface, each triangle shaded by how it faces the light."""
    corners, shade = shaded(view, vertices[faces], AMBIENT)
    colours = np.column_stack([np.outer(shade, to_rgb(colour)), np.full(len(faces), opacity)])
    return _Polygons(corners=corners[..., :2], depths=corners[..., 2].mean(axis=1), colours=colours)


def _ribbon(view: View, start: Array, end: Array, pieces: int) -> _Polygons:
    """Part of a ligament as a band that faces the reader, in pieces that are hidden one by one."""
    along = np.linspace(view.project(start), view.project(end), pieces + 1)
    direction = along[-1, :2] - along[0, :2]
    across = np.array([-direction[1], direction[0]]) / max(float(np.hypot(*direction)), 1e-9)
    sides = 0.5 * LIGAMENT_WIDTH * across
    before, after = along[:-1, :2], along[1:, :2]
    corners = np.stack([before - sides, before + sides, after + sides, after - sides], axis=1)
    depths = 0.5 * (along[:-1, 2] + along[1:, 2])
    colours = np.tile([*to_rgb(LIGAMENT), 1.0], (pieces, 1))
    return _Polygons(corners=corners, depths=depths, colours=colours, smooth=True)


def _draw_axes(axes: Axes, view: View, origin: Array, arrows: Array, colour: str) -> None:
    """Arrows from `origin` along the rows of `arrows`."""
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
    foot = view.project(origin)[:2]
    for arrow in arrows:
        tip = view.project(origin + arrow)[:2]
        axes.annotate("", (tip[0], tip[1]), (foot[0], foot[1]), arrowprops=style)
        axes.update_datalim([tip])
