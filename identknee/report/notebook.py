"""Answers outside the report: in a notebook, and the knee in three dimensions as a page."""

from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from markupsafe import escape
from matplotlib.figure import Figure

from identknee.calibrate.fit import load_start
from identknee.laxity.table import TrialsLike, read_tests
from identknee.model.laxity_model import model_for_tests
from identknee.report.figures import (
    Place,
    SeveralPanelsError,
    drawn_on,
    png,
    recolour,
    resize,
    show_figures,
)
from identknee.report.opening import opening_of
from identknee.report.page.load_figures import ALL_FORCES, KNEE_LOADS, OF_VERBS, load_drawings
from identknee.report.page.markup import document, parts
from identknee.report.page.viewer import model_scene, scene_of, viewer_html
from identknee.report.presenter import Drawing, main_statements, presenter_of, statements_of
from identknee.report.results import (
    Findings,
    Result,
    knee_of,
    laxity_drawings,
    result_of,
)
from identknee.runs.files import PathLike, write_atomically
from identknee.runs.findings import finding_lines
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
        scene = model_scene(model, load_start("subject", model.parameters))
    elif found := scene_of(Findings(subject=knee.name, results=(result_of(answer),)), knee):
        scene = found
    else:
        raise ValueError(
            f"{type(answer).__name__} holds no poses of this knee; give a fit, a simulation or "
            "a diagnosis of it, or no answer"
        )
    return Scene3D(html=document(f"Knee {knee.name}", viewer_html(scene), has_viewer=True))
