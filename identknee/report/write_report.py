"""Results in a folder as one page for people, and every figure of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from identknee.report.page.knee_scene import KneeScene
from identknee.report.page.page import report_drawings, report_html
from identknee.report.page.results import Findings, Result, by_subject, found_results
from identknee.report.page.scenes import scene_of
from identknee.report.picture import vector
from identknee.runs.files import prepare_folder, write_atomically
from identknee.subject.folder import read_subject
from identknee.verbs.knee_digest import knee_digest

FIGURES = "figures"


def write_report(folder: Path, page: Path, figures: str | None = None) -> dict[str, Any]:
    """What was found and written; the page is at `page`."""
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


def _scene(findings: Findings, remarks: list[str]) -> KneeScene | None:
    """The knee in three dimensions; without it a remark says why."""
    name = findings.subject
    try:
        knee = read_subject(name)
    except ValueError as error:
        remarks.append(f"The knee itself is not shown: {error}")
        return None
    if knee_digest(knee) != findings.results[0].subject_digest:
        remarks.append(f"The knee itself is not shown: {name} has changed since.")
        return None
    return scene_of(findings, knee)


def _write_figures(results: Sequence[Result], folder: Path, form: str) -> list[str]:
    place = prepare_folder(folder / FIGURES)
    return [
        str(write_atomically(place / f"{name}.{form}", vector(drawing.figure, form)))
        for name, drawing in report_drawings(results)
    ]
