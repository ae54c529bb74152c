"""`identknee diagnose`: what the model gets wrong, and why."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import Json, MaybeData, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Noise

Planned = Annotated[
    str | None,
    typer.Option(
        "--protocol",
        metavar="PROTOCOL",
        help="Without data: say what the trials of seed63, table2, drawer or a TOML file could "
        "tell, with the noise of --noise.",
    ),
]
Start = Annotated[
    str,
    typer.Option(
        help="Where one more fit of the model without causes begins: IG1 to IG4 of the paper or a "
        "file ending in .toml; subject for none."
    ),
]


def diagnose(
    context: typer.Context,
    subject: Subject,
    data: MaybeData = None,
    protocol: Planned = None,
    noise: Noise = None,
    start: Start = "subject",
    out: Out = Path("identknee-diagnose"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Say what the model of SUBJECT gets wrong in DATA.csv, and which physical cause it has.

    The verdict is one of ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED and NOT_TESTABLE, with what else
    would explain the data and which trials would tell. The folder extended is the subject with the
    causes found, for every other verb. With --protocol in place of DATA.csv it says which causes
    such trials could show and tell apart. One thread does it: more workers change nothing.
    """
    if (data is None) == (protocol is None):
        raise ValueError(
            "diagnose needs either DATA.csv or --protocol; give one of both, for example "
            "identknee diagnose reference --protocol seed63 --noise 0.3mm,0.3deg"
        )
    if data is None and noise is None:
        raise ValueError("--protocol needs --noise; add for example --noise 0.3mm,0.3deg")
    from identknee.report.diagnosis_files import write_diagnosis_figures, write_isolability_figure

    if data is None:
        planned = run_verb(context, ik.isolability, without=("data", "start"))
        write_isolability_figure(planned, out)
    else:
        answer = run_verb(context, ik.diagnose, without=("protocol",))
        write_diagnosis_figures(answer, ik.read_subject(subject), out)
