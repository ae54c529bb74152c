"""The forces a model lacks, as arrows on the tibial plateau."""

from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Ellipse, FancyArrowPatch
from scipy.spatial import ConvexHull

from identknee.diagnosis.missing_line import LineEnds, Pull
from identknee.model.effects.facts import cause_label
from identknee.report.figures import COLOURS, GREY
from identknee.report.scene import View
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import Diagnosis

# Right is lateral, up is anterior: a right knee's plateau as the femur sees it.
ABOVE = View(right=np.array([0.0, 0.0, 1.0]), up=np.eye(3)[0], toward=np.eye(3)[1])
LEVEL = 0.05
PLATEAU, MARGIN = "0.92", 0.12
REACH = 22.0  # mm on the page, of the largest force that is shown as known
RING = 13.0  # mm, radius of the arc of a moment
LEAST_TURN, MOST_TURN = 8.0, 150.0  # deg, of an arc that is drawn, and of the largest
WITHIN_95 = 2.45  # standard deviations of a pair of numbers
SHOWN, LINES = COLOURS[1], (COLOURS[0], COLOURS[2], COLOURS[3])
SMALL, TINY = 8, 7


def wrench_figure(answer: Diagnosis, knee: Knee) -> Figure:
    """What else would have to act on the tibia, on its plateau, by flexion and direction of load.

    Straight arrows are forces, arcs moments about the tibial axis, both means over the trials and
    outside the directions in which contact presses; the ellipse holds the tip in 95 % of cases.
    Grey is what noise alone may ask for. It is what is missing beside the ligaments as they are in
    the explanation that the diagnosis gives, whose structures are drawn too, a square at the tibia;
    where it gives none, beside ligaments that have taken over what they can.

    Parameters
    ----------
    answer
        The diagnosis.
    knee
        The subject.
    """
    pulls = answer.missing_wrench
    angles = sorted({x.flexion_deg for x in pulls})
    directions = list(dict.fromkeys(x.direction for x in pulls))
    size = (0.8 + 2.1 * max(len(directions), 1), 1.2 + 1.45 * max(len(angles), 1))
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle("missing force and moment on the tibia, seen from above", fontsize=10)
    if not pulls:
        return figure
    grid = figure.subplots(len(angles), len(directions), squeeze=False)
    known = [x for x in pulls if x.p_value <= LEVEL] or pulls
    forces = [_force(x) for x in known]
    moments = [abs(x.internal_moment_Nm) for x in known]
    tiny = np.finfo(np.float64).tiny
    force, moment = max(*forces, tiny), max(*moments, tiny)
    given: dict[str, LineEnds] = {
        cause_label(x.name): x.line for x in answer.causes if x.line is not None
    }
    if answer.line is not None and not given:
        given = {"the line tried": answer.line}
    lines = {k: knee.tibia_frame.to_local(x.in_common_frame(knee)) for k, x in given.items()}
    # Arrows cross what is written beside them: names stand where these are shortest.
    least = min(pulls, key=lambda x: _force(x) / force + abs(x.internal_moment_Nm) / moment)
    named = grid[angles.index(least.flexion_deg), directions.index(least.direction)]
    for axes in grid.flat:
        is_named = axes is named
        for surface in knee.tibia:
            page = ABOVE.project(knee.tibia_frame.to_local(surface.vertices))[:, :2]
            axes.fill(*page[ConvexHull(page).vertices].T, color=PLATEAU, linewidth=0)
        places = ABOVE.project(knee.tibia_frame.to_local([x.tibia for x in knee.ligaments]))[:, :2]
        axes.plot(*places.T, "o", color=GREY, markersize=2.5)
        for ligament, place in zip(knee.ligaments, places, strict=True) if is_named else ():
            away = 7.0 * place / max(float(np.hypot(*place)), 1.0)
            axes.annotate(
                ligament.name,
                place,
                (float(away[0]), float(away[1])),
                textcoords="offset points",
                fontsize=TINY,
                ha="left" if away[0] > 4.0 else "right" if away[0] < -4.0 else "center",
                va="center",
            )
        for line, colour in zip(lines.values(), cycle(LINES), strict=False):
            ends = ABOVE.project(line)[:, :2]
            axes.plot(*ends.T, color=colour, linewidth=2.0)
            axes.plot(*ends[1], "s", color=colour, markersize=4)
        axes.set_aspect("equal")
        axes.margins(MARGIN)
        axes.set_axis_off()
        # What follows must not change the scale, which is that of all panels.
        axes.autoscale_view()
        axes.set_autoscale_on(False)
    for pull in pulls:
        axes = grid[angles.index(pull.flexion_deg), directions.index(pull.direction)]
        _draw_pull(axes, pull, REACH / force, MOST_TURN / moment)
    for axes, direction in zip(grid[0], directions, strict=True):
        axes.set_title(direction, fontsize=9)
    for axes, angle in zip(grid[:, 0], angles, strict=True):
        axes.text(-0.04, 0.5, f"{angle:g} deg", transform=axes.transAxes, ha="right", va="center")
    handles = [
        Line2D([], [], color=SHOWN, linewidth=1.8, label="more than noise (p < 0.05)"),
        Line2D([], [], color=GREY, linewidth=1.8, label="may be noise"),
        *(
            Line2D([], [], color=colour, linewidth=2.0, marker="s", markersize=4, label=name)
            for name, colour in zip(lines, cycle(LINES), strict=False)
        ),
    ]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=4,
        frameon=False,
        fontsize=9,
        title="up is anterior, right is lateral, an arc counterclockwise is an internal moment",
        title_fontsize=SMALL,
    )
    return figure


def _force(pull: Pull) -> float:
    return float(np.hypot(pull.anterior_force_N, pull.lateral_force_N))


def _draw_pull(axes: Axes, pull: Pull, mm_per_N: float, deg_per_Nm: float) -> None:
    """The force from the tibial origin, the moment around it, and how sure they are."""
    colour = SHOWN if pull.p_value <= LEVEL else GREY
    tip = mm_per_N * np.array([pull.lateral_force_N, pull.anterior_force_N])
    values, vectors = np.linalg.eigh(mm_per_N**2 * np.array(pull.force_covariance))
    width, height = 2.0 * WITHIN_95 * np.sqrt(np.maximum(values[::-1], 0.0))
    turn = float(np.degrees(np.arctan2(vectors[0, 1], vectors[1, 1])))
    axes.add_patch(
        Ellipse(
            (tip[0], tip[1]), width, height, angle=turn, facecolor=colour, alpha=0.15, linewidth=0
        )
    )
    _draw_arrow(axes, np.zeros(2), tip, colour)
    _draw_moment(axes, deg_per_Nm * pull.internal_moment_Nm, colour)
    moment, sd = pull.internal_moment_Nm, pull.sd_internal_moment_Nm
    text = f"{_force(pull):.0f} N, {moment:+.1f} ± {sd:.1f} N·m"
    axes.text(0.5, -0.02, text, transform=axes.transAxes, ha="center", va="top", fontsize=TINY)


def _draw_moment(axes: Axes, turn: float, colour: str) -> None:
    """An arc of `turn` [deg] with a head: counterclockwise is internal."""
    start = 90.0 - 0.5 * turn
    if abs(turn) < LEAST_TURN:
        return
    low, high = sorted((start, start + turn))
    arc = Arc((0.0, 0.0), 2 * RING, 2 * RING, theta1=low, theta2=high, color=colour, zorder=4)
    arc.set_linewidth(1.5)
    axes.add_patch(arc)
    # The head follows the last degrees of the arc.
    before, end = np.radians([start + turn - np.sign(turn) * 0.5 * LEAST_TURN, start + turn])
    foot, tip = (RING * np.array([np.cos(x), np.sin(x)]) for x in (before, end))
    _draw_arrow(axes, foot, tip, colour)


def _draw_arrow(axes: Axes, foot: Array, tip: Array, colour: str) -> None:
    arrow = FancyArrowPatch(
        (foot[0], foot[1]),
        (tip[0], tip[1]),
        arrowstyle="-|>",
        color=colour,
        linewidth=1.8,
        shrinkA=0,
        shrinkB=0,
        mutation_scale=9,
        zorder=4,
    )
    axes.add_patch(arrow)
