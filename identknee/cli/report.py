"""`identknee report`: results as one page for people."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from identknee.cli.command import Json, show
from identknee.cli.verb_command import PAGE

Folder = Annotated[
    Path,
    typer.Argument(
        metavar="DIR", help="Results folder of any command, or a folder of such folders."
    ),
]
File = Annotated[
    Path | None, typer.Option(metavar="FILE", help="The page.  [default: DIR/report.html]")
]
Figures = Annotated[
    Literal["svg", "pdf"] | None,
    typer.Option(
        help="Also write every figure for a paper, to the folder figures beside the page."
    ),
]


def report(
    folder: Folder, out: File = None, figures: Figures = None, as_json: Json = False
) -> None:
    """Write the results in DIR as one page that works offline.

    The answer comes first, with the numbers behind each sentence: what is known and what is
    not, what the model gets wrong, which test to do next. It takes the results of all commands
    in DIR and in the folders in it, subject by subject.
    """
    # This loads xarray and matplotlib, which takes longer than most mistakes.
    from identknee.report.write_report import FIGURES, write_report

    summary = write_report(folder, out or folder / PAGE, figures)
    found = ", ".join(x["verb"] for x in summary["results"])
    lines = [f"Report on {found}: {summary['report']}", *summary["remarks"]]
    if figures is not None:
        lines.append(
            f"{len(summary['figures'])} figures: {Path(summary['report']).parent / FIGURES}"
        )
    show(summary, lines, as_json=as_json)
