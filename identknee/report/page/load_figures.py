"""Figures of what a knee carries in every trial: the knee itself, and one chart of all forces."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from identknee.laxity.protocol import Protocol, as_shown
from identknee.laxity.trial_words import load_scenarios
from identknee.mechanics.pose import Placement
from identknee.model.contact_loads import COMPARTMENTS
from identknee.report.figures import (
    BLACK,
    FIT,
    GREY,
    SMALL,
    Figure,
    bare,
    legend_below,
    number,
    panel_rows,
    rows_down,
    wrapped,
)
from identknee.report.page.viewer import KneeScene, Mesh, scene_at
from identknee.report.presenter import Drawing, Range, presenter_of
from identknee.report.results import Findings, Result
from identknee.report.scene import shaded, view_from
from identknee.runs.declare import Array, IntArray, declared, entry
from identknee.runs.record import Outcome
from identknee.subject.plausibility import TENSION, strengths_by_name
from identknee.verbs.answer import Answer
from identknee.verbs.fit import Calibration

# Mean and standard deviation of the load at which ligaments fail [N], by how their names begin.
Strengths = Mapping[str, tuple[float, float]]
IN_FRONT = view_from(20.0, 34.0)
# Of more angles or directions these are drawn, of more trials those nearest to failure.
MOST_ANGLES, MOST_DIRECTIONS, MOST_TRIALS = 5, 8, 40
PANEL = (1.3, 1.45)  # inches
BONE, BONE_OPACITY, AMBIENT = "#d8d4cc", 0.45, 0.6
TINY = 7
FAILED = "#4a0d5c"
CONVERGED = Outcome.CONVERGED


def strengths_of(scene: KneeScene) -> dict[str, tuple[float, float]]:
    """Strengths of the ligaments of a knee, by how their names begin."""
    known = strengths_by_name(scene.knee.donor_age)
    return {k: (x[0], x[1]) for k, x in known.items() if any(y.startswith(k) for y in scene.names)}


@declared
class Loads:
    """What carries load in each of n trials, ligaments that fail together as one."""

    names: tuple[str, ...] = entry("Names of ligaments, and of groups of them with one strength")
    forces: Array = entry("Force of each [N], shape ``(n, k)``; NaN without equilibrium")
    strengths: Array = entry("Mean load at failure [N], shape ``(k,)``; NaN where none is known")
    spreads: Array = entry("Its standard deviation [N], in the same shape")
    contact: Array = entry("Medial and lateral contact force [N], shape ``(n, 2)``")
    menisci: Array = entry("Force of the medial and the lateral meniscus [N], shape ``(n, 2)``")
    of_line: IntArray = entry("Which of the names each line of the scene belongs to")

    @property
    def shares(self) -> Array:
        """Forces as shares of the load at failure, shape ``(n, k)``."""
        return np.asarray(self.forces / self.strengths)


def loads_of(scene: KneeScene, strengths: Strengths) -> Loads:
    """What carries load in each trial of a scene.

    Parameters
    ----------
    scene
        The knee in all trials.
    strengths
        As `strengths_of` has them.
    """
    owner = [next((k for k in strengths if x.startswith(k)), x) for x in scene.names]
    names = tuple(dict.fromkeys(owner))
    of_line = np.array([names.index(x) for x in owner])
    tensions = np.array([x.tensions for x in scene.trials]).reshape(len(scene.trials), -1)
    forces = tensions @ (of_line[:, None] == np.arange(len(names))).astype(np.float64)
    known = np.array([strengths.get(x, (np.nan, np.nan)) for x in names]).reshape(-1, 2)
    return Loads(
        names=names,
        forces=forces,
        strengths=known[:, 0],
        spreads=known[:, 1],
        contact=np.array([x.contact_N for x in scene.trials]),
        menisci=np.array([x.meniscus_N for x in scene.trials]),
        of_line=of_line,
    )


def knee_loads_figure(scene: KneeScene, protocol: Protocol, loads: Loads) -> Figure:
    """The knee in every trial, a column a kind of load and a row a flexion angle.

    Ligaments are coloured by their share of the load at which they fail, compartments by their
    contact force; a slack ligament is thin and dashed. Below each knee stands the ligament nearest
    to failure. Of several trials of one kind at one angle the one with the largest load is shown.
    """
    grid_of, angles, kinds = _places(protocol)
    size = (max(0.9 + PANEL[0] * len(kinds), 5.0), 2.3 + PANEL[1] * len(angles))
    # Panels of equal scales may be higher than the layout has them.
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(h_pad=0.12))
    grid = figure.subplots(len(angles), len(kinds), squeeze=False)
    shares, forces = _colours(loads)
    low, high = _window(scene)
    for row, angle in enumerate(angles):
        for column, kind in enumerate(kinds):
            axes = grid[row, column]
            axes.set_axis_off()
            axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
            if row == 0:
                axes.set_title(wrapped(kind, 15), fontsize=SMALL)
            if column == 0:
                axes.text(
                    -0.05, 0.5, f"{angle:g} deg", transform=axes.transAxes, ha="right",
                    va="center", fontsize=SMALL + 1,
                )  # fmt: skip
            if (trial := grid_of.get((angle, kind))) is not None:
                _draw_knee(axes, scene, loads, trial, (shares, forces))
    for scale, words, end in (
        (shares, "share of the load at failure [%]", "max"),
        (forces, "contact force [N]", "neither"),
    ):
        bar = figure.colorbar(
            scale, ax=grid.ravel().tolist(), location="bottom", fraction=0.025, aspect=40,
            shrink=0.6, pad=0.02, extend=end,
        )  # fmt: skip
        bar.set_label(words, fontsize=SMALL)
        bar.ax.tick_params(labelsize=TINY)
    keys = [
        Line2D([], [], color=GREY, linewidth=2.2, label="strength not known"),
        Line2D([], [], color=GREY, linewidth=0.8, linestyle="--", label="slack"),
    ]
    legend_below(figure, keys, columns=2, fontsize=SMALL)
    return figure


def _places(protocol: Protocol) -> tuple[dict[tuple[float, str], int], list[float], list[str]]:
    """The trial of each angle and kind of load, then the angles and the kinds in their order."""
    shown = as_shown(protocol)
    kinds = load_scenarios(shown)
    sizes = np.abs(shown.loads).max(axis=1)
    found: dict[tuple[float, str], int] = {}
    for trial, place in enumerate(zip(shown.flexion_deg.tolist(), kinds, strict=True)):
        if place not in found or sizes[trial] > sizes[found[place]]:
            found[place] = trial
    angles = sorted({x for x, _ in found})
    if len(angles) > MOST_ANGLES:
        angles = [
            angles[i] for i in np.linspace(0, len(angles) - 1, MOST_ANGLES).round().astype(int)
        ]
    counts = {x: sum(k == x and a in angles for a, k in found) for x in dict.fromkeys(kinds)}
    kept = sorted(counts, key=lambda x: -counts[x])[:MOST_DIRECTIONS]
    kinds_drawn = [x for x in counts if x in kept and counts[x]]
    kept_places = {k: x for k, x in found.items() if k[0] in angles and k[1] in kinds_drawn}
    return kept_places, angles, kinds_drawn


def _colours(loads: Loads) -> tuple[ScalarMappable, ScalarMappable]:
    """Colours of ligaments by their share [%], and of compartments by their force [N]."""
    shares = _part_of("YlOrRd", 0.2, 0.95).with_extremes(over=FAILED)
    most = float(np.nanmax(loads.contact, initial=1.0))
    return (
        ScalarMappable(Normalize(0.0, 100.0), shares),
        ScalarMappable(Normalize(0.0, most), _part_of("Blues", 0.1, 0.95)),
    )


def _part_of(name: str, low: float, high: float) -> Colormap:
    return ListedColormap(colormaps[name](np.linspace(low, high, 256)))


def _window(scene: KneeScene) -> tuple[Array, Array]:
    """Lowest and highest place on the page of all that is drawn in any trial, ``(2,)`` each."""
    tibial = np.concatenate([scene.tibia.vertices, scene.lines.tibial])
    femoral = np.concatenate([scene.femur.vertices, scene.lines.femoral])
    places = [
        tibial,
        *(x.placement.to_tibia(femoral) for x in scene.trials if x.outcome is CONVERGED),
    ]
    page = IN_FRONT.project(np.concatenate(places))[:, :2]
    return page.min(axis=0) - 3.0, page.max(axis=0) + 3.0


def _draw_knee(
    axes: Axes,
    scene: KneeScene,
    loads: Loads,
    trial: int,
    scales: tuple[ScalarMappable, ScalarMappable],
) -> None:
    own = scene.trials[trial]
    if own.outcome is not CONVERGED:
        axes.text(0.5, 0.5, "no\nequilibrium", transform=axes.transAxes, ha="center", va="center",
                  fontsize=SMALL, color=GREY)  # fmt: skip
        return
    shares, forces = scales
    compartment = forces.to_rgba(loads.contact[trial])
    is_lateral = scene.tibia.vertices[scene.tibia.faces].mean(axis=1)[:, 2] > 0.0
    _surface(axes, scene.tibia, None, compartment[is_lateral.astype(int)], 1.0)
    bone = np.tile(np.array([int(BONE[i : i + 2], 16) / 255 for i in (1, 3, 5)] + [1.0]), (1, 1))
    faces = np.repeat(bone, len(scene.femur.faces), axis=0)
    _surface(axes, scene.femur, own.placement, faces, BONE_OPACITY)
    share = 100.0 * loads.shares[trial]
    femoral = IN_FRONT.project(own.placement.to_tibia(scene.lines.femoral))[:, :2]
    tibial = IN_FRONT.project(np.asarray(scene.lines.tibial))[:, :2]
    for line, name in enumerate(loads.of_line.tolist()):
        ends = np.stack([femoral[line], tibial[line]]).T
        if own.tensions[line] <= 0.0:
            axes.plot(*ends, color=GREY, linewidth=0.8, linestyle="--")
            continue
        colour = GREY if np.isnan(share[name]) else shares.to_rgba(share[name])
        course = [ends.T.tolist()]
        for look, width in ((BLACK, 3.2), (colour, 2.3)):
            axes.add_collection(LineCollection(course, colors=[look], linewidths=width, zorder=3))
    if np.isfinite(share).any():
        most = int(np.nanargmax(share))
        axes.text(
            0.5, 0.0, f"{loads.names[most]} {number(share[most], '.0f')} %",
            transform=axes.transAxes, ha="center", va="top", fontsize=TINY,
            fontweight="bold" if share[most] > 100.0 else "normal",
        )  # fmt: skip


def _surface(
    axes: Axes, mesh: Mesh, placement: Placement | None, colours: Array, opacity: float
) -> None:
    """A surface with a colour for each triangle, shaded, as one picture."""
    places = mesh.vertices if placement is None else placement.to_tibia(mesh.vertices)
    corners, shade = shaded(IN_FRONT, places[mesh.faces], AMBIENT)
    order = np.argsort(corners[..., 2].mean(axis=1), kind="stable")
    faces = np.column_stack([colours[:, :3] * shade[:, None], np.full(len(colours), opacity)])
    axes.add_collection(
        PolyCollection(
            list(corners[order, :, :2]), facecolors=faces[order], linewidths=0.0,
            antialiaseds=False, rasterized=True,
        )
    )  # fmt: skip


ACROSS = 6


def forces_chart(
    trials: Sequence[str],
    loads: Loads,
    ranges: Mapping[str, Range] | None = None,
    *,
    source: str = "fit",
) -> Figure:
    """Every force in every trial, with its interval where known and with its limit.

    Parameters
    ----------
    trials
        Names of the trials.
    loads
        What carries load.
    ranges
        Intervals by name, such as ``"MCL.tension_N@TRIAL"`` or ``"contact.medial_N@TRIAL"``.
    source
        What the forces are of.
    """
    known = ranges or {}
    rows = _rows(loads)
    limits = zip(loads.strengths, loads.spreads, strict=True)
    carried = [
        (name, f"{name}.tension_N", forces, limit)
        for name, forces, limit in zip(loads.names, loads.forces.T, limits, strict=True)
    ]
    for kind, both in (("contact", loads.contact), ("meniscus", loads.menisci)):
        # Without menisci their forces are zero.
        if kind == "contact" or np.nan_to_num(both).any():
            carried += [
                (f"{side} {kind}", f"{kind}.{side}_N", forces, (np.nan, np.nan))
                for side, forces in zip(COMPARTMENTS, both.T, strict=True)
            ]
    drawn = [x for x in carried if np.isfinite(x[2][rows]).any()]
    size = (1.45, 0.8 + 0.17 * len(rows))
    figure, panels = panel_rows(len(drawn), size, (1.6, 0.9), ACROSS, sharey=True)
    has_interval = False
    for axes, (name, quantity, forces, limit) in zip(panels, drawn, strict=True):
        own = [known.get(f"{quantity}@{trials[i]}") for i in rows]
        has_interval |= any(x is not None for x in own)
        _draw_forces(axes, forces[rows], own, limit)
        axes.set_title(name, fontsize=SMALL + 1)
        axes.set_xlabel("force [N]", fontsize=SMALL)
        bare(axes, grid="y", labelsize=TINY)
    if panels:
        rows_down(panels[0], [trials[i] for i in rows])
    handles = [Line2D([], [], color=FIT, linestyle="", marker="o", markersize=4, label=source)]
    if has_interval:
        handles.append(Line2D([], [], color=FIT, linewidth=1.4, label="95 % interval"))
    handles.append(Line2D([], [], color=BLACK, linewidth=1.0, label="mean load at failure"))
    legend_below(
        figure, [*handles, Patch(color=LIMIT, label="± its standard deviation")], columns=4
    )
    return figure


LIMIT = "0.85"


def _rows(loads: Loads) -> IntArray:
    """The trials with an equilibrium; of many those in which a ligament is nearest to failure."""
    rows = np.flatnonzero(np.isfinite(loads.contact).any(axis=1))
    if len(rows) <= MOST_TRIALS:
        return rows
    near = np.nan_to_num(loads.shares).max(axis=1)[rows]
    return np.sort(rows[np.argsort(-near, kind="stable")[:MOST_TRIALS]])


def _draw_forces(
    axes: Axes, values: Array, ranges: Sequence[Range | None], limit: tuple[float, float]
) -> None:
    """Forces of one structure, a row a trial."""
    mean, sd = limit
    ends = [x for y in ranges if y is not None for x in (y.low, y.high) if x is not None]
    reach = [*values[np.isfinite(values)].tolist(), *ends, 1.0]
    if np.isfinite(mean):
        axes.axvspan(mean - sd, mean + sd, color=LIMIT, linewidth=0, zorder=0)
        axes.axvline(mean, color=BLACK, linewidth=1.0, zorder=1)
        reach.append(mean + sd)
    right = 1.08 * max(reach)
    for row, own in enumerate(ranges):
        if own is not None:
            low, high = own.low or 0.0, right if own.high is None else own.high
            axes.plot([low, high], [row, row], color=FIT, linewidth=1.4, zorder=2)
    axes.plot(values, np.arange(len(values)), "o", color=FIT, markersize=3.2, zorder=3)
    axes.set_xlim(min(0.0, 1.05 * min(reach)), right)
    axes.locator_params(axis="x", nbins=4)


KNEE_LOADS, ALL_FORCES = "knee-loads", "all-forces"
# What they are of.
OF_VERBS = ("fit", "simulate")


def load_drawings(findings: Findings) -> Iterator[tuple[Result, Drawing]]:
    """The knee by trial and a chart of all forces, for the first fit of each table.

    Of simulations where nothing was fitted. None where the knee is not known.
    """
    first_fits = {x.data_digest: x for x in reversed(findings.of("fit"))}
    for result in [*first_fits.values()] or findings.of("simulate"):
        protocol = result.protocol
        if result.knee is None or protocol is None:
            continue
        scene = scene_at(result.answer, result.knee, protocol)
        if scene is None:
            continue
        loads = loads_of(scene, strengths_of(scene) | _own_strengths(result.answer))
        alike = [x.answer for x in findings.results if x.data_digest == result.data_digest]
        ranges = {name: x for own in alike for name, x in presenter_of(own).ranges(own)}
        side = " (a left knee, drawn as a right one)" if scene.knee.side == "left" else ""
        yield (
            result,
            Drawing(
                name=KNEE_LOADS,
                figure=knee_loads_figure(scene, protocol, loads),
                caption="The knee from the front in every trial: ligaments coloured by their share "
                "of the load at which they fail, compartments by contact force. "
                f"Named: the ligament nearest to failure{side}.",
                description="The knee under every load at each flexion angle, coloured by load.",
            ),
        )
        yield (
            result,
            Drawing(
                name=ALL_FORCES,
                figure=forces_chart(
                    protocol.trials,
                    loads,
                    ranges,
                    source="fit" if result.verb == "fit" else "simulated",
                ),
                caption="Every ligament force and contact force in every trial, with 95 % "
                "intervals where known. Line and ground: published load at failure.",
                description=f"Forces of {len(loads.names)} ligaments and both compartments by "
                "trial.",
            ),
        )


def _own_strengths(answer: Answer) -> dict[str, tuple[float, float]]:
    """Strengths that counted as evidence in a fit, by how the names of their ligaments begin."""
    if not isinstance(answer, Calibration) or answer.plausibility is None:
        return {}
    limits = [x.limit for x in answer.plausibility.limits]
    return {
        x.name.removesuffix(FORCE): (x.size, x.spread)
        for x in limits
        if x.form == "strength" and x.name.endswith(FORCE)
    }


FORCE = f".{TENSION}"
