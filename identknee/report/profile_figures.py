"""Figures of profiles, one function a figure, in the style of `identknee.report.figures`."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import scipy.interpolate
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identknee.identify.profile.result import Interval, Profile, SideStatus, cubic
from identknee.report.figures import BLACK, COLOURS, GREY, MARKERS
from identknee.runs.arrays import Array
from identknee.runs.words import label_without_unit

# Nested sets beside the profile's own.
LEVELS = (0.5, 0.8, 0.9)
COLUMNS = 4
PER_SEGMENT = 12
HEADROOM = 1.35
THICKNESSES = (9.0, 6.0, 3.5, 1.5)


def profiles_figure(profiles: Sequence[Profile]) -> Figure:
    """The rise of the deviance of each quantity, with its points, threshold and confidence set.

    A panel each. The shaded stretch is the confidence set; where it is open it ends in an
    arrow. Further local optima have other markers.

    Parameters
    ----------
    profiles
        Profiles of any quantities.
    """
    figure, panels = _panels(len(profiles), 2.3)
    for axes, profile in zip(panels, profiles, strict=False):
        top = HEADROOM * profile.threshold
        for branch in np.unique(profile.branches):
            here = profile.branches == branch
            marker, colour = MARKERS[branch % len(MARKERS)], COLOURS[branch % len(COLOURS)]
            rows = np.column_stack([profile.values, profile.deltas, profile.slopes])[here]
            places, heights = [rows[:1, 0]], [rows[:1, 1]]
            for left, right in pairwise([(float(a), float(b), float(c)) for a, b, c in rows]):
                between = np.linspace(left[0], right[0], PER_SEGMENT + 1)[1:]
                places.append(between)
                heights.append(np.array([cubic(x, left, right) for x in between]))
            axes.plot(
                *(np.concatenate(places), np.concatenate(heights)), color=colour, linewidth=1.2
            )
            axes.plot(
                profile.values[here], profile.deltas[here], marker, color=colour, markersize=3.5
            )
        axes.axhline(profile.threshold, color=GREY, linestyle="--", linewidth=0.9)
        for interval in profile.intervals:
            low, high = _drawn(interval, profile)
            axes.axvspan(low, high, color=COLOURS[5], alpha=0.18, linewidth=0)
            for end, place, turn in ((interval[0], low, -1), (interval[1], high, 1)):
                if end is None:
                    axes.annotate(
                        "open",
                        (place, 0.55 * profile.threshold),
                        fontsize=7,
                        ha="left" if turn < 0 else "right",
                    )
        axes.set_ylim(-0.05 * top, top)
        verdict = profile.verdict.value.replace("_", " ")
        words = label_without_unit(profile.name)
        label = f"{words} [{profile.unit}]" if profile.unit else words
        axes.set_title(f"{label}\n{verdict}".replace(" in ", "\nin "), fontsize=8)
        _plain(axes)
    for axes in panels[::COLUMNS]:
        axes.set_ylabel("rise of deviance")
    return figure


def intervals_figure(
    profiles: Sequence[Profile], truth: Mapping[str, float] | None = None
) -> Figure:
    """Nested sets of confidence as bars, one row a quantity, thinner for higher levels.

    Quantities of one unit share an axis in that unit, so that the longer bar is the less known
    value. An open end is an arrow at the place reached, or a cross where only the model ends.

    Parameters
    ----------
    profiles
        Profiles of any quantities.
    truth
        True values by name, where they are known.
    """
    units = list(dict.fromkeys(x.unit for x in profiles))
    groups = [[x for x in profiles if x.unit == unit] for unit in units]
    size = (8.2, 0.5 + 0.75 * len(groups) + 0.3 * len(profiles))
    figure = Figure(figsize=size, layout="constrained")
    heights = [len(x) + 0.6 for x in groups]
    grid = figure.subplots(len(groups), squeeze=False, height_ratios=heights)[:, 0]
    for axes, unit, group in zip(grid, units, groups, strict=True):
        for row, profile in enumerate(group):
            for thickness, (level, intervals) in zip(
                THICKNESSES, nested(profile).items(), strict=False
            ):
                for interval in intervals:
                    axes.plot(
                        _drawn(interval, profile),
                        [row, row],
                        color=COLOURS[0],
                        alpha=0.75,
                        linewidth=thickness,
                        solid_capstyle="butt",
                        label=f"{100 * level:g} %",
                    )
            for side, marker in ((profile.lower_side, "<"), (profile.upper_side, ">")):
                if side.end is None:
                    is_model = side.status is SideStatus.OPEN_AT_FEASIBILITY
                    word = "the model ends" if is_model else "open"
                    shape = "X" if is_model else marker
                    axes.plot(
                        side.reached,
                        row,
                        shape,
                        color=COLOURS[1],
                        markersize=6,
                        label=word,
                        zorder=4,
                    )
            axes.plot(profile.optimum_value, row, "|", color=BLACK, markersize=11, label="best fit")
            verdict = profile.verdict.value.replace("_", " ")
            axes.annotate(
                f"{profile.optimum_value:.3g} {profile.unit}, {verdict}",
                (1.01, row),
                xycoords=("axes fraction", "data"),
                va="center",
                fontsize=8,
            )
            true = (truth or {}).get(profile.name)
            if true is not None:
                axes.plot(true, row, "x", color=COLOURS[1], markersize=6, label="truth", zorder=4)
        axes.set_yticks(range(len(group)), [label_without_unit(x.name) for x in group])
        axes.set_ylim(len(group) - 0.5, -0.5)
        axes.set_xlabel(f"[{unit}]" if unit else "", fontsize=8)
        axes.grid(axis="x", color="0.92")
        axes.set_axisbelow(True)
        _plain(axes)
        axes.tick_params(labelsize=8)
    handles, labels = grid[0].get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(
        named.values(), list(named), loc="outside upper center", ncols=6, frameon=False, fontsize=8
    )
    return figure


def smooth_edge(edge: Array) -> Array:
    """Many points on a closed smooth curve through the edge of a set, shape ``(k, 2)``.

    An edge with gaps, where NaN stands, is given back as it is, closed.
    """
    closed = np.vstack([edge, edge[:1]])
    if not np.isfinite(edge).all():
        return closed
    steps = np.arange(len(closed))
    curve = scipy.interpolate.CubicSpline(steps, closed, bc_type="periodic")
    return np.asarray(curve(np.linspace(0, len(edge), PER_SEGMENT * len(edge) + 1)))


def nested(profile: Profile) -> dict[float, tuple[Interval, ...]]:
    """Sets of values not excluded by level, from low levels to the profile's own."""
    levels = [x for x in LEVELS if x < profile.level]
    return {level: profile.intervals_at(level) for level in (*levels, profile.level)}


def _drawn(interval: Interval, profile: Profile) -> tuple[float, float]:
    """The interval with the places reached for its open ends."""
    low, high = interval
    return (
        profile.lower_side.reached if low is None else low,
        profile.upper_side.reached if high is None else high,
    )


def _panels(n: int, height: float) -> tuple[Figure, list[Axes]]:
    columns = min(n, COLUMNS)
    rows = -(-n // columns)
    figure = Figure(figsize=(2.5 * columns + 0.5, height * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    panels = list(grid.ravel())
    for unused in panels[n:]:
        unused.set_visible(False)
    return figure, panels


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=7)
