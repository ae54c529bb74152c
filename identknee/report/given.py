"""What a notebook shows of what calculations are given: a knee, a laxity table, trials, a model."""

from base64 import b64encode
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from identknee.laxity.protocol import DIRECTIONS, Protocol, as_shown
from identknee.laxity.table import COORDINATES, Laxity
from identknee.laxity.trial_words import load_scenarios, load_unit
from identknee.model.laxity_model import LaxityModel
from identknee.report.figures import DOTS_IN_NOTEBOOK, FIT, SMALL, bare, panel_rows, png
from identknee.report.laxity_figures import LaxityCurves, along_load_figure, by_load_figure
from identknee.report.page.markup import parts
from identknee.report.presenter import Cell, Table, table
from identknee.report.scene import scene
from identknee.runs.declare import declared, entry
from identknee.runs.words import label, listed, listed_first
from identknee.subject.knee import Knee

MOST_NAMES = 8


@declared
class Shown:
    """What is said and drawn of something given."""

    sentences: tuple[str, ...] = entry("What it is, in sentences")
    tables: tuple[Table, ...] = entry("Its numbers")
    draw: Callable[[], Figure | None] = entry("Its picture; None where it has none")
    caption: str = entry("What the picture shows")

    @property
    def text(self) -> str:
        """Sentences and tables for a terminal."""
        return "\n\n".join(["\n".join(self.sentences), *map(str, self.tables)])

    @property
    def html(self) -> str:
        """The same with the picture, for a notebook."""
        figure = self.draw()
        picture = b"" if figure is None else png(figure, DOTS_IN_NOTEBOOK)
        shown = b64encode(picture).decode("ascii")
        rows = [x.first_rows() for x in self.tables]
        return str(parts().notebook_answer(self.sentences, rows, shown, self.caption, ()))


def shown(given: Knee | Laxity | Protocol | LaxityModel) -> Shown:
    """What is said and drawn of a knee, a laxity table, a protocol or a model."""
    if isinstance(given, Knee):
        return _of_knee(given)
    if isinstance(given, Laxity):
        return _of_laxity(given)
    return _of_protocol(given) if isinstance(given, Protocol) else _of_model(given)


def _of_knee(knee: Knee) -> Shown:
    n = sum(len(x.faces) for x in (knee.femur, *knee.tibia))
    known = {k: x for k, x in knee.uncertainty.words.items() if x != "exact"}
    stated = listed(f"{k.rpartition('_')[0].replace('_', ' ')} ({x})" for k, x in known.items())
    sentences = [
        f"{knee.side.capitalize()} knee {knee.name}: {len(knee.ligaments)} ligaments, "
        f"{n} triangles of cartilage. {knee.description}".rstrip(),
        f"Uncertain: {stated}." if known else "Its geometry is taken as exact.",
    ]
    rows = ((x.name, x.stiffness_kN, x.reference_strain_pct) for x in knee.ligaments)
    heads = ("ligament", ("stiffness", 2, "kN"), ("reference strain", 2, "%"))
    return Shown(
        sentences=tuple(sentences),
        tables=(table("Ligaments", heads, rows),),
        draw=lambda: scene(knee),
        caption="Cartilage, ligaments and axes in the scanned pose, from behind.",
    )


def _of_protocol(protocol: Protocol) -> Shown:
    sentence, counts = _trials(protocol)
    return Shown(
        sentences=(sentence,),
        tables=(counts,),
        draw=lambda: _trials_figure(protocol),
        caption="The loads of all trials against flexion.",
    )


def _trials(protocol: Protocol) -> tuple[str, Table]:
    """How many trials there are, and of each kind of load at which angles."""
    drawn = as_shown(protocol)
    kinds = load_scenarios(drawn)
    angles: list[float] = np.unique(drawn.flexion_deg).tolist()
    counts = Counter(zip(kinds, drawn.flexion_deg.tolist(), strict=True))
    rows: list[list[Cell]] = [
        [x, *(counts[x, angle] for angle in angles)] for x in dict.fromkeys(kinds)
    ]
    heads: list[str | tuple[Any, ...]] = ["load", *((f"{x:g} deg", 0) for x in angles)]
    words = listed_first([f"{x:g}" for x in angles], MOST_NAMES)
    plural = "" if protocol.n == 1 else "s"
    sentence = f"{protocol.name}: {protocol.n} trial{plural} at {words} deg of flexion."
    return sentence, table("Trials by load and flexion", heads, rows)


def _trials_figure(protocol: Protocol) -> Figure | None:
    """The size of every load against flexion, a panel a load; None where nothing is loaded."""
    drawn = as_shown(protocol)
    used = np.flatnonzero(drawn.loads.any(axis=0)).tolist()
    if not used:
        return None
    figure, panels = panel_rows(len(used), (2.4, 2.4), (0.6, 0.0), len(used))
    for axes, k in zip(panels, used, strict=True):
        axes.axhline(0.0, color="0.8", linewidth=0.8)
        axes.plot(protocol.flexion_deg, drawn.loads[:, k], "o", color=FIT, markersize=3.5)
        axes.set_xlabel("flexion [deg]", fontsize=SMALL + 1)
        axes.set_ylabel(f"{DIRECTIONS[k][0]} [{load_unit(k)}]", fontsize=SMALL + 1)
        bare(axes, labelsize=SMALL)
    return figure


def _of_laxity(laxity: Laxity) -> Shown:
    sentence, counts = _trials(laxity.protocol)
    n = laxity.is_measured.sum(axis=0)
    known = listed(label(x) for x, k in zip(COORDINATES, n.tolist(), strict=True) if k)
    noise = "" if laxity.sd is None else " The noise is stated."
    return Shown(
        sentences=(
            f"Laxity table {sentence}",
            f"{int(n.sum())} values of {known}; coordinates are {laxity.zero}.{noise}",
        ),
        tables=(counts,),
        draw=lambda: _laxity_figure(laxity),
        caption="The laxity measured.",
    )


def _laxity_figure(laxity: Laxity) -> Figure | None:
    curves = LaxityCurves(
        protocol=laxity.protocol, simulated={}, measured=laxity.coordinates, sd=laxity.sd
    )
    on_curves, others = curves.parts()
    for title, x in others.items():
        return by_load_figure(x, title)
    return None if on_curves is None else along_load_figure(on_curves)


def _of_model(model: LaxityModel) -> Shown:
    own, knee = model.parameters, _of_knee(model.knee)
    effects = [x.name.replace("_", " ") for x in model.effects]
    beside = f" Effects: {listed_first(effects, MOST_NAMES)}." if effects else ""
    trials, _ = _trials(model.protocol)
    heads = ("parameter", ("start", None), ("lowest", None), ("highest", None))
    rows = zip(
        map(label, own.names), own.start.tolist(), own.lower.tolist(), own.upper.tolist(),
        strict=True,
    )  # fmt: skip
    return Shown(
        sentences=(
            f"Model of the knee {model.knee.name} with {own.n} parameters, under {trials}{beside}",
        ),
        tables=(table("Parameters", heads, rows),),
        draw=knee.draw,
        caption=knee.caption,
    )
