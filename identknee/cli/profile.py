"""`identknee profile`: which values of each parameter, or of any prediction, the data allow."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start

Parameters = Annotated[
    list[str] | None,
    typer.Option(
        "--parameter",
        metavar="NAME",
        help="This parameter only, such as ACL.stiffness_kN, instead of all; repeatable.",
    ),
]
Quantities = Annotated[
    list[str] | None,
    typer.Option(
        "--quantity",
        metavar="NAME",
        help="A prediction too: ACL.tension_N@TRIAL or varus_deg@TRIAL, with a name from the "
        "column trial of the data; repeatable.",
    ),
]
Forces = Annotated[
    list[str] | None,
    typer.Option(metavar="TRIAL", help="The forces of all ligaments in a trial; repeatable."),
]
Trials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help="Where the trials of --quantity and --forces stand, if not in the data: seed63, "
        "table2, drawer or a TOML file.",
    ),
]
Pairs = Annotated[
    list[str] | None,
    typer.Option(
        "--pair",
        metavar="NAME,NAME",
        help="The joint set of two parameters, as an outline; repeatable.",
    ),
]
Level = Annotated[float, typer.Option(help="Confidence level of the sets, as in 0.95.")]
Budget = Annotated[
    int, typer.Option(min=1, help="Simulations a profile may make; most need 25 to 100.")
]
Bootstrap = Annotated[
    int,
    typer.Option(
        min=0,
        metavar="N",
        help="Thresholds from N simulated data sets, at least 20 for a level of 0.95, instead of "
        "the chi-squared law.",
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
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-profile"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Say which values of each parameter of SUBJECT the data allow.

    Each parameter gets the set of values that the data do not exclude, with an end only where the
    data give it one, and a verdict. An open end is null in result.json. A stopped run resumes.
    """
    run_verb(context, ik.profile)
