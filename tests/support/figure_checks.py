"""What is wrong with a figure for those who look at it: measured from what is drawn."""

import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from identknee.laxity.table import read_laxity
from identknee.report.figures import ALL_FITS, FIT, MEASURED, without_mathtext
from identknee.report.page.page import report_drawings
from identknee.report.presenter import Drawing, presenter_of
from identknee.report.results import by_subject, found_results, knee_of

RESULTS = Path(__file__).parents[1] / "fuzz" / "results"
# Boxes of text have room above and below the letters [px at 100 dots an inch].
ROOM = 1.5
# What a page leaves beside a figure, and at most for it [px].
PAGE_MARGINS, WIDEST = 40.0, 992.0
_CODE_NAME = re.compile(r"[A-Za-z]\w*_\w")
_HYPHEN_FOR_MINUS = re.compile(r"(?:^|[\s(\[,])-\.?\d")
# Letters of a line, and entries of a legend, that still can be read at a glance.
MOST_LETTERS, MOST_ENTRIES = 90, 14
# What is drawn in one colour in every figure, by how its entry in a legend begins.
COLOUR_OF = {"measured": MEASURED, "fit": FIT, "model": FIT, "predicted by the fit": FIT}
# Greys are frames, bands of noise and marks that the caption explains.
LEAST_SATURATION = 0.15


def faults(figure: Figure, names: Collection[str] = ()) -> list[str]:
    """All that is wrong with a figure, a line each; none where it can be shown.

    Parameters
    ----------
    figure
        Any figure.
    names
        Names that the user gave, of subject, trials and ligaments, which may look like code.
    """
    renderer = drawn(figure)
    if not any(x.get_visible() for x in figure.axes):
        return ["empty: there is no panel"]
    return [
        *(f"empty: {x}" for x in empty_axes(figure, renderer)),
        *(f"clipped: {x!r}" for x in clipped(figure, renderer)),
        *(f"overlapping: {a!r} and {b!r}" for a, b in overlapping(figure, renderer)),
        *(f"named as in code: {x!r}" for x in code_names(figure, names)),
        *(f"hyphen for a minus: {x!r}" for x in hyphens(figure, names)),
        *(f"too long: {x!r}" for x in long_lines(figure)),
        *(f"twice: {x}" for x in duplicates(figure)),
        *(f"in another colour: {x}" for x in miscoloured(figure)),
        *(f"in no legend: {x}" for x in unexplained(figure)),
    ]


def faults_of(folder: Path) -> dict[str, list[str]]:
    """All that is wrong with the figures of results in a folder, by the name of the figure."""
    shown = figures_of(folder)
    return {name: faults(x, shown.names) for name, x in shown.figures.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """Figures of the page of results, and those that commands leave beside; names in them."""

    drawings: dict[str, Drawing]
    pictures: dict[str, Figure]
    names: set[str]

    @property
    def figures(self) -> dict[str, Figure]:
        """All of them by name."""
        return {name: x.figure for name, x in self.drawings.items()} | self.pictures


def figures_of(folder: Path) -> Shown:
    """The figures of results in a folder, and the names that a user gave in them."""
    results, names = [], set[str]()
    for found in by_subject(found_results(folder)):
        knee = knee_of(found, [])
        names.add(found.title)
        for x in found.results:
            results.append(replace(x, knee=knee))
            names |= set(x.answer.trials_used)
            names |= set(x.protocol.trials if x.protocol is not None else ())
            for table in x.tables:
                names |= _trials_of(table)
    pictures: dict[str, Figure] = {}
    for x in results:
        if x.knee is not None:
            own = presenter_of(x.answer).pictures(x.answer, x.knee)
            pictures |= {f"{x.folder.name}-picture-{name}": y for name, y in own.items()}
    return Shown(drawings=dict(report_drawings(results)), pictures=pictures, names=names)


@cache
def stored_figures(verb: str) -> Shown:
    """All figures of one of the results that are kept for tests, made once for all of them."""
    return figures_of(RESULTS / verb)


def _trials_of(table: str) -> set[str]:
    """Names of the trials of a named table or a file; none where it is no more."""
    try:
        return set(read_laxity(table).protocol.trials)
    except ValueError:
        return set()


def drawn(figure: Figure) -> RendererAgg:
    """The renderer of a figure that has been drawn."""
    canvas: Any = FigureCanvasAgg(figure)
    with without_mathtext(figure):
        canvas.draw()
    renderer: RendererAgg = canvas.get_renderer()
    return renderer


def texts(figure: Figure) -> list[Text]:
    """All that is written and shown."""
    hidden = {id(y) for x in figure.axes if not x.get_visible() for y in x.findobj(Text)}
    ticks = {id(y) for x in figure.axes for y in _unseen_ticks(x)}
    return [
        x
        for x in figure.findobj(Text)
        if x.get_visible() and x.get_text().strip() and id(x) not in hidden | ticks
    ]


def clipped(figure: Figure, renderer: RendererAgg) -> list[str]:
    """Texts that reach beyond the figure."""
    whole = figure.bbox
    return [
        x.get_text()
        for x in texts(figure)
        for box in [x.get_window_extent(renderer)]
        if min(box.x0 - whole.x0, box.y0 - whole.y0, whole.x1 - box.x1, whole.y1 - box.y1) < -ROOM
    ]


def overlapping(figure: Figure, renderer: RendererAgg) -> list[tuple[str, str]]:
    """Pairs of texts that lie upon one another; those at a slant are not in their boxes."""
    straight = [x for x in texts(figure) if x.get_rotation() % 90.0 == 0.0]
    boxes = [(x.get_text(), x.get_window_extent(renderer)) for x in straight]
    return [
        (a, b) for (a, one), (b, other) in combinations(boxes, 2) if _overlap(one, other) > ROOM
    ]


def empty_axes(figure: Figure, renderer: RendererAgg) -> list[str]:
    """Panels in which nothing is to be seen."""
    return [
        x.get_title() or x.get_xlabel() or "?"
        for x in figure.axes
        if x.get_visible() and x.axison and not any(_contents(x, renderer))
    ]


def code_names(figure: Figure, names: Collection[str] = ()) -> list[str]:
    """Texts that name a parameter, a coordinate or a cause as files do."""
    return [x for x in _without(figure, names) if _CODE_NAME.search(x)]


def hyphens(figure: Figure, names: Collection[str] = ()) -> list[str]:
    """Texts with a hyphen where a number has a minus sign elsewhere."""
    return [x for x in _without(figure, names) if _HYPHEN_FOR_MINUS.search(x)]


def long_lines(figure: Figure) -> list[str]:
    """Lines of text that are too long, and legends with too many entries."""
    lines = [y for x in texts(figure) for y in x.get_text().splitlines()]
    found = [x for x in lines if len(x) > MOST_LETTERS]
    n = [len(x.get_texts()) for x in legends(figure)]
    return [*found, *(f"a legend of {x} entries" for x in n if x > MOST_ENTRIES)]


def legends(figure: Figure) -> list[Legend]:
    """Those of the figure and of its panels."""
    own = [x.get_legend() for x in figure.axes if x.get_visible()]
    return [*figure.legends, *(x for x in own if x is not None)]


def duplicates(figure: Figure) -> list[str]:
    """Entries of a legend, labels of an axis and whole panels that come twice."""
    found = []
    for legend in legends(figure):
        found += _repeated("entry", [x.get_text() for x in legend.get_texts()])
    seen = [x for x in figure.axes if x.get_visible() and x.axison]
    for axes in seen:
        for k, axis in enumerate((axes.xaxis, axes.yaxis)):
            low, high = sorted(axis.get_view_interval())
            ticks = [(float(x.get_loc()), x.label1.get_text()) for x in axis.get_major_ticks()]
            named = [(at, word) for at, word in ticks if low <= at <= high and word]
            lines = [np.asarray(x.get_xydata(), float)[:, k] for x in axes.lines]
            between = [float(x[0]) for x in lines if x.size and np.ptp(x) == 0.0]
            # Groups of a map repeat their columns, with a line between the groups.
            found += [
                f"the label {word!r}"
                for (at, word), (then, other) in pairwise(named)
                if word == other and not any(at < x < then for x in between)
            ]
    panels = [repr(y) for x in seen if any((y := _content(x))[1:])]
    return [*found, *("a panel" for n in Counter(panels).values() if n > 1)]


def _content(axes: Axes) -> tuple[Any, ...]:
    """What a panel shows: its words and all that is drawn."""
    words = axes.get_title(), axes.get_title(loc="left"), axes.get_xlabel(), axes.get_ylabel()
    lines = [np.round(np.asarray(x.get_xydata(), float), 9).tolist() for x in axes.lines]
    texts_drawn = [x.get_text() for x in axes.texts]
    placed = [x.get_path().transformed(x.get_patch_transform()).vertices for x in axes.patches]
    patches = [np.round(np.asarray(x, float), 9).tolist() for x in placed]
    arrays = [np.asarray(x.get_array()).tolist() for x in axes.images]
    return words, lines, texts_drawn, patches, arrays, len(axes.collections)


def miscoloured(figure: Figure) -> list[str]:
    """Entries of legends for what has another colour in other figures."""
    found = []
    for legend in legends(figure):
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
            word = text.get_text()
            own = [y for x, y in COLOUR_OF.items() if word == x or word.startswith(f"{x} ")]
            colour = handle.get_color() if isinstance(handle, Line2D) else None
            if own and isinstance(colour, str) and to_hex(colour) != to_hex(own[0]):
                found.append(f"{word} ({to_hex(colour)})")
    return found


def unexplained(figure: Figure) -> list[str]:
    """Colours of lines and marks of which no legend says what they are, where there are several.

    Rows that have a name beside them need no legend.
    """
    rows = {float(y) for x in figure.axes if _names_rows(x) for y in x.get_yticks()}
    used = {
        to_hex(colour)
        for axes in figure.axes
        if axes.get_visible()
        for x in axes.lines
        if (y := np.asarray(x.get_ydata(), float)).size and np.isfinite(y).any()
        if _is_colour(colour := x.get_color())
        and not (set(y.tolist()) <= rows and len(set(y)) == 1)
    }
    if len(used) < 2:
        return []
    said = {to_hex(ALL_FITS)}
    for legend in legends(figure):
        for x in legend.legend_handles:
            own = getattr(x, "get_color", None) or getattr(x, "get_facecolor", None)
            said |= {to_hex(y) for y in [own() if own else MEASURED] if isinstance(y, str | tuple)}
            if not isinstance(x, Line2D) and own:
                said |= {to_hex(y) for y in np.atleast_2d(np.asarray(own(), dtype=object))[:1]}
    return sorted(used - said)


def _names_rows(axes: Axes) -> bool:
    words = [x.get_text() for x in axes.get_yticklabels()]
    return any(words) and not any(x.strip("−").replace(".", "").isdigit() for x in words)


def _is_colour(colour: Any) -> bool:
    rgb = to_rgb(colour)
    return max(rgb) - min(rgb) > LEAST_SATURATION


def _repeated(kind: str, words: list[str]) -> list[str]:
    return [f"the {kind} {x!r}" for x, n in Counter(words).items() if n > 1]


def _without(figure: Figure, names: Collection[str]) -> list[str]:
    """All texts, the user's own names taken out of them; formulas of axes too."""
    longest = sorted(names, key=len, reverse=True)
    found = []
    for x in texts(figure):
        word = x.get_text()
        for name in longest:
            word = word.replace(name, "NAME")
        if "\\mathdefault" not in word:
            found.append(word)
    return found


def smallest_text(svg: str, width: float) -> float:
    """The smallest letters of a drawing on a page of some width [px]."""
    own, least = (float(re.findall(rf"--{x}: (\d+)px", svg)[0]) for x in ("width", "least"))
    scale = max(min(own, width - PAGE_MARGINS, WIDEST), least) / own
    sizes = re.findall(r"<text style=\"[^\"]*?([\d.]+)px", svg)
    return min(map(float, sizes)) * 4.0 / 3.0 * scale


def page_colours(scheme: str) -> dict[str, str]:
    """Colours of the page by their names, ``"light"`` or ``"dark"``."""
    style = files("identknee.report.page").joinpath("style.css").read_text(encoding="utf-8")
    blocks = re.findall(r":root \{(.*?)\}", style, re.DOTALL)
    found = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", blocks[0]))
    if scheme == "dark":
        found |= dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", blocks[1]))
    return found


def text_contrasts(svg: str, scheme: str) -> dict[str, float]:
    """Contrast of every text of a drawing with the page it stands on.

    Texts in the two colours that are kept for coloured maps are left out.
    """
    colours = page_colours(scheme)
    found = {}
    for style, word in re.findall(r'<text style="([^"]*)"[^>]*>([^<]*)</text>', svg):
        fill = (re.search(r"fill: ([^;]+)", style) or ["", "currentColor"])[1]
        if fill not in ("#010101", "#ffffff"):
            found[word] = contrast(_resolved(fill, colours), to_rgb(colours["paper"]))
    return found


def contrast(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """Contrast of two colours after WCAG 2.2."""
    dark, bright = sorted((_luminance(one), _luminance(other)))
    return (bright + 0.05) / (dark + 0.05)


def _resolved(fill: str, colours: dict[str, str]) -> tuple[float, ...]:
    if fill == "currentColor":
        return to_rgb(colours["ink"])
    if named := re.fullmatch(r"var\(--([\w-]+)\)", fill):
        return to_rgb(colours[named[1]])
    if mixed := re.match(r"color-mix\(in srgb, currentColor (\d+)%", fill):
        share = int(mixed[1]) / 100.0
        ink, paper = np.array(to_rgb(colours["ink"])), np.array(to_rgb(colours["paper"]))
        return tuple((share * ink + (1.0 - share) * paper).tolist())
    return to_rgb(fill)


def _luminance(colour: tuple[float, ...]) -> float:
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _overlap(one: Bbox, other: Bbox) -> float:
    """The smaller side of what two boxes share [px]."""
    width = min(one.x1, other.x1) - max(one.x0, other.x0)
    height = min(one.y1, other.y1) - max(one.y0, other.y0)
    return float(min(width, height))


def _contents(axes: Axes, renderer: RendererAgg) -> Iterator[bool]:
    """Of everything drawn in axes, whether some of it is where they can be seen."""
    inside = axes.get_window_extent(renderer)
    for artist in (*axes.lines, *axes.collections, *axes.patches, *axes.images, *axes.texts):
        box = artist.get_window_extent(renderer)
        is_finite = bool(np.all(np.isfinite(box.extents)))
        yield artist.get_visible() and is_finite and bool(inside.overlaps(box))


def _unseen_ticks(axes: Axes) -> Iterator[Text]:
    """Labels of ticks that lie outside the limits and are not drawn."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        slack = 1e-9 * (high - low) if axis.get_scale() == "linear" else 0.0
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low - slack <= tick.get_loc() <= high + slack or not axes.axison:
                yield from (tick.label1, tick.label2)
