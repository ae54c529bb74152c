"""The page: one HTML file with the answer first and everything it stands on behind it."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files
from itertools import chain

from identknee.report.drawing import Drawing
from identknee.report.page.laxity_part import laxity_drawings
from identknee.report.page.markup import element, paragraph, section
from identknee.report.page.results import Findings, Result, by_subject, drawings
from identknee.report.page.subject_part import subject_html
from identknee.report.page.viewer import KneeScene
from identknee.runs.progress import progress
from identknee.runs.record import versions

# Nothing may be fetched: the page is all there is.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:"
)


def report_html(results: Sequence[Result], scenes: Mapping[str, KneeScene] | None = None) -> str:
    """The whole page; it needs nothing beside it and fetches nothing.

    Parameters
    ----------
    results
        As `found_results` gives them.
    scenes
        By the digest of the subject, the knee to turn in three dimensions.
    """
    shown = scenes or {}
    subjects = by_subject(results)
    level = 2 if len(subjects) == 1 else 3
    parts = [
        subject_html(x, k, level, shown.get(x.results[0].subject_digest))
        for k, x in enumerate(subjects, 1)
    ]
    names = _names(subjects)
    main = "".join(
        content if level == 2 else section(f"subject-{k}", f"Subject {name}", content)
        for k, (name, content) in enumerate(zip(names, parts, strict=True), 1)
    )
    title = f"Knee report: {', '.join(dict.fromkeys(x.title for x in subjects))}"
    head = element("h1", escape(title)) + paragraph(_lead(results), class_="lead")
    body = (
        '<a class="skip" href="#main">Skip to the answer</a>'
        + element("header", head)
        + element("main", main, id="main")
        + element("footer", paragraph(f"{_maker()}. This page works offline."))
    )
    return document(title, body, has_viewer=bool(shown))


def report_drawings(results: Sequence[Result]) -> Iterator[tuple[str, Drawing]]:
    """Every figure of the page with the name of its file."""
    for subject in by_subject(results):
        findings = subject.merged
        shown = progress(findings.results, description="drawing figures")
        pairs = ((x, y) for x in shown for y in drawings(x))
        for result, drawing in chain(pairs, laxity_drawings(findings)):
            folder = result.folder.name
            beside = "" if folder == result.verb else f"{folder}-"
            yield f"{beside}{result.verb}-{drawing.name}", drawing


def document(title: str, body: str, *, has_viewer: bool) -> str:
    """A page with its style and code; with a viewer also the library that draws it."""
    here = files("identknee.report.page")
    style = (here / "style.css").read_text(encoding="utf-8")
    code = (here / "page.js").read_text(encoding="utf-8")
    library = ""
    if has_viewer:
        # Loaded where it is needed: it is large.
        from plotly.offline import get_plotlyjs

        library = element("script", get_plotlyjs().replace("</script", "<\\/script"))
    head = (
        '<meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<link rel="icon" href="data:,">'
        f"{element('title', escape(title))}{element('style', style)}{library}"
    )
    return (
        f'<!doctype html>\n<html lang="en">{element("head", head)}'
        f"{element('body', body + element('script', code))}</html>\n"
    )


def _names(subjects: Sequence[Findings]) -> list[str]:
    """Names of the subjects; of one knee that was taken in several ways also which is meant."""
    titles = [x.title for x in subjects]
    names = []
    for k, x in enumerate(subjects):
        if titles.count(x.title) == 1:
            names.append(x.title)
            continue
        stated = x.results[0].record["settings"].get("uncertain")
        given = [stated] if isinstance(stated, str) else stated or ()
        words = ", ".join(",".join(given).replace(" ", "").split(","))
        number = titles[: k + 1].count(x.title)
        names.append(f"{x.title} ({f'uncertain {words}' if words else f'number {number}'})")
    return names


def _maker() -> str:
    return f"Made by identknee {versions().get('identknee', '')}".rstrip()


def _lead(results: Sequence[Result]) -> str:
    verbs = ", ".join(dict.fromkeys(x.verb for x in results))
    days = sorted({str(x.record["started"])[:10] for x in results})
    when = days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"
    return f"From {verbs}, computed {when}. Every sentence links to its numbers."
