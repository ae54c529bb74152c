"""The flow of the package as a drawing whose boxes are links: in a row, or a column on a phone."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

WIDTH, HEIGHT, GAP = 176, 92, 34
ROW = 4
Place = tuple[int, int]
Point = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A box: what it is called and does, its page in the Python interface, and a tutorial."""

    name: str
    does: str
    page: str
    tutorial: str


STAGES = (
    Stage(name="subject", does="surfaces, ligaments", page="subject", tutorial="1_own_knee"),
    Stage(name="laxity", does="loads and what they did", page="laxity", tutorial="3_own_laxity"),
    Stage(
        name="model", does="prediction, derivatives", page="model", tutorial="6_adding_an_effect"
    ),
    Stage(name="calibrate", does="parameters that fit", page="calibrate", tutorial="3_own_laxity"),
    Stage(name="identify", does="known, or left open", page="identify", tutorial="4_which_verb"),
    Stage(name="diagnose", does="what the model lacks", page="diagnosis", tutorial="5_verdict"),
    Stage(name="report", does="tables, figures, files", page="report", tutorial="5_verdict"),
)


def write_flow(path: Path) -> None:
    """Write the drawing twice; the style sheet shows the one that fits."""
    path.write_text(drawing(ROW, "wide") + drawing(1, "narrow"), encoding="utf-8")


def drawing(n_columns: int, kind: str) -> str:
    """The flow as inline SVG of so many columns; what is diagnosed goes back into the model."""
    n_rows = -(-len(STAGES) // n_columns)
    places = [_place(i, n_columns) for i in range(len(STAGES))]
    # A single column leaves room for the way back beside it.
    width = n_columns * (WIDTH + GAP) + (3 * GAP if n_columns == 1 else -GAP) + 4
    height = n_rows * (HEIGHT + GAP) - GAP + 4
    arrows = [_path(_edge(a, b), _edge(b, a), kind) for a, b in pairwise(places)]
    boxes = [_box(stage, *place) for stage, place in zip(STAGES, places, strict=True)]
    return (
        f'<svg class="flow flow-{kind}" viewBox="-2 -2 {width} {height}" role="group" '
        f'aria-label="The flow from a subject to a report" style="max-width: {width}px">'
        f'<defs><marker id="head-{kind}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        f'markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" class="flow-head"/></marker>'
        f"</defs>{''.join(arrows)}{_back(places, kind)}{''.join(boxes)}</svg>\n"
    )


def _back(places: Sequence[Place], kind: str) -> str:
    """From what the model gets wrong to the model that has it."""
    names = [stage.name for stage in STAGES]
    start, end = places[names.index("diagnose")], places[names.index("model")]
    if kind == "wide":
        x, y = start[0] + WIDTH / 2, start[1] - GAP / 2
        return (
            f"{_path(_edge(start, end), _edge(end, start), kind, 'flow-back')}"
            f'<text class="flow-note" x="{x - 8}" y="{y + 4}" text-anchor="end">extended</text>'
        )
    side, far = start[0] + WIDTH, start[0] + WIDTH + 1.5 * GAP
    low, high = start[1] + HEIGHT / 2, end[1] + HEIGHT / 2
    return (
        f'<path class="flow-arrow flow-back" marker-end="url(#head-{kind})" '
        f'd="M{side} {low}C{far} {low} {far} {high} {side} {high}"/>'
        f'<text class="flow-note" x="{far - 6}" y="{(low + high) / 2}">extended</text>'
    )


def _place(index: int, n_columns: int) -> Place:
    """Corner of a box; every second row runs backwards."""
    row, column = divmod(index, n_columns)
    column = column if row % 2 == 0 else n_columns - 1 - column
    return column * (WIDTH + GAP), row * (HEIGHT + GAP)


def _edge(place: Place, other: Place) -> Point:
    """Where a line to another box leaves this one."""
    (x, y), across, down = place, other[0] - place[0], other[1] - place[1]
    sign = (across > 0) - (across < 0), (down > 0) - (down < 0)
    return x + WIDTH / 2 * (1 + sign[0]), y + HEIGHT / 2 * (1 + sign[1])


def _path(start: Point, end: Point, kind: str, style: str = "") -> str:
    return (
        f'<path class="flow-arrow {style}" marker-end="url(#head-{kind})" '
        f'd="M{start[0]} {start[1]}L{end[0]} {end[1]}"/>'
    )


def _box(stage: Stage, x: int, y: int) -> str:
    middle = x + WIDTH / 2
    return (
        f'<a href="api/{stage.page}.html"><rect class="flow-box" x="{x}" y="{y}" width="{WIDTH}" '
        f'height="{HEIGHT}" rx="8"/><text class="flow-name" x="{middle}" y="{y + 32}">{stage.name}'
        f'</text><text class="flow-text" x="{middle}" y="{y + 52}">{stage.does}</text></a>'
        f'<a href="gallery/plot_{stage.tutorial}.html"><text class="flow-link" x="{middle}" '
        f'y="{y + 76}">tutorial</text></a>'
    )
