"""What a notebook shows: answers, what calculations are given, and the knee in three dimensions."""

from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import escape
from matplotlib.figure import Figure

from identknee.calibrate.fit import load_start
from identknee.laxity.protocol import DIRECTIONS, Protocol, as_shown
from identknee.laxity.table import COORDINATES, Laxity, TrialsLike, read_tests
from identknee.laxity.trial_words import load_scenarios, load_unit
from identknee.model.laxity_model import LaxityModel, model_for_tests
from identknee.report.figures import (
    DOTS_IN_NOTEBOOK,
    FIT,
    SMALL,
    Place,
    SeveralPanelsError,
    bare,
    drawn_on,
    panel_rows,
    png,
    recolour,
    resize,
    show_figures,
)
from identknee.report.laxity_figures import LaxityCurves, along_load_figure, by_load_figure
from identknee.report.opening import opening_of
from identknee.report.page.load_figures import ALL_FORCES, KNEE_LOADS, OF_VERBS, load_drawings
from identknee.report.page.markup import document, parts
from identknee.report.page.viewer import model_scene, scene_of, viewer_html
from identknee.report.presenter import (
    Cell,
    Drawing,
    Table,
    main_statements,
    presenter_of,
    statements_of,
    table,
)
from identknee.report.results import (
    Findings,
    Result,
    knee_of,
    laxity_drawings,
    result_of,
)
from identknee.report.scene import scene
from identknee.runs.declare import declared, entry
from identknee.runs.files import PathLike, write_atomically
from identknee.runs.findings import finding_lines
from identknee.runs.words import label, listed, listed_first
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer

# Bytes of a picture and of a whole answer in a notebook, which keeps every one of them.
MOST_BYTES = 130_000
SHARPNESS = (110, 90, 70, 50, 35)


def answer_html(answer: Answer) -> str:
    """The answer for a notebook: its main sentences, a table and one figure, at most 200 kB."""
    main, opening = main_statements(answer), opening_of([answer])
    tables = [x.first_rows() for said in (*main, *statements_of(answer)) for x in said.tables]
    picture, caption = b"", ""
    for drawing in islice(_each_drawing(answer), 1):
        caption = drawing.caption
        # As sharp a picture as fits.
        for dots in SHARPNESS:
            if len(picture := png(drawing.figure, dots)) <= MOST_BYTES:
                break
    return str(
        parts().notebook_answer(
            [*opening.sentences, *(x.sentence for x in main)],
            tables[:1],
            b64encode(picture).decode("ascii"),
            caption,
            finding_lines(opening.without(answer.findings)),
        )
    )


def answer_figure(
    answer: Answer,
    name: str | None = None,
    *,
    ax: Place | None = None,
    width_mm: float | None = None,
    knee: Knee | None = None,
) -> Figure:
    """A figure of the answer; see `Answer.plot`."""
    if ax is not None and width_mm is not None:
        raise ValueError("width_mm is the width of a whole figure; leave it out where ax is given")
    result = result_of(answer)
    # Equilibria are found anew for these, so that they are drawn where they are asked for.
    of_loads = (KNEE_LOADS, ALL_FORCES) if result.verb in OF_VERBS else ()

    def drawn() -> Iterator[Drawing]:
        return _load_drawings(result, knee) if name in of_loads else _each_drawing(answer)

    known = {x.name: x for x in drawn()}
    if not known:
        raise ValueError(f"{type(answer).__name__} has no figure; print it to see its table")
    if name is not None and name not in known:
        shown = ", ".join([*known, *of_loads])
        raise ValueError(f"there is no figure {name!r}; choose from {shown}")
    show_figures()
    name = name or next(iter(known))
    figure = known[name].figure
    if ax is not None:
        figure = _drawn_there(drawn(), name, ax, list(known).index(name))
    if width_mm is not None:
        resize(figure, width_mm)
    recolour(figure)
    return figure


def _drawn_there(made: Iterator[Drawing], name: str, place: Place, wanted: int) -> Figure:
    """The figure that the place belongs to, with one of these drawn there."""
    for _ in range(wanted):
        next(made)
    try:
        with drawn_on(place):
            next(made)
    except SeveralPanelsError as error:
        raise ValueError(f"figure {name!r} cannot be drawn there: {error}") from None
    whole = place.get_figure(root=True)
    assert whole is not None
    return whole


def _each_drawing(answer: Answer) -> Iterator[Drawing]:
    result = result_of(answer)
    findings = Findings(subject=result.subject, results=(result,))
    yield from presenter_of(answer).drawings(answer, result.subject, result.knee)
    yield from (x for _, x in laxity_drawings(findings))


def _load_drawings(result: Result, knee: Knee | None) -> Iterator[Drawing]:
    """What the knee carries in every trial of a fit or a simulation."""
    findings = Findings(subject=result.subject, results=(result,))
    remarks: list[str] = []
    own = knee_of(findings, remarks, knee)
    if own is None:
        raise ValueError(f"{' '.join(remarks)} Give it as knee=...")
    shown = replace(findings, results=(replace(result, knee=own),))
    yield from (x for _, x in load_drawings(shown))


HEIGHT = "720"


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene3D:
    """The knee as a page to turn it on, trial by trial; a notebook shows it.

    Attributes
    ----------
    html
        The page. It needs no network, so it holds all of plotly: 5 MB.
    """

    html: str = field(repr=False)

    def write(self, path: PathLike) -> Path:
        """The file `path`, written for a browser."""
        return write_atomically(Path(path), self.html)

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{escape(self.html)}" title="The knee in three dimensions" '
            f'width="100%" height="{HEIGHT}" style="border: 0"></iframe>'
        )


def scene_3d(
    knee: Knee, answer: Answer | None = None, *, protocol: TrialsLike = "seed63"
) -> Scene3D:
    """The knee in three dimensions, with ligament forces and contact in every trial.

    Parameters
    ----------
    knee
        The subject.
    answer
        A fit, a simulation or a diagnosis of it: its parameters are shown. Those of the subject if
        None.
    protocol
        The trials to show where there is no answer: a protocol, the name of one, its TOML file, or
        a laxity table.

    Raises
    ------
    ValueError
        If the answer says nothing about this knee's poses.
    """
    if answer is None:
        model = model_for_tests(knee, read_tests(protocol))
        shown_scene = model_scene(model, load_start("subject", model.parameters))
    elif found := scene_of(Findings(subject=knee.name, results=(result_of(answer),)), knee):
        shown_scene = found
    else:
        raise ValueError(
            f"{type(answer).__name__} holds no poses of this knee; give a fit, a simulation or "
            "a diagnosis of it, or no answer"
        )
    return Scene3D(html=document(f"Knee {knee.name}", viewer_html(shown_scene), has_viewer=True))


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
