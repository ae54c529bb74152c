"""The command `identknee`: its verbs, and its version."""

from importlib.metadata import version
from typing import Annotated

import typer

from identknee.cli.command import Command
from identknee.cli.commands import doctor, list_all, report, reveal
from identknee.cli.verb_command import SubjectGroup, VerbGroup

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
