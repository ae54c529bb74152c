"""The command `identknee`: its verbs, and its version."""

from importlib.metadata import version
from typing import Annotated

import typer

from identknee.cli import subject
from identknee.cli.blind import blind
from identknee.cli.command import Verb, Verbs
from identknee.cli.demo import demo
from identknee.cli.design import design
from identknee.cli.diagnose import diagnose
from identknee.cli.doctor import doctor
from identknee.cli.equivalents import equivalents
from identknee.cli.fit import fit
from identknee.cli.information import information
from identknee.cli.profile import profile
from identknee.cli.report import report
from identknee.cli.reveal import reveal
from identknee.cli.sample import sample
from identknee.cli.sensitivity import sensitivity
from identknee.cli.simulate import simulate
from identknee.cli.sweep import sweep

app = typer.Typer(
    cls=Verbs,
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
    1 it could not be computed, 2 the input is wrong.
    """


app.add_typer(subject.app, name="subject")
# Each verb with what its help gives as an example.
for verb, words in (
    (demo, "--out story"),
    (simulate, "reference --noise 0.5mm,0.5deg --out knee"),
    (fit, "reference data.csv --start IG4"),
    (sweep, "reference data.csv --n-starts 200 --workers 2"),
    (profile, "reference data.csv --parameter ACL.stiffness_kN"),
    (sample, "reference data.csv --workers 2"),
    (information, "reference data.csv --noise 0.5mm,0.5deg"),
    (sensitivity, "reference --method morris --workers 2"),
    (equivalents, "reference data.csv --criterion paper"),
    (design, "reference data.csv --target ACL.stiffness_kN"),
    (diagnose, "reference data.csv --noise 0.3mm,0.3deg"),
    (blind, "reference --seed 7 --effect random --out blind7"),
    (reveal, "blind7 identknee-diagnose"),
    (report, "identknee-demo"),
    (doctor, ""),
):
    app.command(cls=Verb, epilog=f"Example: identknee {verb.__name__} {words}".rstrip())(verb)
