"""Figures of parameters: profiles, posterior, information, equivalents, results side by side."""

from collections.abc import Mapping, Sequence
from itertools import cycle, pairwise

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike
from scipy.stats import gaussian_kde

from identknee.identify.information import Information
from identknee.identify.profile.result import Interval, Profile, SideStatus, cubic
from identknee.report.comparison import ComparedMisfit, ComparedQuantity
from identknee.report.figures import (
    ALL_FITS,
    BLACK,
    COLOURS,
    FIT,
    GREY,
    MARKERS,
    SMALL,
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
from identknee.runs import words
from identknee.runs.declare import Array
from identknee.runs.words import label_without_unit, listed

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
    figure, panels = panel_rows(len(profiles), (2.5, 2.7), (0.5, 0.4), COLUMNS)
    for axes, profile in zip(panels, profiles, strict=False):
        top = HEADROOM * profile.threshold
        for branch in np.unique(profile.branches):
            here = profile.branches == branch
            marker, colour, _ = _branch_look(int(branch))
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
            axes.axvspan(low, high, color=ALL_FITS, alpha=0.18, linewidth=0)
            for end, place, turn in ((interval[0], low, -1), (interval[1], high, 1)):
                if end is None:
                    axes.annotate(
                        "open",
                        (place, 0.55 * profile.threshold),
                        fontsize=7,
                        ha="left" if turn < 0 else "right",
                    )
        axes.set_ylim(-0.05 * top, top)
        quantity, at, trial = profile.name.partition("@")
        unit = f" [{profile.unit}]" if profile.unit else ""
        where = f"\nin {trial}" if at else ""
        head = f"{label_without_unit(quantity)}{where}{unit}"
        axes.set_title(f"{head}\n{wrapped(profile.verdict_words, 30)}", fontsize=8)
        bare(axes, labelsize=7)
    for axes in panels[::COLUMNS]:
        axes.set_ylabel("rise of deviance")
    levels = listed(f"{100 * x:g} %" for x in sorted({x.level for x in profiles}))
    branches = np.unique(np.concatenate([x.branches for x in profiles])).tolist()
    handles: list[Artist] = [
        Line2D([], [], color=colour, marker=marker, markersize=3.5, linewidth=1.2, label=name)
        for branch in branches
        for marker, colour, name in [_branch_look(branch)]
    ]
    handles += [
        Line2D(
            [], [], color=GREY, linestyle="--", linewidth=0.9, label=f"limit of the {levels} set"
        ),
        Line2D([], [], color=ALL_FITS, alpha=0.4, linewidth=6.0, label="values not excluded"),
    ]
    legend_below(figure, handles, columns=4, fontsize=SMALL)
    return figure


def _branch_look(branch: int) -> tuple[str, str, str]:
    """Marker, colour and name of a path of a profile; the first is that of the best fit."""
    name = "from the best fit" if branch == 0 else f"from local optimum {branch + 1}"
    return MARKERS[branch % len(MARKERS)], COLOURS[branch % len(COLOURS)], name


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
    names, units = [x.name for x in profiles], [x.unit for x in profiles]
    figure, panels = _unit_panels(names, units, row=0.3, around=0.75)
    for axes, places in panels:
        for row, profile in enumerate(profiles[i] for i in places):
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
                    shape, word = ("X", "the model ends") if is_model else (marker, "open")
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
            axes.annotate(
                f"{words.amount(profile.optimum_value, profile.unit)}, {profile.verdict_words}",
                (1.01, row),
                xycoords=("axes fraction", "data"),
                va="center",
                fontsize=8,
            )
            true = (truth or {}).get(profile.name)
            if true is not None:
                axes.plot(true, row, "x", color=BLACK, markersize=6, label="truth", zorder=4)
    _legend_above(figure, panels[0][0], columns=6, fontsize=SMALL)
    return figure


def _unit_panels(
    names: Sequence[str], units: Sequence[str], *, row: float, around: float
) -> tuple[Figure, list[tuple[Axes, list[int]]]]:
    """A panel for each unit with a row for each quantity that has it, and the places of these.

    A row and the room around those of a panel are in inches.
    """
    groups = {unit: [i for i, x in enumerate(units) if x == unit] for unit in dict.fromkeys(units)}
    height = 0.5 + around * len(groups) + row * len(names)
    heights = [len(x) + 0.6 for x in groups.values()]
    figure, grid = panel_grid(8.2, height, len(groups), 1, height_ratios=heights)
    for axes, (unit, own) in zip(grid[:, 0], groups.items(), strict=True):
        rows_down(axes, [label_without_unit(names[i]) for i in own], 0.5)
        axes.set_xlabel(f"[{unit}]" if unit else "", fontsize=SMALL)
        bare(axes, grid="x", labelsize=SMALL)
    return figure, list(zip(grid[:, 0], groups.values(), strict=True))


# Height of a row for each result [inches].
ROW = 0.17
# Share of the axis beyond all estimates and ends that an open end reaches.
BEYOND = 0.06


def forest_figure(quantities: Sequence[ComparedQuantity], names: Sequence[str]) -> Figure:
    """Estimates and sets of quantities, a colour and a marker for each result.

    Quantities of one unit share an axis. An open end is an arrow at the edge.

    Parameters
    ----------
    quantities
        Of any results.
    names
        Of the results, in their order.
    """
    n, units = len(names), [words.unit_of(x.name) for x in quantities]
    figure, panels = _unit_panels(
        [x.name for x in quantities], units, row=0.12 + ROW * n, around=0.75
    )
    for axes, places in panels:
        group = [quantities[i] for i in places]
        ends = [
            y
            for x in group
            for z in x.stands
            for y in (z.estimate, z.lower, z.upper)
            if y is not None
        ]
        low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
        room = BEYOND * (high - low or 1.0)
        for row, quantity in enumerate(group):
            for stand in quantity.stands:
                k = names.index(stand.name)
                place = row + 0.7 * ((k + 0.5) / n - 0.5)
                colour = COLOURS[k % len(COLOURS)]
                if stand.has_set:
                    left = low - room if stand.lower is None else stand.lower
                    right = high + room if stand.upper is None else stand.upper
                    axes.plot([left, right], [place, place], color=colour, linewidth=1.6)
                    for end, at, shape in ((stand.lower, left, "<"), (stand.upper, right, ">")):
                        if end is None:
                            axes.plot(at, place, shape, color=colour, markersize=5)
                if stand.estimate is not None:
                    axes.plot(
                        stand.estimate, place, MARKERS[k % len(MARKERS)], color=colour,
                        markersize=5, markerfacecolor=colour if stand.has_set else "white",
                    )  # fmt: skip
        axes.set_xlim(low - 2.0 * room, high + 2.0 * room)
    handles = [
        Line2D([], [], color=colour, marker=marker, markersize=5, linewidth=1.6, label=name)
        for name, colour, marker in zip(names, cycle(COLOURS), cycle(MARKERS), strict=False)
    ]
    legend_below(figure, handles, columns=4)
    return figure


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


BINS = 20
GRID = 200
# Shares of the draws inside the contours of a pair.
SHARES = (0.5, 0.95)


def prior_posterior_figure(
    names: Sequence[str],
    prior: Array,
    posteriors: "dict[str, Array]",
    *,
    truth: ArrayLike | None = None,
) -> Figure:
    """Density of each parameter before and after the data.

    Parameters
    ----------
    names
        Parameters.
    prior
        Draws of the prior, shape ``(k, n)``.
    posteriors
        Draws of one or more posteriors by name, shape ``(k, n)`` each.
    truth
        Known theta, shape ``(n,)``.
    """
    figure, panels = panel_rows(len(names), (2.2, 2.2), (0.6, 0.6), COLUMNS)
    for i, (axes, name) in enumerate(zip(panels, names, strict=True)):
        grid = np.linspace(*_range(prior[:, i], *(x[:, i] for x in posteriors.values())), GRID)
        before = gaussian_kde(prior[:, i])(grid)
        axes.fill_between(grid, before, color="0.85", linewidth=0, label="prior")
        for k, (label, draws) in enumerate(posteriors.items()):
            after = gaussian_kde(draws[:, i])(grid)
            axes.plot(grid, after, STYLES[k], color=COLOURS[k], linewidth=1.6, label=label)
        if truth is not None:
            axes.axvline(
                float(np.asarray(truth)[i]), color=BLACK, linewidth=1.0, label="true value"
            )
        axes.set_xlabel(words.label(name), fontsize=SMALL)
        axes.set_yticks([])
        axes.set_ylim(bottom=0.0)
        axes.tick_params(labelsize=SMALL)
        axes.spines[["top", "right", "left"]].set_visible(False)
    _legend_above(figure, panels[0])
    return figure


def corner_figure(names: Sequence[str], draws: Array, *, truth: ArrayLike | None = None) -> Figure:
    """Every pair of parameters with regions of 50 and 95 % of the draws, each on the diagonal.

    Parameters
    ----------
    names
        Parameters.
    draws
        Nearly independent draws, shape ``(k, n)``.
    truth
        Known theta, shape ``(n,)``.
    """
    n = len(names)
    known = None if truth is None else np.asarray(truth, float)
    figure, grid = panel_grid(1.0 + 1.06 * n, 1.0 + 0.96 * n, n, n, sharex="col")
    for row in range(n):
        for column in range(n):
            axes = grid[row, column]
            if column > row:
                axes.set_visible(False)
                continue
            if column == row:
                axes.hist(draws[:, row], BINS, color=COLOURS[0], alpha=0.5)
                axes.set_yticks([])
            else:
                across, up = draws[:, column], draws[:, row]
                points = np.vstack([across, up])
                estimate = gaussian_kde(points)
                levels = np.quantile(
                    estimate(points), [1.0 - share for share in sorted(SHARES, reverse=True)]
                )
                x, y = np.linspace(*_range(across), 50), np.linspace(*_range(up), 50)
                density = estimate(np.array(np.meshgrid(x, y)).reshape(2, -1)).reshape(50, 50)
                axes.plot(across, up, ".", color=GREY, markersize=1.0, alpha=0.5)
                axes.contour(x, y, density, levels=levels, colors=COLOURS[0], linewidths=0.9)
            if known is not None:
                axes.axvline(known[column], color=BLACK, linewidth=0.8)
                if column < row:
                    axes.axhline(known[row], color=BLACK, linewidth=0.8)
            axes.tick_params(labelsize=6)
            if row == n - 1:
                axes.set_xlabel(_on_lines(names[column]), fontsize=7)
            if column == 0 and row > 0:
                axes.set_ylabel(_on_lines(names[row]), fontsize=7)
            elif column < row:
                axes.set_yticklabels([])
    return figure


# Panels of ligaments side by side.
MOST_ACROSS = 5


def forces_figure(
    trials: Sequence[str], ligaments: Sequence[str], quantiles: Array, *, truth: Array | None = None
) -> Figure:
    """How far each tension may be from its median: half and 95 % of the posterior, by trial.

    Parameters
    ----------
    trials
        Names.
    ligaments
        Names.
    quantiles
        Tension [N] at 2.5, 25, 50, 75 and 97.5 %, shape ``(trials, ligaments, 5)``. The medians
        stand beside their bars.
    truth
        Known tension [N], shape ``(trials, ligaments)``.
    """
    n, rows = len(ligaments), np.arange(len(trials))
    size = 2.3, 0.28 * len(trials) + 0.5
    figure, panels = panel_rows(n, size, (1.6, 0.9), MOST_ACROSS, sharey=True, sharex=True)
    for j, axes in enumerate(panels):
        middle = quantiles[:, j, 2]
        low, first, _, third, high = (quantiles[:, j] - middle[:, None]).T
        axes.hlines(rows, low, high, color=COLOURS[0], linewidth=1.2, label="95 %")
        axes.hlines(rows, first, third, color=COLOURS[0], linewidth=4.5, label="50 %")
        if truth is not None:
            known = truth[:, j] - middle
            axes.plot(known, rows, "x", color=BLACK, markersize=5, label="true value")
        for row, median in zip(rows, middle, strict=True):
            axes.annotate(
                f"{median:.0f} N",
                (1.0, row),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="center",
                fontsize=7,
                color=GREY,
            )
        axes.set_title(ligaments[j], fontsize=10)
        if j + MOST_ACROSS >= n:
            axes.set_xlabel("tension minus median [N]", fontsize=SMALL)
            axes.tick_params(labelbottom=True)
        bare(axes, grid="y", labelsize=SMALL)
    largest = float(np.max(np.abs(quantiles - quantiles[..., 2:3])))
    # Room for the medians on the right.
    panels[0].set_xlim(-1.1 * largest, 1.8 * largest)
    rows_down(panels[0], trials)
    _legend_above(figure, panels[0])
    return figure


def _range(*samples: Array) -> tuple[float, float]:
    low = min(float(np.quantile(x, 0.001)) for x in samples)
    high = max(float(np.quantile(x, 0.999)) for x in samples)
    margin = 0.04 * (high - low)
    return low - margin, high + margin


def _legend_above(
    figure: Figure, axes: Axes, *, columns: int | None = None, fontsize: int = 9
) -> None:
    """A legend of the whole figure above its panels, each label of this one once."""
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(
        named.values(),
        list(named),
        loc="outside upper center",
        ncols=columns or len(named),
        frameon=False,
        fontsize=fontsize,
    )


# Characters on a line below a small panel.
CORNER_LETTERS = 12


def _on_lines(name: str) -> str:
    """Whose parameter it is, and below that what it is with its unit."""
    owner, _, quantity = name.rpartition(".")
    return f"{owner}\n{wrapped(words.label(quantity), CORNER_LETTERS)}"


def spectrum_figure(found: Mapping[str, Information]) -> Figure:
    """Eigenvalues of the information from stiff to sloppy, each above its noise floor.

    Parameters
    ----------
    found
        Informations in the same units by name.
    """
    figure, axes = one_panel(1.6 + 2.0 * len(found), 4.4)
    for k, (name, each) in enumerate(found.items()):
        x = k + np.linspace(-0.3, 0.3, each.theta.size)
        axes.plot(x, each.eigenvalues, MARKERS[k], color=COLOURS[k], label=name)
        axes.plot(x, each.floors, "_", color=GREY, markersize=9)
        for place, value, floor in zip(x, each.eigenvalues, each.floors, strict=True):
            axes.plot([place, place], [floor, value], color="0.88", linewidth=1.0, zorder=0)
        sizes = f"{each.n_above_noise} of {each.theta.size} above noise\ncondition number"
        axes.annotate(
            f"{sizes} {each.condition:.3g}",
            (k, float(each.eigenvalues[0])),
            xytext=(0, 8),
            textcoords="offset points",
            ha="center",
            fontsize=SMALL,
        )
    axes.plot([], [], "_", color=GREY, markersize=9, label="noise floor")
    axes.set_yscale("log")
    axes.margins(y=0.12)
    axes.set_xticks(range(len(found)), list(found))
    axes.set_xlim(-0.6, len(found) - 0.4)
    scaling = next(iter(found.values())).scaling
    unit = {"typical": "typical step", "prior": "prior sd"}[scaling]
    axes.set_ylabel(f"eigenvalue of the information [per squared {unit}]")
    bare(axes, grid="y")
    return figure


def eigenvectors_figure(found: Information) -> Figure:
    """Share of every parameter in every eigenvector, from stiff to sloppy, as a heat map."""
    n = found.theta.size
    figure, axes = one_panel(2.6 + 0.62 * n, 2.2 + 0.42 * n)
    image = axes.imshow(found.eigenvectors, cmap="PuOr", vmin=-1.0, vmax=1.0, aspect="auto")
    for (i, j), share in np.ndenumerate(found.eigenvectors):
        if abs(share) >= 0.1:
            axes.text(
                *(j, i, number(share, "+.2f").replace("0.", ".")),
                ha="center",
                va="center",
                fontsize=SMALL,
                color="white" if abs(share) > 0.7 else "black",
            )
    axes.set_yticks(range(n), [label_without_unit(x) for x in found.parameter_names])
    axes.set_xticks(
        range(n),
        [
            (f"{value:.0f}" if 10.0 <= value < 1e5 else f"{value:.2g}")
            for value in found.eigenvalues
        ],
    )
    axes.set_xlabel("eigenvalue, stiff to sloppy")
    figure.colorbar(image, ax=axes, label="share of one scaled unit")
    return figure


def sets_figure(
    parameters: Sequence[str],
    sets: Array,
    fit: Array,
    laxity: Mapping[str, Array],
    *,
    origin: str = "the fit",
) -> Figure:
    """Parameter sets as lines over their axes, and below how little their laxity differs.

    Parameters
    ----------
    parameters
        Their names.
    sets
        Shape ``(n_sets, n)``. The two first, the farthest apart, are drawn bold.
    fit
        Shape ``(n,)``.
    laxity
        By name with unit, a coordinate's difference from the fit in every trial, shape
        ``(n, n_trials)``: of the same sets, or of these two and the band of all.
    origin
        What the laxity is compared with, where it is not the fit's.
    """
    figure = Figure(figsize=(8.6, 6.4), layout="constrained")
    grid = figure.add_gridspec(2, len(laxity), height_ratios=(1.25, 1.0))
    _parallel(figure.add_subplot(grid[0, :]), parameters, sets, fit)
    panels = [figure.add_subplot(grid[1, k]) for k in range(len(laxity))]
    for axes, (name, values) in zip(panels, laxity.items(), strict=True):
        trials = np.arange(1, values.shape[1] + 1)
        low, high = values.min(axis=0), values.max(axis=0)
        axes.fill_between(
            trials, low, high, step="mid", color=ALL_FITS, alpha=0.5, linewidth=0, label="all"
        )
        for k, values_of_set in enumerate(values[:2], start=1):
            axes.plot(trials, values_of_set, color=COLOURS[k], linewidth=1.0)
        axes.axhline(0.0, color=FIT, linewidth=1.0)
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        axes.set_xlabel("trial")
        axes.set_title(f"{wrapped(name, 18)}\nminus {origin}", fontsize=SMALL + 1)
        bare(axes)
    handles = [
        Line2D([], [], color=COLOURS[1], linewidth=2, label="one of the two sets farthest apart"),
        Line2D([], [], color=COLOURS[2], linewidth=2, label="the other"),
        Line2D([], [], color=FIT, marker="o", label="fit"),
        Line2D([], [], color=ALL_FITS, alpha=0.5, linewidth=6, label="all sets"),
    ]
    legend_below(figure, handles, columns=4)
    return figure


def ranges_figure(
    names: Sequence[str], at_fit: Array, ranges: Mapping[str, Array], *, unit: str
) -> Figure:
    """Smallest and largest value of quantities over regions, a bar each.

    Parameters
    ----------
    names
        Names of the quantities.
    at_fit
        Their values at the fit, shape ``(n,)``.
    ranges
        By name of the region, smallest and largest value, shape ``(n, 2)``.
    unit
        Unit of the quantities.
    """
    n, thickness = len(names), 0.8 / len(ranges)
    figure, axes = one_panel(7.6, 1.4 + n * (0.16 + 0.13 * len(ranges)))
    rows = np.arange(n)
    for k, (name, values) in enumerate(ranges.items()):
        y = rows - 0.4 + (k + 0.5) * thickness
        widths = values[:, 1] - values[:, 0]
        # Bars would pin the axis to their ends, and hide a mark that stands there.
        axes.use_sticky_edges = False
        colour = (ALL_FITS, *COLOURS[1:])[k]
        axes.barh(y, widths, 0.86 * thickness, values[:, 0], color=colour, label=name)
    for row, value in zip(rows, at_fit, strict=True):
        axes.plot([value, value], [row - 0.42, row + 0.42], color=FIT, linewidth=1.8)
    rows_down(axes, names, fontsize=SMALL)
    bare(axes, grid="x")
    axes.set_xlabel(unit)
    handles, _ = axes.get_legend_handles_labels()
    handles.append(Line2D([], [], color=FIT, linewidth=1.8, label="fit"))
    legend_below(figure, handles, columns=4)
    return figure


def _parallel(axes: Axes, parameters: Sequence[str], sets: Array, fit: Array) -> None:
    """Each parameter scaled from its smallest to its largest value among the sets."""
    low, high = sets.min(axis=0), sets.max(axis=0)
    width = np.where(high > low, high - low, 1.0)
    places = np.arange(len(parameters))
    for theta in sets[2:]:
        axes.plot(places, (theta - low) / width, color=ALL_FITS, linewidth=0.8, alpha=0.6)
    for k, theta in enumerate(sets[:2], start=1):
        axes.plot(places, (theta - low) / width, color=COLOURS[k], linewidth=2.2)
    axes.plot(places, (fit - low) / width, color=FIT, marker="o", markersize=4)
    for place, smallest, largest in zip(places.tolist(), low, high, strict=True):
        axes.axvline(place, color=GREY, linewidth=0.6, zorder=0)
        axes.text(place, -0.04, number(smallest), ha="center", va="top", fontsize=SMALL)
        axes.text(place, 1.03, number(largest), ha="center", va="bottom", fontsize=SMALL)
    axes.set_xticks(places, [_on_lines(name) for name in parameters], fontsize=SMALL)
    axes.tick_params(axis="x", pad=14, length=0)
    axes.set(yticks=[], ylim=(-0.02, 1.02), xlim=(-0.4, len(parameters) - 0.6))
    axes.spines[["top", "right", "bottom", "left"]].set_visible(False)


# Dark means a large index, in greyscale prints too.
MAP = "viridis_r"
# Panels side by side, and inches of them together, enough for the names in the legend.
MAPS_ACROSS, WIDTH = 2, 9.0


def effects_figure(
    panels: Mapping[str, tuple[Array, Array, Array]], parameters: Sequence[str]
) -> Figure:
    """Spread of elementary effects against their mean size, a panel a group of outputs.

    Parameters
    ----------
    panels
        By name of the group, mean absolute effect, the half-width of its confidence interval and
        the standard deviation of the effects, in the unit of the outputs, shape ``(p,)`` each.
    parameters
        Their names.
    """
    across = min(len(panels), MAPS_ACROSS)
    figure, grid = panel_rows(len(panels), (WIDTH / across, 3.2), (0.0, 0.6), across)
    for axes, (name, (size, half_width, spread)) in zip(grid, panels.items(), strict=True):
        # One trajectory has no spread and no interval.
        far = np.concatenate([size + np.nan_to_num(half_width), spread])
        top = 1.12 * float(far[np.isfinite(far)].max(initial=1e-12))
        axes.plot([0, top], [0, top], color=GREY, linewidth=0.8, linestyle=":")
        for i, parameter in enumerate(parameters):
            axes.errorbar(
                size[i],
                spread[i],
                xerr=half_width[i],
                fmt=MARKERS[i % len(MARKERS)],
                color=COLOURS[i % len(COLOURS)],
                fillstyle="full" if i < len(COLOURS) else "none",
                capsize=2,
                label=words.label(parameter),
            )
        axes.set(xlim=(0, top), ylim=(0, top))
        axes.set(xlabel="mean absolute effect, mu*", ylabel="sd of effects, sigma")
        axes.set_title(name, fontsize=10)
        bare(axes)
    legend_below(figure, *grid[0].get_legend_handles_labels(), columns=4, fontsize=SMALL)
    return figure


def map_figure(
    tables: Mapping[str, tuple[Sequence[str], Array]], parameters: Sequence[str], label: str
) -> Figure:
    """An index of every group of outputs to every parameter, a panel a coordinate.

    Parameters
    ----------
    tables
        By name of the coordinate, names of its rows and the index, shape ``(n_rows, p)``; NaN
        stays white.
    parameters
        Their names.
    label
        Name of the index.
    """
    rows = max(len(names) for names, _ in tables.values())
    n = len(tables)
    figure, grid = panel_rows(n, (2.1, 0.24 * rows), (1.8, 1.6), n)
    top = max(1.0, float(np.nanmax([np.nanmax(values) for _, values in tables.values()])))
    for column, (axes, (name, (names, values))) in enumerate(
        zip(grid, tables.items(), strict=True)
    ):
        image = axes.imshow(values, aspect="auto", cmap=MAP, vmin=0.0, vmax=top)
        axes.set_xticks(
            range(len(parameters)), [_short(x) for x in parameters], rotation=90, fontsize=SMALL
        )
        axes.set_yticks(range(len(names)), list(names) if column == 0 else [], fontsize=SMALL)
        axes.set_title(name, fontsize=9)
    figure.colorbar(image, ax=grid, label=label, shrink=0.8)
    return figure


def _short(parameter: str) -> str:
    """Owner and kind of a parameter: ``ACL stiffness`` for ``ACL.stiffness_kN``."""
    owner, _, kind = parameter.rpartition(".")
    letters = {"stiffness_kN": "stiffness", "reference_strain_pct": "strain"}
    return f"{owner} {letters.get(kind, kind)}"


def deviance_figure(misfits: Sequence[ComparedMisfit]) -> Figure:
    """Deviance of results as bars of their terms, one on another.

    Parameters
    ----------
    misfits
        Of results with a deviance, of the same data.
    """
    figure, axes = one_panel(7.2, 1.3 + 0.35 * len(misfits))
    terms = list(dict.fromkeys(y.name for x in misfits for y in x.terms))
    rows, begun = np.arange(len(misfits)), np.zeros(len(misfits))
    for k, term in enumerate(terms):
        sizes = [sum(y.deviance for y in x.terms if y.name == term) for x in misfits]
        axes.barh(rows, sizes, 0.6, begun, color=COLOURS[k % len(COLOURS)], label=term)
        begun = begun + sizes
    rows_down(axes, [x.name for x in misfits])
    axes.set_xlabel("deviance", fontsize=SMALL + 1)
    bare(axes, grid="x", labelsize=SMALL)
    legend_below(figure, *axes.get_legend_handles_labels(), columns=3)
    return figure
