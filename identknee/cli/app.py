"""The command `identknee`: its verbs, and the commands that leave no answer in files."""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import Command, Json, print_result, show
from identknee.cli.verb_command import PAGE, SubjectGroup, VerbGroup

app = typer.Typer(
    cls=VerbGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Plain help needs no rich, which takes longer to load than everything else here.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"identknee {version('identknee')}")
        raise typer.Exit


@app.callback()
def identknee(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Fit knee ligament parameters to laxity tests, and see how far the fit can be trusted.

    SUBJECT is a subject folder, or a name from: identknee subject list. A command that computes
    writes result.json, and result.nc with all arrays, to the folder --out. Exit codes: 0 done,
    1 it could not be computed or an error was found, 2 the input is wrong.
    """


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

Tables = Annotated[
    str | None,
    typer.Option(
        metavar="FORM,...",
        help="Also write every table, to the folder tables beside the page: csv, latex or "
        "markdown, or several, as in csv,latex.",
    ),
]

Data = Annotated[
    Literal["csv"] | None,
    typer.Option(help="With --figures: also write the numbers of each figure beside it."),
]
Width = Annotated[
    float | None,
    typer.Option(
        metavar="MM",
        min=1.0,
        help="With --figures: their width, such as 89 or 183 for one or two columns of a journal.",
    ),
]
Methods = Annotated[
    bool,
    typer.Option(
        "--methods",
        help="Also write methods.md: how each result was computed, as a paragraph for a paper.",
    ),
]


def report(
    folder: Folder,
    out: File = None,
    figures: Figures = None,
    data: Data = None,
    width: Width = None,
    tables: Tables = None,
    methods: Methods = False,
    as_json: Json = False,
) -> None:
    """Write the results in DIR as one page that works offline.

    The answer comes first, with the numbers behind each sentence: what is known and what is
    not, what the model gets wrong, which test to do next. It takes the results of all commands
    in DIR and in the folders in it, subject by subject.
    """
    # This loads xarray and matplotlib, which takes longer than most mistakes.
    from identknee.report.table_files import forms_of
    from identknee.report.write_report import FIGURES, TABLES, write_report

    forms = forms_of(tables or "")
    if figures is None and (data or width):
        raise ValueError("--data and --width are of figures; add --figures svg or --figures pdf")
    summary = write_report(
        folder,
        out or folder / PAGE,
        figures,
        forms,
        methods=methods,
        data=data is not None,
        width_mm=width,
    )
    found = ", ".join(x["verb"] for x in summary["results"])
    lines = [f"Report on {found}: {summary['report']}", *summary["remarks"]]
    beside = Path(summary["report"]).parent
    if figures is not None:
        lines.append(f"{len(summary['figures'])} figures: {beside / FIGURES}")
    if forms:
        lines.append(f"{len(summary['tables'])} files of tables: {beside / TABLES}")
    if methods:
        lines.append(f"Methods: {summary['methods']}")
    show(summary, lines, as_json=as_json)


BlindFolder = Annotated[
    Path, typer.Argument(metavar="BLIND_DIR", help="A folder that `identknee blind` wrote.")
]
DiagnosisFolder = Annotated[
    Path, typer.Argument(metavar="DIAGNOSIS_DIR", help="A folder that `identknee diagnose` wrote.")
]


def reveal(blind_dir: BlindFolder, diagnosis_dir: DiagnosisFolder, as_json: Json = False) -> None:
    """Reveal a hidden effect, and score its diagnosis."""
    print_result(ik.blind_test.reveal(blind_dir, diagnosis_dir), as_json=as_json)


def list_all(as_json: Json = False) -> None:
    """List the subjects that come with identknee.

    Sources and licences stand with each. Use a name wherever a command wants SUBJECT. A subject
    with measured laxity also stands for its DATA.csv.
    """
    print_result(
        ik.verbs.list_subjects(),
        "Next: identknee subject check NAME, or identknee simulate NAME",
        as_json=as_json,
    )


ChecksJson = Annotated[
    bool, typer.Option("--json", help="Print the checks as JSON, and nothing else.")
]


def doctor(as_json: ChecksJson = False) -> None:
    """Check this installation, with a short self-test.

    It looks at versions, cores, cache and extras. The self-test repeats known trials of the
    reference knee. The first one after an installation compiles, which takes up to a minute. The
    exit code is 1 if anything is wrong.
    """
    print_result(ik.verbs.doctor(), as_json=as_json)


subject = typer.Typer(
    cls=SubjectGroup,
    help="List, check, show, settle, export or import a subject.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
subject.command("list", epilog="Example: identknee subject list --json")(list_all)
app.add_typer(subject, name="subject")
# What gives no answer with files; the verbs are commands by themselves.
for command, words in (
    (reveal, "blind7 identknee-diagnose"),
    (report, "identknee-demo"),
    (doctor, ""),
):
    epilog = f"Example: identknee {command.__name__} {words}".rstrip()
    app.command(cls=Command, epilog=epilog)(command)
