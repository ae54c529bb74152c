"""`identknee design`: which laxity trials to add to those measured."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import PROTOCOLS, Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start, Uncertain

NTrials = Annotated[int, typer.Option(min=1, help="Number of trials to add.")]
Targets = Annotated[
    list[str] | None,
    typer.Option(
        "--target",
        metavar="NAME",
        help="The quantity to pin down: a parameter, ACL.tension_N@TRIAL or "
        "varus_deg@TRIAL. May be repeated. If not given: the parameters with open "
        "intervals, or all if none is open.",
    ),
]
CriterionName = Annotated[
    Literal["width", "c", "D", "A", "E"],
    typer.Option(
        help="What the new trials should make small. width: the predicted intervals of the "
        "targets. c: their variances at the best fit. D, A, E: volume, mean axis and "
        "largest axis of the confidence ellipsoid of all ligament parameters."
    ),
]
CandidateTrials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help=f"Trials to choose from: {PROTOCOLS}. If not given: drawer, varus-valgus and "
        "rotation tests, compression and pairs of loads at 0 to 120 deg, and repeats.",
    ),
]
Level = Annotated[float, typer.Option(help="Confidence level of the intervals, such as 0.95.")]


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
    uncertain: Uncertain = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-design"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Choose the trials that would best close what is still open.

    The advice is checked: the trials are simulated at the best fit and added to the data, and
    the intervals are computed again. Fill in advised_trials.csv and append it to your data.
    """
    run_verb(context, ik.design)
