"""`identknee profile`: which values of each parameter, or of any prediction, the data allow."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import PROTOCOLS, Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start, Uncertain

Parameters = Annotated[
    list[str] | None,
    typer.Option(
        "--parameter",
        metavar="NAME",
        help="Profile only this parameter, such as ACL.stiffness_kN. May be repeated.",
    ),
]
Quantities = Annotated[
    list[str] | None,
    typer.Option(
        "--quantity",
        metavar="NAME",
        help="Also profile a prediction: ACL.tension_N@TRIAL or varus_deg@TRIAL, where "
        "TRIAL is a name from the column trial of the data. May be repeated.",
    ),
]
Forces = Annotated[
    list[str] | None,
    typer.Option(
        metavar="TRIAL",
        help="Also profile the forces of all ligaments in this trial. May be repeated.",
    ),
]
Trials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help=f"Where the trials of --quantity and --forces stand, if not in the data: {PROTOCOLS}.",
    ),
]
Pairs = Annotated[
    list[str] | None,
    typer.Option(
        "--pair",
        metavar="NAME,NAME",
        help="Also outline the joint confidence region of two parameters. May be repeated.",
    ),
]
Level = Annotated[float, typer.Option(help="Confidence level of the intervals, such as 0.95.")]
Budget = Annotated[
    int,
    typer.Option(
        min=1, help="Largest number of simulations per profile. Most profiles need 25 to 100."
    ),
]
Bootstrap = Annotated[
    int,
    typer.Option(
        min=0,
        metavar="N",
        help="Take thresholds from N simulated data sets (at least 20 for a level of 0.95) "
        "instead of the chi-squared law.",
    ),
]


def profile(
    context: typer.Context,
    subject: Subject,
    data: Data,
    parameters: Parameters = None,
    quantities: Quantities = None,
    forces: Forces = None,
    trials: Trials = None,
    pairs: Pairs = None,
    level: Level = 0.95,
    budget: Budget = 1000,
    bootstrap: Bootstrap = 0,
    noise: Noise = None,
    uncertain: Uncertain = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-profile"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Find which values of each parameter the data allow.

    Each parameter gets a verdict and an interval: the values that the data do not exclude. The
    interval ends only where the data end it; an open end is null in result.json. A stopped run
    resumes.
    """
    run_verb(context, ik.profile)
