"""`identknee subject`: list, check, show, export and import subjects' knees."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import (
    PROTOCOLS,
    WRONG_INPUT,
    Json,
    Out,
    Seed,
    Subject,
    Verb,
    Verbs,
    Workers,
    print_found,
    run_verb,
)
from identknee.runs.files import write_atomically

SCENE_FILE = "scene.png"
# What they are given for the sake of all other verbs, and what decides nothing in them.
UNUSED = ("seed", "workers")

app = typer.Typer(
    cls=Verbs,
    help="List, check, show, settle, export or import a subject.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

ProtocolName = Annotated[str, typer.Option(metavar="PROTOCOL", help=f"The trials: {PROTOCOLS}.")]
Within = Annotated[
    float,
    typer.Option(
        metavar="MM",
        help="Uncertainty of the insertions, up to 8 mm. They are moved within it if trials "
        "have no stable pose.",
    ),
]
Samples = Annotated[
    int, typer.Option(min=0, help="Number of parameter sets to draw from the ranges; 0 for none.")
]
OsimFile = Annotated[
    str,
    typer.Argument(
        metavar="FILE.osim",
        help="An OpenSim/JAM model, or lenhart2015 for the one that comes with identknee.",
    ),
]
Fitted = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="A result of fit, profile or simulate for SUBJECT, whose parameters the knee gets, or "
        "a folder with several results.",
    ),
]
Osim = Annotated[bool, typer.Option("--osim", help="Also write an OpenSim 4 model.")]
Source = Annotated[
    str | None,
    typer.Option(
        metavar="FILE.osim",
        help="The OpenSim model that SUBJECT was imported from: write a copy of it with the "
        "knee's ligaments. Give lenhart2015 for the one that comes with identknee.",
    ),
]
Vtk = Annotated[
    bool,
    typer.Option("--vtk", help="Also write the knee in every trial, for ParaView and PyVista."),
]
PosedTrials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help=f"The trials of --vtk: {PROTOCOLS}. If not given: those of the result, or drawer.",
    ),
]
Bundles = Annotated[
    Literal["separate", "merged"],
    typer.Option(help="Keep the bundles separate, or merge them to four single lines."),
]


@app.command("list", epilog="Example: identknee subject list --json")
def list_all(as_json: Json = False) -> None:
    """List the subjects that come with identknee.

    Sources and licences stand with each. Use a name wherever a command wants SUBJECT. A subject
    with measured laxity also stands for its DATA.csv.
    """
    print_found(
        ik.verbs.list_subjects(),
        "Next: identknee subject check NAME, or identknee simulate NAME",
        as_json=as_json,
    )


@app.command(cls=Verb, epilog="Example: identknee subject check my-knee")
def check(
    context: typer.Context,
    subject: Subject,
    protocol: ProtocolName = "seed63",
    samples: Samples = 200,
    within: Within = 3.0,
    out: Out = Path("identknee-check"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Check SUBJECT, and whether its trials are stable.

    Checks surfaces, frames and ligaments, then the stability of the model under a protocol. It
    does so at the parameters of the subject and in a range around them: stiffness by +-50 %,
    reference strain by +-3 %. If trials have no stable pose, it says which insertions to move,
    within their uncertainty. The exit code is 2 if there is an error.
    """
    if run_verb(context, ik.verbs.check_subject).n_errors:
        raise typer.Exit(WRONG_INPUT)


@app.command(
    cls=Verb, epilog="Example: identknee subject settle lenhart2015 --within 5 --out my-knee"
)
def settle(
    context: typer.Context,
    subject: Subject,
    protocol: ProtocolName = "seed63",
    within: Within = 3.0,
    out: Out = Path("identknee-settled"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Move the insertions of SUBJECT until all trials are stable.

    They stay within their uncertainty. Writes a subject folder with the moved insertions, and says
    how far each one moved. A moved insertion is no longer the one that was segmented. The exit
    code is 1 if some trials still have no stable pose. Nothing is random: the seed changes nothing.
    """
    then = f"Next: identknee subject check {out}"
    run_verb(context, ik.verbs.settle_subject, without=("seed",), then=then)


@app.command("show", cls=Verb, epilog="Example: identknee subject show reference --out picture")
def draw(
    context: typer.Context,
    subject: Subject,
    out: Out = Path("identknee-show"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Draw SUBJECT in its scanned pose."""
    run_verb(context, ik.verbs.describe_subject, without=UNUSED)
    # This loads matplotlib, which takes longer than most mistakes.
    from identknee.report.picture import png

    write_atomically(out / SCENE_FILE, png(ik.scene(ik.read_subject(subject))))


@app.command(cls=Verb, epilog="Example: identknee subject export reference --out my-knee")
def export(
    context: typer.Context,
    subject: Subject,
    fitted: Fitted = None,
    osim: Osim = False,
    source: Source = None,
    vtk: Vtk = False,
    protocol: PosedTrials = None,
    out: Out = Path("identknee-subject"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Write SUBJECT as a subject folder, and for other tools.

    With --fitted the knee has the parameters of a result, and parameters.tsv lists them in the
    form of PEtab with their 95 % sets. With --source they are written into a copy of the OpenSim
    model that the knee was imported from; the rest of that model is unchanged. With --osim alone
    the model holds two bones, their cartilage and the ligaments. With --vtk the knee is written
    in every trial, with gap and pressure on each face and the force of each ligament.
    """
    # This loads what draws, which takes longer than most mistakes.
    from identknee.report.export import export_subject

    then = f"Next: identknee subject check {out}"
    run_verb(context, export_subject, without=UNUSED, then=then)


@app.command(
    "import-osim",
    cls=Verb,
    epilog="Example: identknee subject import-osim model.osim --out knee",
)
def import_osim(
    context: typer.Context,
    file: OsimFile,
    bundles: Bundles = "separate",
    out: Out = Path("identknee-subject"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Turn an OpenSim model into a subject folder."""
    then = f"Next: identknee subject check {out}"
    run_verb(context, ik.verbs.import_subject, without=UNUSED, then=then)
