"""Figures of a diagnosis, one function a figure, in the style of `identknee.report.figures`."""

import re
from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Ellipse, FancyArrowPatch
from scipy.spatial import ConvexHull

from identknee.diagnosis.isolability import Distances
from identknee.diagnosis.misfit import LEVEL, CellScore, places_words
from identknee.diagnosis.missing_line import LineEnds, Pull
from identknee.diagnosis.score import LEAST_DISTANCE
from identknee.diagnosis.verdict import Estimate
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import COORDINATES
from identknee.model.effects.facts import cause_label
from identknee.report.figures import (
    BLACK,
    COLOURS,
    GREY,
    MARKERS,
    STYLES,
    Figure,
    bare,
    legend_below,
    number,
    one_panel,
    panel_grid,
    panel_rows,
    rows_down,
    wrapped,
)
from identknee.report.laxity_figures import LaxityCurves, all_coordinates_figure, by_load_figure
from identknee.report.scene import View
from identknee.runs.declare import Array
from identknee.runs.words import PLAIN, coordinate_words, label, listed, unit_of
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import (
    AddedVariable,
    ByLigament,
    Diagnosis,
    IntervalsByLigament,
    StepScores,
)

N_CANDIDATES = 3
SMALL, TINY = 8, 7
# Corners of the frame of a cell.
FRAME = 0.46 * np.array([[-1.0, 1.0, 1.0, -1.0, -1.0], [-1.0, -1.0, 1.0, 1.0, -1.0]])
# Share of the largest score above which a cell is dark.
DARK = 0.6
QUANTITIES = {"stiffness_kN": "stiffness [kN]", "reference_strain_pct": "reference strain [%]"}


def misfit_words(region: Sequence[CellScore], share: float) -> str:
    """Where the misfit is, its coordinate in words."""
    if not region:
        return "No region stands out"
    return (
        f"{coordinate_words(region[0].coordinate)} {places_words(region)}, {100 * share:.0f} % of "
        "the excess misfit"
    )


def misfit_figure(cells: Sequence[CellScore], title: str = "") -> Figure:
    """The map of misfit: scores by coordinate, flexion and load direction.

    Red where more was measured than predicted, blue where less; bold and framed where noise alone
    hardly leaves such a score anywhere on the map. Grey cells have no data, or the parameters
    explain them.

    Parameters
    ----------
    cells
        Fields of the map.
    title
        Where the misfit is, from `misfit_words`.
    """
    rows = [x for x in COORDINATES if x in {y.coordinate for y in cells}]
    angles = sorted({x.flexion_deg for x in cells})
    directions = list(dict.fromkeys(x.direction for x in cells))
    known = {(x.flexion_deg, x.direction) for x in cells}
    # What was done at no angle, or not at this one, has no column.
    columns = [(angle, x) for angle in angles for x in directions if (angle, x) in known]
    scores = np.full((len(rows), len(columns)), np.nan)
    size = (2.9 + 0.5 * len(columns), 2.1 + 0.42 * len(rows))
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(wrapped(title, min(80, int(12.0 * size[0]))), fontsize=9)
    if not cells:
        return figure
    axes = figure.add_subplot()
    limit = max(5.0, *(abs(x.score) for x in cells))
    for x in cells:
        row, column = rows.index(x.coordinate), columns.index((x.flexion_deg, x.direction))
        scores[row, column] = x.score
        _write_cell(axes, column, row, number(x.score, ".1f"), is_dark=abs(x.score) > DARK * limit)
        if x.p_value <= LEVEL:
            axes.plot(column + FRAME[0], row + FRAME[1], color=BLACK, linewidth=1.6)
    axes.set_facecolor("0.85")
    image = axes.imshow(scores, cmap="RdBu_r", vmin=-limit, vmax=limit, aspect="auto")
    figure.colorbar(image, ax=axes, label="score of the misfit", shrink=0.9)
    axes.set_yticks(range(len(rows)), [label(x) for x in rows], fontsize=SMALL)
    axes.set_xticks(range(len(columns)), [x for _, x in columns], fontsize=TINY, rotation=90)
    for angle in angles:
        own = [i for i, x in enumerate(columns) if x[0] == angle]
        axes.text((own[0] + own[-1]) / 2, -0.75, f"{angle:g} deg", ha="center", fontsize=9)
        axes.axvline(own[-1] + 0.5, color=BLACK, linewidth=1.0)
    return figure


def residual_curves_figure(answer: Diagnosis) -> Figure | None:
    """What the base model leaves along every load curve, with what the leading causes explain.

    None where nothing was measured.

    Dots are measured minus predicted values, their bars two standard deviations of the noise. Lines
    are what the model changes when a cause joins it and everything is fitted again: the cause that
    is right goes through the dots.
    """
    if answer.trials is None or answer.residuals is None:
        return None
    left = answer.residuals.before
    changes = {
        listed(map(cause_label, x.names)): left - x.residuals
        for x in answer.explanations
        if x.names and np.isfinite(x.chi_square)
    }
    leading = dict(list(changes.items())[:N_CANDIDATES])
    return residuals_figure(answer.trials.protocol, left, answer.residuals.sd, leading)


def residuals_figure(
    protocol: Protocol, residuals: Array, sd: Array, changes: Mapping[str, Array]
) -> Figure | None:
    """What a model leaves of the data along every load curve, and what others change of it.

    By load and flexion where trials make up no load curves, as those that a rig runs. None where
    nothing was measured.

    Parameters
    ----------
    protocol
        The trials.
    residuals
        Measured minus predicted [mm, deg], shape ``(n, 5)``; NaN where nothing was measured.
    sd
        Standard deviation of the noise, in the same shape.
    changes
        By name of a model, its prediction minus the first one's, in the same shape.
    """
    if not np.isfinite(residuals).any():
        return None
    left = LaxityCurves(
        protocol=protocol,
        simulated={WITHOUT_CAUSE: np.zeros_like(residuals), **changes},
        measured=residuals,
        sd=sd,
    )
    draw = all_coordinates_figure if left.on_curves().all() else by_load_figure
    return draw(left, LEFT_OVER)


WITHOUT_CAUSE = "model without causes"
LEFT_OVER = f"measured minus predicted by the {WITHOUT_CAUSE}"


def added_variable_figure(added: AddedVariable) -> Figure:
    """What is left of the data against what the leading cause would leave, by flexion.

    Both without what the fitted parameters explain. A cause that is right puts all points on the
    line; clusters of one angle away from it contradict it.
    """
    expected, left, flexion = added.expected, added.left, added.flexion_deg
    name = cause_label(added.name)
    figure, axes = one_panel(5.0, 4.8)
    for k, angle in enumerate(np.unique(flexion)):
        own = flexion == angle
        axes.plot(
            expected[own],
            left[own],
            MARKERS[k % len(MARKERS)],
            color=COLOURS[k % len(COLOURS)],
            markersize=4,
            alpha=0.75,
            label=f"{angle:g} deg",
        )
    reach = 1.05 * np.abs(expected).max() * np.array([-1.0, 1.0])
    axes.plot(reach, reach, color=BLACK, linewidth=1.0, label="as the cause would have it")
    axes.set_xlabel(wrapped(f"expected of {name} [sd of the noise]"))
    axes.set_ylabel("left of the data [sd of the noise]")
    # Of a place its coordinates are said, some of them negative.
    words = re.sub(r"(?<!\w)-(?=\d)", "−", added.variant.replace("_", " "))
    variant = f", {words}" if words else ""
    axes.set_title(wrapped(f"{name}{variant}, score {added.score:.1f}", 60), fontsize=9)
    bare(axes)
    legend_below(figure, *axes.get_legend_handles_labels(), columns=4, fontsize=SMALL)
    return figure


def scores_figure(steps: Sequence[StepScores]) -> Figure:
    """The scores of all effects beside the model without causes, and beside the explanation.

    Right of the line lies the largest score of all in 5 % of data without any effect.
    """
    order = list(steps[0].scores)
    figure, axes = one_panel(7.4, 1.3 + 0.24 * len(order))
    height = 0.8 / len(steps)
    for k, step in enumerate(steps):
        places = np.arange(len(order)) + (k - 0.5 * (len(steps) - 1)) * height
        # Effects that are in the fit already have no score.
        scores = [step.scores.get(x, 0.0) for x in order]
        beside = listed(map(cause_label, step.beside))
        axes.barh(
            places,
            scores,
            height,
            color=COLOURS[k],
            label=f"with {beside}" if beside else WITHOUT_CAUSE,
        )
        axes.axvline(step.quantile, color=COLOURS[k], linestyle=STYLES[1], linewidth=1.0)
    rows_down(axes, [cause_label(x) for x in order], fontsize=SMALL)
    axes.set_xlim(left=0.0)
    axes.set_xlabel(
        "score [normal deviate]\ndashed line: the largest of all by chance in 5 % of data",
        fontsize=SMALL + 1,
    )
    if len(steps) > 1:
        legend_below(figure, *axes.get_legend_handles_labels(), columns=2, fontsize=SMALL)
    bare(axes)
    return figure


def isolability_figure(distances: Distances) -> Figure:
    """How far the data expected under each cause are from the best fit of each other one.

    Rows are true, columns fitted in their place. Dark cells below 5 cannot be distinguished.
    """
    names = distances.effects
    order = [distances.rivals.index(x) for x in names]
    values = np.array(distances.values[:, order])
    np.fill_diagonal(values, np.nan)
    values[~np.isfinite(values)] = np.nan
    size = 3.4 + 0.33 * len(names)
    figure, axes = one_panel(size + 0.8, size)
    axes.set_facecolor("0.85")
    image = axes.imshow(values, cmap="magma", vmin=0.0)
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value) and value < LEAST_DISTANCE:
            _write_cell(axes, column, row, f"{value:.1f}", is_dark=True)
    figure.colorbar(image, ax=axes, label="distance [sd of the noise]", shrink=0.8)
    labels = [cause_label(x) for x in names]
    axes.set_xticks(range(len(names)), labels, rotation=90, fontsize=TINY)
    axes.set_yticks(range(len(names)), labels, fontsize=TINY)
    axes.set(xlabel="cause fitted in its place", ylabel="true cause")
    return figure


def parameters_before_after_figure(
    answer: Diagnosis, truth: Mapping[str, float] | None = None
) -> Figure:
    """The ligaments' parameters without and with the causes, with their 95 % intervals.

    Parameters
    ----------
    answer
        The diagnosis.
    truth
        True values by whole name, where they are known.
    """
    fits = {WITHOUT_CAUSE: _estimates(answer.parameters_before, answer.parameters_before_ci95)}
    if answer.causes:
        after = _estimates(answer.parameters_after, answer.parameters_after_ci95)
        fits[f"with {listed(map(cause_label, answer.cause_names))}"] = after
    return estimates_figure(fits, truth)


def estimates_figure(
    fits: Mapping[str, Mapping[str, Mapping[str, Estimate]]],
    truth: Mapping[str, float] | None = None,
) -> Figure:
    """The ligaments' parameters by one or more fits, with their 95 % intervals.

    Parameters
    ----------
    fits
        By name of the fit, then of the ligament and of its parameter.
    truth
        True values by whole name, where they are known.
    """
    ligaments = list(next(iter(fits.values())))
    n = len(ligaments)
    figure, grid = panel_grid(1.0 + 1.5 * n, 4.6, len(QUANTITIES), n)
    for row, (quantity, words) in zip(grid, QUANTITIES.items(), strict=True):
        for axes, ligament in zip(row, ligaments, strict=True):
            for k, (name, tree) in enumerate(fits.items()):
                estimate = tree[ligament][quantity]
                ends = np.array([estimate.value if x is None else x for x in estimate.ci95])[
                    :, None
                ]
                value, colour = estimate.value, COLOURS[k]
                bars = np.abs(ends - value)
                axes.errorbar(
                    [k], [value], yerr=bars, fmt=MARKERS[k], color=colour, capsize=4, label=name
                )
                for end, arrow in zip(estimate.ci95, ("$\\downarrow$", "$\\uparrow$"), strict=True):
                    if end is None:
                        # An open end has no bar but an arrow.
                        axes.plot([k], [value], marker=arrow, color=colour, markersize=14)
            if truth is not None and f"{ligament}.{quantity}" in truth:
                true = truth[f"{ligament}.{quantity}"]
                axes.axhline(true, color=BLACK, linewidth=1.0, label="truth")
            axes.set(xlim=(-0.7, len(fits) - 0.3), xticks=[])
            bare(axes, labelsize=SMALL)
        row[0].set_ylabel(words)
    for axes, ligament in zip(grid[0], ligaments, strict=True):
        axes.set_title(wrapped(ligament, 14), fontsize=9)
    legend_below(figure, *grid[0, 0].get_legend_handles_labels(), columns=3)
    return figure


def diagnosis_figures(answer: Diagnosis, knee: Knee) -> dict[str, Figure]:
    """All figures that a diagnosis of a knee has something for, by the name of their file."""
    misfit, added = answer.misfit, answer.added_variable
    if misfit is None or added is None:
        return {}
    drawn = {
        "misfit": misfit_figure(misfit.map, misfit_words(misfit.cells, misfit.share)),
        "residuals": residual_curves_figure(answer),
        "added_variable": added_variable_figure(added),
        "scores": scores_figure(answer.steps),
        "parameters": parameters_before_after_figure(answer),
        "missing_wrench": wrench_figure(answer, knee),
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def _estimates(
    values: ByLigament | None, intervals: IntervalsByLigament | None
) -> dict[str, dict[str, Estimate]]:
    return {
        ligament: {
            name: Estimate(name=name, value=x, unit=unit_of(name) or PLAIN, ci95=own[name])
            for name, x in (values or {})[ligament].items()
        }
        for ligament, own in (intervals or {}).items()
    }


def _write_cell(axes: Axes, column: int, row: int, text: str, *, is_dark: bool) -> None:
    color = "white" if is_dark else BLACK
    axes.text(column, row, text, ha="center", va="center", fontsize=TINY, color=color)


# Right is lateral, up is anterior: a right knee's plateau as the femur sees it.
ABOVE = View(right=np.array([0.0, 0.0, 1.0]), up=np.eye(3)[0], toward=np.eye(3)[1])
PLATEAU, MARGIN = "0.92", 0.12
REACH = 22.0  # mm on the page, of the largest force that is shown as known
RING = 13.0  # mm, radius of the arc of a moment
LEAST_TURN, MOST_TURN = 8.0, 150.0  # deg, of an arc that is drawn, and of the largest
WITHIN_95 = 2.45  # standard deviations of a pair of numbers
SHOWN, LINES = COLOURS[1], (COLOURS[2], COLOURS[3], COLOURS[4])


MOST_PULLS = 6


def largest_pulls(pulls: Sequence[Pull]) -> tuple[Pull, ...]:
    """The largest of what is missing, what noise hardly leaves first, in their own order."""
    scales = _largest(pulls)
    kept = sorted(pulls, key=lambda x: (x.p_value > LEVEL, -_size(x, *scales)))[:MOST_PULLS]
    return tuple(x for x in pulls if x in kept)


def _largest(pulls: Sequence[Pull]) -> tuple[float, float]:
    """The largest force [N] and the largest moment [N·m], never zero."""
    tiny = float(np.finfo(np.float64).tiny)
    forces, moments = map(_force, pulls), (abs(x.internal_moment_Nm) for x in pulls)
    return max([tiny, *forces]), max([tiny, *moments])


def _size(pull: Pull, force: float, moment: float) -> float:
    """Force and moment together, as shares of these."""
    return _force(pull) / force + abs(pull.internal_moment_Nm) / moment


def wrench_figure(answer: Diagnosis, knee: Knee) -> Figure | None:
    """What else would have to act on the tibia, on its plateau, by flexion and direction of load.

    Straight arrows are forces, arcs moments about the tibial axis, both means over the trials and
    outside the directions in which contact presses; the ellipse holds the tip in 95 % of cases.
    Grey is what noise alone may ask for. It is what is missing beside the ligaments as they are in
    the explanation that the diagnosis gives, whose structures are drawn too, a square at the tibia;
    where it gives none, beside ligaments that have taken over what they can. Of many the largest
    are shown. None where nothing was computed.
    """
    pulls = largest_pulls(answer.missing_wrench)
    if not pulls:
        return None
    figure, panels = panel_rows(len(pulls), PANEL, (0.4, 1.3), PULLS_ACROSS)
    width = figure.get_figwidth()
    of_many = len(answer.missing_wrench) > len(pulls)
    which = f", the largest {len(pulls)} of {len(answer.missing_wrench)}" if of_many else ""
    title = f"missing force and moment on the tibia, seen from above{which}"
    figure.suptitle(wrapped(title, int(14 * width)), fontsize=10)
    force, moment = _largest([x for x in pulls if x.p_value <= LEVEL] or pulls)
    given: dict[str, LineEnds] = {
        cause_label(x.name): x.line for x in answer.causes if x.line is not None
    }
    if answer.line is not None and not given:
        given = {"the line tried": answer.line}
    lines = {k: knee.tibia_frame.to_local(x.in_common_frame(knee)) for k, x in given.items()}
    # Arrows cross what is written beside them: names stand where these are shortest.
    least = min(pulls, key=lambda x: _size(x, force, moment))
    for pull, axes in zip(pulls, panels, strict=True):
        _draw_plateau(axes, knee, lines, is_named=pull is least)
        _draw_pull(axes, pull, REACH / force, MOST_TURN / moment)
        axes.set_title(f"{pull.flexion_deg:g} deg, {pull.direction}", fontsize=9)
    handles = [
        Line2D([], [], color=SHOWN, linewidth=1.8, label="more than noise (p < 0.05)"),
        Line2D([], [], color=GREY, linewidth=1.8, label="may be noise"),
        *(
            Line2D([], [], color=colour, linewidth=2.0, marker="s", markersize=4, label=name)
            for name, colour in zip(lines, cycle(LINES), strict=False)
        ),
    ]
    legend_below(
        figure,
        handles,
        columns=min(len(pulls), PULLS_ACROSS),
        title=wrapped(
            "up is anterior, right is lateral, an arc counterclockwise is an internal moment",
            int(15 * width),
        ),
        title_fontsize=SMALL,
    )
    return figure


# Panels side by side, and the inches of each.
PULLS_ACROSS, PANEL = 3, (2.3, 1.75)
# Of a name: width of a letter and height [mm on the plateau].
LETTER = (4.3, 8.0)


def _draw_plateau(axes: Axes, knee: Knee, lines: Mapping[str, Array], *, is_named: bool) -> None:
    """The tibial cartilage and where ligaments insert, from above."""
    for surface in knee.tibia:
        page = ABOVE.project(knee.tibia_frame.to_local(surface.vertices))[:, :2]
        axes.fill(*page[ConvexHull(page).vertices].T, color=PLATEAU, linewidth=0)
    places = ABOVE.project(knee.tibia_frame.to_local([x.tibia for x in knee.ligaments]))[:, :2]
    axes.plot(*places.T, "o", color=GREY, markersize=2.5)
    taken: list[Array] = []
    for ligament, place in zip(knee.ligaments, places, strict=True) if is_named else ():
        away = 7.0 * place / max(float(np.hypot(*place)), 1.0)
        # Bundles insert side by side: a name that would overlap another is left out.
        box = np.array([LETTER[0] * len(ligament.name), LETTER[1]])
        middle = place + 0.5 * away + 0.5 * box * [np.sign(away[0]) * (abs(away[0]) > 4.0), 0.0]
        if any((np.abs(x[0] - middle) < 0.5 * (x[1] + box)).all() for x in taken):
            continue
        taken.append(np.array([middle, box]))
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
    text = f"{_force(pull):.0f} N, {number(moment, '+.1f')} ± {sd:.1f} N·m"
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
