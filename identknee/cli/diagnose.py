"""`identknee diagnose`: what the model gets wrong, and why."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import PROTOCOLS, Json, MaybeData, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Noise, Uncertain

Planned = Annotated[
    str | None,
    typer.Option(
        "--protocol",
        metavar="PROTOCOL",
        help="Instead of DATA.csv: find out what planned trials could show, given --noise. "
        f"The trials: {PROTOCOLS}.",
    ),
]
Start = Annotated[
    str,
    typer.Option(
        help="Where an extra fit of the plain model starts: IG1 to IG4 of the paper or a "
        "file ending in .toml; subject for no extra fit."
    ),
]


def diagnose(
    context: typer.Context,
    subject: Subject,
    data: MaybeData = None,
    protocol: Planned = None,
    noise: Noise = None,
    uncertain: Uncertain = None,
    start: Start = "subject",
    out: Out = Path("identknee-diagnose"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Find what the model of SUBJECT gets wrong, and why.

    The verdict is ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED or NOT_TESTABLE. With it come the
    other causes that would fit, and the trials that would tell them apart. The folder extended
    holds the subject with the causes found, for use with every other command. With --protocol
    instead of DATA.csv, it says which causes such trials could show and tell apart. One
    process does the work: more workers change nothing.
    """
    answer = run_verb(context, ik.diagnose)
    # This loads matplotlib.
    from identknee.report.diagnosis_files import write_diagnosis_figures

    write_diagnosis_figures(answer, ik.read_subject(subject), out)
