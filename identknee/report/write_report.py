"""Results in a folder as one page for people, and every figure of it."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from identknee.report.figures import figure_data, recolour, resize, vector
from identknee.report.methods import methods_text
from identknee.report.page.page import report_drawings, report_html, report_tables
from identknee.report.page.viewer import scene_of
from identknee.report.results import (
    Result,
    by_subject,
    found_results,
    in_order,
    knee_of,
    result_of,
)
from identknee.report.table_files import table_files
from identknee.runs.files import PathLike, prepare_folder, write_atomically
from identknee.runs.progress import progress
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer

FIGURES, TABLES, METHODS = "figures", "tables", "methods.md"


def report_on(
    results: Answer | PathLike | Sequence[Answer | PathLike],
    path: PathLike,
    *,
    knee: Knee | None = None,
) -> Path:
    """The page at `path`, written from results of any verbs.

    Parameters
    ----------
    results
        Answers of verbs, folders of results, or several of either.
    path
        The HTML file to write.
    knee
        The subject, to be shown in three dimensions; read by its name if None.

    Raises
    ------
    InputError
        If a folder holds no results, or the page cannot be written.
    """
    given = [results] if isinstance(results, Answer | str | os.PathLike) else results
    found = [
        y
        for x in given
        for y in ([result_of(x)] if isinstance(x, Answer) else found_results(Path(x)))
    ]
    write_report(in_order(found), Path(path), knee=knee)
    return Path(path)


def write_report(
    results: Sequence[Result],
    page: Path,
    *,
    figures: str | None = None,
    tables: Sequence[str] = (),
    methods: bool = False,
    data: bool = False,
    width_mm: float | None = None,
    knee: Knee | None = None,
) -> dict[str, Any]:
    """What was written of these results; the page is at `page`."""
    folder = prepare_folder(page.parent)
    remarks: list[str] = []
    knees = {x.results[0].subject_digest: knee_of(x, remarks, knee) for x in by_subject(results)}
    drawn = [replace(x, knee=knees.get(x.subject_digest)) for x in results]
    scenes = {
        digest: scene
        for x in by_subject(drawn)
        if (own := knees[digest := x.results[0].subject_digest]) is not None
        and (scene := scene_of(x, own)) is not None
    }
    write_atomically(page, report_html(drawn, scenes))
    made: dict[str, Any] = {
        "report": str(page),
        "results": [{"verb": x.verb, "folder": str(x.folder)} for x in results],
        "figures": []
        if figures is None
        else _write_figures(drawn, folder, figures, data=data, width_mm=width_mm),
        "tables": [],
        "remarks": remarks,
    }
    if tables:
        place = prepare_folder(folder / TABLES)
        files = table_files(report_tables(results), tables)
        made["tables"] = [str(write_atomically(place / name, text)) for name, text in files]
    if methods:
        parts = (f"## {x.verb} ({x.folder.name})\n\n{methods_text(x.answer)}\n" for x in results)
        text = "\n".join(["# Methods\n", *parts])
        made["methods"] = str(write_atomically(folder / METHODS, text))
    return made


def _write_figures(
    results: Sequence[Result], folder: Path, form: str, *, data: bool, width_mm: float | None
) -> list[str]:
    """The figures, each with a CSV of its numbers beside it if asked for."""
    place, written = prepare_folder(folder / FIGURES), []
    for name, drawing in progress(report_drawings(results), description="drawing figures"):
        if data:
            write_atomically(place / f"{name}.csv", figure_data(drawing.figure))
        if width_mm is not None:
            try:
                resize(drawing.figure, width_mm)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        recolour(drawing.figure)
        file = write_atomically(place / f"{name}.{form}", vector(drawing.figure, form))
        written.append(str(file))
    return written
