"""Figures of a fit: laxity along load curves with bands around it, measured forces, and limits."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from identknee.checks.data_noise import Curve, load_curves
from identknee.checks.fit_checks import ComparedForces
from identknee.checks.limit_price import PlausibilityPrice
from identknee.laxity.protocol import LOADS, Protocol, as_shown
from identknee.laxity.table import COORDINATES
from identknee.laxity.trial_words import UNLOADED, load_label, loads_words, series_words
from identknee.report.figures import (
    ALL_FITS,
    BLACK,
    COLOURS,
    FIT,
    MEASURED,
    SMALL,
    STYLES,
    Figure,
    bare,
    legend_below,
    one_panel,
    panel_grid,
    panel_rows,
    rows_down,
    wrapped,
)
from identknee.runs.declare import Array, BoolArray, IntArray, declared, entry, frozen
from identknee.runs.words import label, unit_of

MOST_PANELS, MOST_TRIALS, IN_A_ROW = 12, 24, 3


def compared_forces_figure(forces: ComparedForces) -> Figure:
    """Measured and predicted forces by trial, a panel for each kind of them.

    Dots are measured, their bars two standard deviations. Of many the panels, and the trials of a
    panel, are shown in which both differ most.
    """
    names, away = np.array(forces.names), np.abs(forces.measured - forces.predicted) / forces.sd
    away = np.nan_to_num(away)
    kinds = list(dict.fromkeys(forces.names))
    worst = sorted(kinds, key=lambda x: -float(away[names == x].max()))[:MOST_PANELS]
    kinds = [x for x in kinds if x in worst]
    rows = [np.flatnonzero(names == x) for x in kinds]
    rows = [np.sort(x[np.argsort(-away[x], kind="stable")[:MOST_TRIALS]]) for x in rows]
    size = (3.2, 0.9 + 0.2 * max(map(len, rows)))
    figure, panels = panel_rows(len(kinds), size, (1.2, 0.6), IN_A_ROW)
    for axes, kind, own in zip(panels, kinds, rows, strict=True):
        places = np.arange(len(own))
        axes.errorbar(
            forces.measured[own], places, xerr=2.0 * forces.sd[own], fmt="o", color=MEASURED,
            markersize=3.5, elinewidth=0.9, label="measured",
        )  # fmt: skip
        axes.plot(
            forces.predicted[own], places, "s", color=FIT, markersize=6.0,
            markerfacecolor="none", label="predicted by the fit",
        )  # fmt: skip
        rows_down(axes, [forces.trials[i] for i in own])
        axes.set_xlabel(label(kind), fontsize=SMALL + 1)
        bare(axes, grid="y", labelsize=SMALL)
    legend_below(figure, *panels[0].get_legend_handles_labels())
    return figure


GREY = "0.85"
# Values beyond so many times the limit are drawn at the edge.
MOST = 3.0


def plausibility_figure(price: PlausibilityPrice) -> Figure:
    """Values of the fit and of that without limits, a row for each limit, as shares of the limit.

    Values beyond three times a limit stand at the edge with their number.
    """
    rows = price.limits
    figure, axes = one_panel(6.6, 1.3 + 0.3 * len(rows))
    places = np.arange(len(rows))
    for place, x in enumerate(rows):
        limit = x.limit
        low = 1.0 if limit.form == "within" else 1.0 - limit.spread / limit.size
        axes.plot(
            [low, 1.0 + limit.spread / limit.size], [place, place], color=GREY, linewidth=9.0,
            solid_capstyle="butt", zorder=1, label="limit" if place == 0 else None,
        )  # fmt: skip
    # What lies beyond the figure by row, both fits in one text: they may be alike.
    beyond: dict[int, list[str]] = {}
    for name, values, filled in (
        ("fit without limits", [x.value_without for x in rows], "none"),
        ("fit with limits", [x.limit.value for x in rows], COLOURS[0]),
    ):
        sizes = np.array([x.limit.size for x in rows])
        # A slack ligament has no strain.
        is_signed = np.array([x.limit.form != "within" for x in rows])
        shares = np.where(is_signed, np.maximum(values, 0.0), np.abs(values)) / sizes
        axes.plot(
            np.minimum(shares, MOST), places, "o", color=COLOURS[0], markerfacecolor=filled,
            markersize=6.0, label=name, zorder=3, clip_on=False,
        )  # fmt: skip
        for place in np.flatnonzero(shares > MOST).tolist():
            beyond.setdefault(place, []).append(f"{abs(values[place]):.0f}")
    for place, texts in beyond.items():
        axes.annotate(
            ", ".join(dict.fromkeys(texts)), (MOST, place), (-6.0, 0.0), fontsize=SMALL,
            textcoords="offset points", ha="right", va="center", color=BLACK,
        )  # fmt: skip
    axes.axvline(1.0, color=BLACK, linewidth=0.8, zorder=2)
    rows_down(axes, [_words(x.limit.name, x.limit.size) for x in rows])
    axes.set_xlim(0.0, MOST)
    axes.set_xlabel("share of the limit", fontsize=SMALL + 1)
    bare(axes, grid="x", labelsize=SMALL)
    legend_below(figure, *axes.get_legend_handles_labels())
    return figure


def _words(name: str, size: float) -> str:
    """A limit in words, with its size.

    Examples
    --------
    >>> _words("MCL.tension_N", 557.0), _words("ACL.strain_pct", 15.0)
    ('MCL force (557 N)', 'ACL strain (15 %)')
    """
    what, _, load = name.partition("@")
    owner, _, kind = what.partition(".")
    if owner == "contact":
        which = name.partition(", ")[2]
        return f"contact, medial − lateral{f', {which}' if which else ''} ({size:g} N)"
    under = f" under {load}" if load else ""
    named = "force" if kind.startswith("tension") else "strain"
    return f"{owner} {named}{under} ({size:g} {'N' if named == 'force' else '%'})"


# The coordinate that moves along each load.
ALONG = {
    "internal_moment_Nm": "internal_deg",
    "varus_moment_Nm": "varus_deg",
    "anterior_force_N": "anterior_drawer_mm",
    "distraction_force_N": "distraction_mm",
    "lateral_force_N": "lateral_shift_mm",
}


@declared
class LaxityCurves:
    """Laxity of n trials by its sources, in `COORDINATES` [mm, deg]."""

    protocol: Protocol = entry("The trials")
    simulated: Mapping[str, Array] = entry(
        "Simulated laxity by name of the model, shape ``(n, 5)``; NaN where it has no equilibrium"
    )
    measured: Array | None = entry(
        "Measured laxity, shape ``(n, 5)``; NaN where nothing was measured. None without data",
        default=None,
    )
    sd: Array | None = entry(
        "Standard deviation of the measurement, in the same shape; None where it is not stated",
        default=None,
    )
    band: tuple[str, Array] | None = entry(
        "Name of a band, and the lowest and highest prediction, shape ``(2, n, 5)``; None without "
        "one",
        default=None,
    )

    def __post_init__(self) -> None:
        shape = (self.protocol.n, len(COORDINATES))
        checked = {name: frozen(x, *shape, name=name) for name, x in self.simulated.items()}
        object.__setattr__(self, "simulated", checked)
        for name in ("measured", "sd"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name), *shape, name=name))

    def select(self, trials: IntArray) -> "LaxityCurves":
        """Those of some trials, in their order."""
        return LaxityCurves(
            protocol=self.protocol.select(trials),
            simulated={name: x[trials] for name, x in self.simulated.items()},
            measured=None if self.measured is None else self.measured[trials],
            sd=None if self.sd is None else self.sd[trials],
            band=None if self.band is None else (self.band[0], self.band[1][:, trials]),
        )

    def on_curves(self) -> BoolArray:
        """Which trials are of an experiment and a state most of whose trials make up load curves.

        Angles that a rig reads a little apart are one.
        """
        series, is_on = self.protocol.series, np.zeros(self.protocol.n, dtype=bool)
        for curve in load_curves(as_shown(self.protocol)):
            is_on[curve.trials] = True
        share = np.bincount(series, weights=is_on) / np.bincount(series)
        return np.asarray(share[series] > 0.5)

    def parts(self) -> "tuple[LaxityCurves | None, dict[str, LaxityCurves]]":
        """All trials that make up load curves, if any, and by its words each other experiment.

        States of the knee are apart from one another too.
        """
        is_on, series = self.on_curves(), self.protocol.series
        others = {}
        for x in np.unique(series[~is_on]):
            trials = np.flatnonzero((series == x) & ~is_on)
            words = ", ".join(series_words(self.protocol, int(trials[0])))
            others[words] = self.select(trials)
        return self.select(np.flatnonzero(is_on)) if is_on.any() else None, others


def along_load_figure(curves: LaxityCurves) -> Figure | None:
    """The coordinate along each load against that load, a row a load and a column an angle.

    Dots are measured, their bars two standard deviations; None where no angle has three loads of
    one kind.
    """
    # Of several curves of one load and setting the one with the least of the other loads.
    cells = {(axis, setting): x for (axis, setting, _), x in reversed(_in_order(curves))}
    if not cells:
        return None
    rows = sorted({axis for axis, _ in cells})
    settings = sorted({x for _, x in cells})
    size = (1.0 + 2.7 * len(settings), 0.7 + 2.5 * len(rows))
    figure, grid = panel_grid(*size, len(rows), len(settings), sharex="row", sharey="row")
    for row, axis in enumerate(rows):
        coordinate = COORDINATES.index(ALONG[LOADS[axis]])
        for column, setting in enumerate(settings):
            axes = grid[row, column]
            if (axis, setting) not in cells:
                axes.set_visible(False)
                continue
            _draw(axes, curves, cells[axis, setting], coordinate)
            axes.set_xlabel(load_label(axis), fontsize=SMALL + 1)
            if not any(x.get_visible() for x in grid[:row, column]):
                axes.set_title(_title(curves.protocol, setting), fontsize=10)
        first = next(x for x in grid[row] if x.get_visible())
        first.set_ylabel(label(COORDINATES[coordinate]), fontsize=SMALL + 1)
        first.tick_params(labelleft=True)
    shown = next(x for x in grid.flat if x.get_visible())
    legend_below(figure, *shown.get_legend_handles_labels(), columns=9)
    return figure


def all_coordinates_figure(curves: LaxityCurves, title: str = "") -> Figure | None:
    """Every coordinate along every load curve, a column a curve; None where there is none."""
    columns, rows = _in_order(curves), _known_coordinates(curves)
    if not columns:
        return None
    size = (1.2 + 1.9 * len(columns), 1.0 + 1.6 * len(rows))
    figure, grid = panel_grid(*size, len(rows), len(columns), sharex="col", sharey="row")
    for column, ((axis, setting, _), curve) in enumerate(columns):
        for axes, i in zip(grid[:, column], rows, strict=True):
            _draw(axes, curves, curve, i)
        loads = as_shown(curves.protocol).loads[curve.trials[0]]
        beside = loads_words(loads * (np.arange(len(LOADS)) != axis), "{what} {size:.3g} {unit}")
        heads = [_title(curves.protocol, setting), *(wrapped(x, 22) for x in beside)]
        grid[0, column].set_title("\n".join(heads), fontsize=SMALL + 1)
        grid[-1, column].set_xlabel(load_label(axis), fontsize=SMALL)
    for axes, i in zip(grid[:, 0], rows, strict=True):
        axes.set_ylabel(label(COORDINATES[i]), fontsize=SMALL)
    legend_below(figure, *grid[0, 0].get_legend_handles_labels(), columns=9)
    if title:
        figure.suptitle(title, fontsize=SMALL + 2)
    return figure


# Of as many angles each has a tick; of more combinations of loads those with the most trials.
MOST_TICKS, MOST_COLUMNS = 8, 6
ALONG_GROUND = (COLOURS[4], 0.13)


class _Way(NamedTuple):
    """How a direction of load is drawn, and the sign that stands before its name."""

    sign: str
    marker: str
    line: str
    is_filled: bool = True


# Two directions of each load, then further combinations.
WAYS = (
    _Way("●", "o", "-"),
    _Way("○", "o", "--", is_filled=False),
    _Way("■", "s", "-."),
    _Way("□", "s", ":", is_filled=False),
)
WITHOUT_LOAD = _Way("×", "x", ":")
LOST = "no equilibrium"


def by_load_figure(curves: LaxityCurves, title: str = "") -> Figure:
    """Every coordinate against flexion, a column a load and both of its directions in one panel.

    For trials that make up no load curves. Dots are measured, their bars two standard deviations;
    lines are simulated, and break where there is no equilibrium. Above a panel stands the error of
    what is simulated. A coordinate that moves along the load has a tinted ground.
    """
    shown = as_shown(curves.protocol)
    whole = _load_columns(shown)
    kept = sorted(whole, key=lambda x: -sum(map(len, whole[x].values())))[:MOST_COLUMNS]
    columns = {k: x for k, x in whole.items() if k in kept}
    rows = _known_coordinates(curves)
    size = (1.3 + 2.1 * len(columns), 1.3 + 1.25 * len(rows))
    figure, grid = panel_grid(*size, len(rows), len(columns), sharex=True, sharey="row")
    for column, (acting, directions) in enumerate(columns.items()):
        along = [COORDINATES.index(ALONG[LOADS[x]]) for x in acting]
        heads = []
        for k, (words, trials) in enumerate(directions.items()):
            way = WITHOUT_LOAD if words == UNLOADED else WAYS[k % len(WAYS)]
            heads.append(f"{way.sign} {words}")
            for axes, i in zip(grid[:, column], rows, strict=True):
                _draw_way(axes, curves, trials, way, i)
        for axes, i in zip(grid[:, column], rows, strict=True):
            own = np.concatenate(list(directions.values()))
            axes.text(
                1.0, 1.02, _error_words(curves, own, i), transform=axes.transAxes, ha="right",
                va="bottom", fontsize=SMALL - 1,
            )  # fmt: skip
            bare(axes, labelsize=SMALL)
            if i in along:
                axes.set_facecolor(ALONG_GROUND)
        grid[0, column].set_title("\n".join(heads), fontsize=SMALL + 1, loc="left", pad=14.0)
        grid[-1, column].set_xlabel("flexion [deg]", fontsize=SMALL + 1)
    angles = np.unique(shown.flexion_deg)
    if angles.size <= MOST_TICKS:
        grid[0, 0].set_xticks(angles)
    for axes, i in zip(grid[:, 0], rows, strict=True):
        axes.set_ylabel(wrapped(label(COORDINATES[i]), 18), fontsize=SMALL + 1)
    figure.align_ylabels(grid[:, 0].tolist())
    shares = f"{len(columns)} of {len(whole)} combinations of loads"
    titles = [x for x in (title, shares * (len(whole) > len(columns))) if x]
    if titles:
        figure.suptitle(", ".join(titles), fontsize=SMALL + 2)
    legend_below(figure, _keys(curves), columns=4)
    return figure


def _load_columns(shown: Protocol) -> dict[tuple[int, ...], dict[str, IntArray]]:
    """By the loads that act together, the trials of each direction in the order of flexion.

    The positive direction stands first. Trials without load are in every column.
    """
    found: dict[tuple[int, ...], dict[tuple[float, ...], list[int]]] = {}
    for trial, loads in enumerate(shown.loads):
        acting = tuple(np.flatnonzero(loads).tolist())
        found.setdefault(acting, {}).setdefault(tuple(np.sign(loads).tolist()), []).append(trial)
    unloaded = found.pop((), {})

    def ordered(trials: Sequence[int]) -> IntArray:
        return np.array(trials)[np.argsort(shown.flexion_deg[trials], kind="stable")]

    neutral = dict(zip([UNLOADED], map(ordered, unloaded.values()), strict=False))
    columns = {}
    for acting, directions in sorted(found.items()):
        named = {}
        for _, trials in sorted(directions.items(), reverse=True):
            sizes = np.median(shown.loads[trials], axis=0)
            words = ", ".join(loads_words(sizes, "{what} {size:.3g} {unit}", is_short=True))
            named[wrapped(words, 24)] = ordered(trials)
        columns[acting] = named | neutral
    return columns or {(): neutral}


def _drawn_values(curves: LaxityCurves) -> list[Array]:
    measured = [] if curves.measured is None else [curves.measured]
    return [*curves.simulated.values(), *measured]


def _draw_way(axes: Axes, curves: LaxityCurves, trials: IntArray, way: _Way, i: int) -> None:
    """A coordinate of the trials of one direction of load."""
    flexion = curves.protocol.flexion_deg[trials]
    if curves.band is not None:
        low, high = curves.band[1][:, trials, i]
        axes.vlines(flexion, low, high, color=ALL_FITS, alpha=0.5, linewidth=6.0)
    for k, values in enumerate(curves.simulated.values()):
        axes.plot(
            flexion, values[trials, i], way.line, marker=way.marker, markersize=2.0,
            color=COLOURS[k], linewidth=1.4,
        )  # fmt: skip
    if curves.measured is None:
        return
    measured = curves.measured[trials, i]
    bars = None if curves.sd is None else 2.0 * curves.sd[trials, i]
    axes.errorbar(
        flexion, measured, yerr=bars, fmt=way.marker, color=MEASURED, markersize=3.5,
        markerfacecolor=MEASURED if way.is_filled else "none", elinewidth=0.8,
    )  # fmt: skip
    lost = _is_lost(curves)[trials, i]
    axes.plot(flexion[lost], measured[lost], "x", color=COLOURS[1], markersize=8.0, zorder=5)


def _is_lost(curves: LaxityCurves) -> BoolArray:
    """Which measured values have none in the first model, shape ``(n, 5)``."""
    if curves.measured is None or not curves.simulated:
        return np.zeros((curves.protocol.n, len(COORDINATES)), dtype=bool)
    fit = next(iter(curves.simulated.values()))
    return np.asarray(np.isnan(fit) & ~np.isnan(curves.measured))


def _error_words(curves: LaxityCurves, trials: IntArray, i: int) -> str:
    """The root-mean-square error of every model in a panel; empty without data."""
    if curves.measured is None:
        return ""
    errors = []
    for values in curves.simulated.values():
        away = values[trials, i] - curves.measured[trials, i]
        away = away[np.isfinite(away)]
        errors.append(f"{np.sqrt(np.mean(away**2)):.1f}" if away.size else "-")
    unit = unit_of(COORDINATES[i])
    return f"RMSE {', '.join(errors)} {unit}" if set(errors) - {"-"} else ""


def _keys(curves: LaxityCurves) -> list[Artist]:
    """What the colours mean, once for both directions of all loads."""
    keys: list[Artist] = [
        Line2D([], [], color=COLOURS[k], linewidth=1.4, label=name)
        for k, name in enumerate(curves.simulated)
    ]
    if curves.band is not None:
        keys.append(Line2D([], [], color=ALL_FITS, alpha=0.5, linewidth=6.0, label=curves.band[0]))
    if curves.measured is not None:
        bars = "" if curves.sd is None else " ± 2 sd"
        dots = Line2D([], [], color=MEASURED, linestyle="", marker="o", markersize=3.5)
        dots.set_label(f"measured{bars}")
        keys.append(dots)
        if _is_lost(curves).any():
            keys.append(
                Line2D([], [], color=COLOURS[1], linestyle="", marker="x", markersize=8, label=LOST)
            )
    return keys


# Number of the experiment and state of trials, and their flexion angle.
Setting = tuple[int, float]


def _title(protocol: Protocol, setting: Setting) -> str:
    """Angle of the trials of a panel, and where there are several their experiment and state."""
    number, angle = setting
    trial = int(np.flatnonzero(protocol.series == number)[0])
    return "\n".join([f"{angle:g} deg flexion", *series_words(protocol, trial)])


def _known_coordinates(curves: LaxityCurves) -> list[int]:
    """Places of the coordinates that were measured or simulated in any trial."""
    is_known = np.any([np.isfinite(x).any(axis=0) for x in _drawn_values(curves)], axis=0)
    return np.flatnonzero(is_known).tolist()


def _in_order(curves: LaxityCurves) -> list[tuple[tuple[int, Setting, float], Curve]]:
    """Load curves after the place of their load, their setting and the largest of the other loads.

    Without those of trials that were not measured and have no equilibrium in any model.
    """
    found = []
    series, protocol = curves.protocol.series, as_shown(curves.protocol)
    for curve in load_curves(protocol):
        if any(np.isfinite(x[curve.trials]).any() for x in _drawn_values(curves)):
            first, loads = curve.trials[0], protocol.loads[curve.trials]
            axis = int(np.argmax(np.ptp(loads, axis=0)))
            setting = int(series[first]), float(protocol.flexion_deg[first])
            others = float(np.abs(np.delete(loads, axis, axis=1)).max(initial=0.0))
            found.append(((axis, setting, others), curve))
    return sorted(found, key=lambda x: x[0])


def _draw(axes: Axes, curves: LaxityCurves, curve: Curve, i: int) -> None:
    trials = curve.trials
    if curves.band is not None:
        name, (low, high) = curves.band
        axes.fill_between(
            curve.load, low[trials, i], high[trials, i], color=ALL_FITS, alpha=0.4,
            linewidth=0, label=name,
        )  # fmt: skip
    for k, (name, values) in enumerate(curves.simulated.items()):
        axes.plot(
            curve.load, values[trials, i], STYLES[k], color=COLOURS[k], linewidth=1.6, label=name
        )
    if curves.measured is not None:
        bars = None if curves.sd is None else 2.0 * curves.sd[trials, i]
        axes.errorbar(
            curve.load, curves.measured[trials, i], yerr=bars, fmt="o", color=MEASURED,
            markersize=3.0, elinewidth=0.8, label="measured",
        )  # fmt: skip
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    bare(axes, labelsize=SMALL)
