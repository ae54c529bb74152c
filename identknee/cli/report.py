"""`identknee report`: results as one page for people."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import identknee as ik
from identknee.cli.command import Json, show
from identknee.cli.lazily import knee_digest
from identknee.runs.files import prepare_folder, write_atomically

if TYPE_CHECKING:
    from identknee.report.page.knee_scene import KneeScene
    from identknee.report.page.results import Findings, Result

Folder = Annotated[
    Path,
    typer.Argument(
        metavar="DIR", help="A folder --out of any verb, or a folder that holds such folders."
    ),
]
File = Annotated[
    Path | None, typer.Option(metavar="FILE", help="The page.  [default: DIR/report.html]")
]
Figures = Annotated[
    Literal["svg", "pdf"] | None,
    typer.Option(help="Also write every figure for a paper, to a folder figures beside the page."),
]
PAGE, FIGURES = "report.html", "figures"


def report(
    folder: Folder, out: File = None, figures: Figures = None, as_json: Json = False
) -> None:
    """Write the results in DIR as one page that works offline.

    The answer first, in sentences, with the numbers behind each: what is known and what is not,
    what the model gets wrong, which test to do next. Results of all verbs in DIR and in the folders
    in it are taken, subject by subject.
    """
    summary = write_report(folder, out or folder / PAGE, figures)
    found = ", ".join(x["verb"] for x in summary["results"])
    lines = [f"Report on {found}: {summary['report']}", *summary["remarks"]]
    if figures is not None:
        lines.append(
            f"{len(summary['figures'])} figures: {Path(summary['report']).parent / FIGURES}"
        )
    show(summary, lines, as_json=as_json)


def write_report(folder: Path, page: Path, figures: str | None = None) -> dict[str, Any]:
    """What was found and written; the page is at `page`."""
    # These load xarray and matplotlib, which takes longer than most mistakes.
    from identknee.report.page.page import report_html
    from identknee.report.page.results import by_subject, found_results

    results = found_results(folder)
    prepare_folder(page.parent)
    remarks: list[str] = []
    scenes = {
        x.results[0].subject_digest: scene
        for x in by_subject(results)
        if (scene := _scene(x, remarks)) is not None
    }
    write_atomically(page, report_html(results, scenes))
    return {
        "report": str(page),
        "results": [{"verb": x.verb, "folder": str(x.folder)} for x in results],
        "figures": [] if figures is None else _write_figures(results, page.parent, figures),
        "remarks": remarks,
    }


def _scene(findings: "Findings", remarks: list[str]) -> "KneeScene | None":
    """The knee in three dimensions; without it a remark says why."""
    from identknee.report.page.scenes import scene_of

    name = findings.subject
    try:
        knee = ik.read_subject(name)
    except ValueError as error:
        remarks.append(f"The knee itself is not shown: {error}")
        return None
    if knee_digest(knee) != findings.results[0].subject_digest:
        remarks.append(f"The knee itself is not shown: {name} has changed since.")
        return None
    return scene_of(findings, knee)


def _write_figures(results: "Sequence[Result]", folder: Path, form: str) -> list[str]:
    from identknee.report.page.page import report_drawings
    from identknee.report.picture import vector

    place = prepare_folder(folder / FIGURES)
    return [
        str(write_atomically(place / f"{name}.{form}", vector(drawing.figure, form)))
        for name, drawing in report_drawings(results)
    ]
