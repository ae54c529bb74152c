"""`identknee equivalents`: other parameter sets that the measurement could not tell apart."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import PROTOCOLS, Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start, Uncertain

NumberOfSets = Annotated[
    int, typer.Option("--n-sets", min=2, help="Number of parameter sets to find.")
]
Criterion = Annotated[
    Literal["noise", "paper"],
    typer.Option(
        help="When two sets count as equivalent. noise: the sum of squared differences is "
        "at most --limit, in standard deviations. paper: the RMSE at each angle is at "
        "most 1 mm of drawer and 1.2 deg of varus and internal rotation."
    ),
]
Limit = Annotated[
    float,
    typer.Option(
        help="The largest squared difference, in units of the criterion. With noise, 3.84 "
        "also allows sets that a 5 % test would tell apart more often."
    ),
]
Forces = Annotated[
    Literal["largest", "all", "none"],
    typer.Option(
        help="Ligament forces to find the range of: under the largest load of each kind at "
        "each angle, in all trials, or none."
    ),
]
Trials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help=f"Take the forces in these trials instead of those of the data: {PROTOCOLS}.",
    ),
]


def equivalents(
    context: typer.Context,
    subject: Subject,
    data: Data,
    n_sets: NumberOfSets = 100,
    criterion: Criterion = "noise",
    limit: Limit = 1.0,
    forces: Forces = "largest",
    trials: Trials = None,
    noise: Noise = None,
    uncertain: Uncertain = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-equivalents"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Find other parameter sets that the data cannot tell apart.

    They predict the same laxity as the best fit, and are as different from each other as
    possible. The answer gives the smallest and largest value of every parameter and ligament force
    among all such sets: what one could wrongly conclude. Every set is simulated. A stopped run
    resumes.
    """
    run_verb(context, ik.equivalents)
