"""`identknee information`: what the data say about the parameters around the best fit."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start, Uncertain

ScalingName = Annotated[
    Literal["typical", "prior"],
    typer.Option(
        help="Scale of the parameters. typical: 3 kN and 2 %. prior: the standard "
        "deviations of the prior."
    ),
]


def information(
    context: typer.Context,
    subject: Subject,
    data: Data,
    scaling: ScalingName = "typical",
    noise: Noise = None,
    uncertain: Uncertain = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-information"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Find which parameter combinations the data determine.

    Gives the eigenvalues of the Fisher information at the best fit, next to the noise of the
    solver. It also gives the rank at random points within the bounds, and shows where the least
    known combination leads.
    """
    run_verb(context, ik.information)
