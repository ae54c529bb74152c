"""`identknee design`: which laxity trials to add to those measured."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start

NTrials = Annotated[int, typer.Option(min=1, help="How many trials to add.")]
Targets = Annotated[
    list[str] | None,
    typer.Option(
        "--target",
        metavar="NAME",
        help="Whose interval is to shrink: a parameter, ACL.tension_N@TRIAL or varus_deg@TRIAL; "
        "repeatable. Without: the parameters with open intervals, or all where none is open.",
    ),
]
CriterionName = Annotated[
    Literal["width", "c", "D", "A", "E"],
    typer.Option(
        help="What is to shrink. width: the predicted intervals of the targets; c: their "
        "variances at the best fit; D, A, E: volume, mean and largest axis of the confidence "
        "ellipsoid of all parameters."
    ),
]
CandidateTrials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help="Trials to choose from: seed63, table2, drawer or a TOML file. Without: drawer, "
        "varus-valgus and rotation tests, compression and pairs of loads at 0 to 120 deg, and "
        "repeats.",
    ),
]
Level = Annotated[float, typer.Option(help="Confidence level of the intervals, as in 0.95.")]


def design(
    context: typer.Context,
    subject: Subject,
    data: Data,
    n_trials: NTrials = 4,
    targets: Targets = None,
    criterion: CriterionName = "width",
    candidates: CandidateTrials = None,
    level: Level = 0.95,
    noise: Noise = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-design"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Choose laxity trials that would tell what is left open.

    The advice is verified: the trials are simulated at the best fit, added to the data, and the
    intervals computed again. advised_trials.csv lists them, to be filled in and appended.
    """
    run_verb(context, ik.design)
